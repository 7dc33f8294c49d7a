"""A compensator in micrometres gives the voltages of one in metres, in every method."""

import pickle

import numpy as np
import plain_records
import pytest

from dehyst import ClampWarning, Compensator, ModelError, Stage
from dehyst.control import plan_path

ACTUATOR = plain_records.plant(6)
STAGE = Stage((ACTUATOR, plain_records.plant(4)), [[1.0, 0.05], [-0.03, 1.0]])
PATH = np.array([2.0, 5.0, 11.0, 7.0, 3.0, 9.0])


def pair(units="um", **options):
    given = {"model": ACTUATOR, "limits": (0, 200), **options}
    return Compensator(**given), Compensator(**given, units=units)


@pytest.mark.parametrize(("units", "counts"), [("mm", 1e3), ("um", 1e6), ("nm", 1e9)])
@pytest.mark.parametrize(("model", "highest"), [(ACTUATOR, 200), (ACTUATOR, 100), (STAGE, 100)])
@pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
def test_loops_and_paths_in_any_unit_give_the_same_voltages(units, counts, model, highest):
    """Of a path that is followed, and of one that is clamped; and a copy goes on alike."""
    metres, other = pair(units, model=model, limits=(0, highest))
    path = (PATH if model is ACTUATOR else np.column_stack([PATH, PATH[::-1]])) / 1e6 * counts
    command, expected = plan_path(other, path, home=False), plan_path(metres, path / counts, home=False)
    for own in ("phase", "clamped", "voltage"):
        np.testing.assert_array_equal(getattr(command, own), getattr(expected, own))
    for own in ("displacement", "expected", "missed"):
        np.testing.assert_allclose(getattr(command, own), counts * np.array(getattr(expected, own)), rtol=1e-12)
    assert (command.units, command.warnings, repr(command)) == (units, expected.warnings, repr(expected))
    assert np.any(command.missed) == (highest == 100)
    for wanted in path:
        assert np.array_equal(other.offer(wanted), metres.offer(wanted / counts))
        assert np.array_equal(other.step(wanted), metres.step(wanted / counts))
    copies = [pickle.loads(pickle.dumps(loop)) for loop in (metres, other)]
    for first, second in ((metres, other), copies):
        np.testing.assert_array_equal(second.run(path), first.run(path / counts))
    np.testing.assert_allclose(other.reach, np.multiply(metres.reach, counts), rtol=1e-15)


def test_a_displacement_far_out_of_reach_is_refused_in_its_unit():
    micro = pair()[1]
    with pytest.raises(ModelError, match="compensator takes"):
        plan_path(micro, PATH * 1e3)
    assert micro._straying(0, 1e-6 * PATH) == ""
    assert "in um" in micro._straying(0, 1e-3 * PATH)
    with pytest.raises(ModelError, match="displacement: got nan"):
        micro.step(float("nan"))
    with pytest.raises(ModelError, match="units: got 'V'"):
        Compensator(ACTUATOR, (0, 200), units="V")


@pytest.mark.parametrize("units", ["m", "um"])
def test_a_clamp_warning_points_at_the_caller(units):
    compensator = pair(units, limits=(0, 100), slew_rate=1e3, period=1e-3)[1]
    scale = 1.0 if units == "m" else 1e6
    with pytest.warns(ClampWarning) as caught:
        for wanted in (3e-6, 5e-6, *np.linspace(5e-6, 15e-6, 200)):
            compensator.step(wanted * scale)
            compensator.offer(wanted * scale)
    assert compensator.clamps.limited and compensator.clamps.slewed
    assert len(caught) >= 2 and {warning.filename for warning in caught} == {__file__}


def test_a_path_in_metres_is_recognized():
    _, micro = pair(limits=(20, 100))
    (clamped,), hinted = plan_path(micro, PATH, home=False).warnings, plan_path(micro, PATH / 2e6, home=False)
    assert "metres" not in clamped
    assert "in metres" in hinted.warnings[-1] and "in um" in hinted.warnings[-1]
    assert "in metres" in plan_path(micro, PATH / 2e6, home=True).warnings[-1]
    assert not any("metres" in warning for warning in plan_path(micro, PATH, home=True).warnings)
