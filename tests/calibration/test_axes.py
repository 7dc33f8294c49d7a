"""Several axes calibrated over a socket: plan, records, stage, and a path that all axes follow together."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_listener import Heard
from emulated_stage import COUPLING, HIGHEST, rig_of, served, virtual_stage

import dehyst
from dehyst import Stage
from dehyst.calibration import Plan, calibrate, experiment
from dehyst.calibration.plan import Excitations
from dehyst.calibration.plan import steps as planned_steps
from dehyst.calibration.tracking import PathPlanner, TrackedPath
from dehyst.control import VoltageLimits
from dehyst.model import MaxwellSlip, Spring, Thermal
from dehyst.records import read

COLUMNS = "1=v1_V:1_um, 2=v2_V:2_um, 3=v3_V:3_um"


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory):
    folder, listener = tmp_path_factory.mktemp("calibration"), Heard()
    with served(stage=virtual_stage(noise=2e-9)) as (server, bench), rig_of(server) as rig:
        result = calibrate(rig, folder, watcher=listener)
        ends = [axis.voltage for axis in bench.axes], [axis.log.highest for axis in bench.axes]
    return result, folder, listener, ends


def test_every_axis_follows_the_path_within_0_3_percent(calibrated):
    result, *_ = calibrated
    assert result.good
    assert max(path.largest_percent for path in result.compensated.each) < 0.3
    assert min(path.largest_percent for path in result.nominal.each) > 5
    assert np.abs(result.fit.coupling - COUPLING).max() < 0.005
    # All axes move together through most of their strokes.
    assert np.all(np.ptp(result.compensated.wanted, axis=0) > 0.65 * result.compensated.stroke)


def test_voltages_stay_within_limits_and_end_at_safe_values(calibrated):
    *_, (ends, highest) = calibrated
    assert ends == [0.0] * 3
    assert np.all(np.array(highest) <= HIGHEST)


def test_the_folder_has_stage_numbers_and_records(calibrated):
    result, folder, listener, _ = calibrated
    stage = Stage.load(folder / "stage.json")
    assert stage.axes == ("1", "2", "3")
    np.testing.assert_array_equal(stage.coupling, result.model.coupling)
    names = ["axes", "nominal", "compensated"]
    assert listener.steps == [names[0], "identify", *names[1:]]
    made = {path.name for path in (folder / "records").glob("*.csv")}
    assert made == {f"{name}.csv" for name in names}
    record = read(folder / "records" / "axes.csv", COLUMNS)
    np.testing.assert_array_equal(record.voltage, result.training.voltage)


def test_complete_records_of_all_axes_are_kept(calibrated, monkeypatch):
    result, folder, *_ = calibrated
    monkeypatch.setattr(experiment, "_identified", lambda *_: (result.fit, None))
    (folder / "records" / "nominal.csv").unlink()
    with served(stage=virtual_stage(noise=2e-9)) as (server, bench), rig_of(server) as rig:
        with pytest.raises(KeyboardInterrupt) as caught:
            calibrate(rig, folder, watcher=Heard("nominal", after=500))
        assert [axis.voltage for axis in bench.axes] == [0.0] * 3
    (note,) = caught.value.__notes__
    assert note.voltages == (0.0, 0.0, 0.0)
    assert len(read(folder / "records" / "axes.csv", COLUMNS)) == len(result.training)
    assert Stage.load(folder / "stage.json")


def test_axes_move_one_after_the_other_then_together(calibrated):
    with served() as (server, bench), rig_of(server) as rig:
        planned = {step.name: step for step in planned_steps(rig, Plan())}
        assert [axis.log.largest_step for axis in bench.axes] == [0.0] * 3
    axes, nominal = (planned[name].excitation.voltage for name in ("axes", "nominal"))
    moving = np.abs(np.diff(axes, axis=0)) > 0
    alone = [(moving[:, j] & (moving.sum(axis=1) == 1)).sum() for j in range(3)]
    assert min(alone) > 1000
    assert moving.all(axis=1).sum() > 1000
    assert np.allclose(axes.max(axis=0), HIGHEST)
    assert np.allclose(nominal.max(axis=0), HIGHEST)
    assert len(calibrated[0].compensated.wanted) == pytest.approx(planned["compensated"].more - 200, abs=2)


def test_the_entries_of_a_plan_state_their_durations():
    with served() as (server, _), rig_of(server, limits=[(0, 50), (5, 60), (0, 150)], slew_rate=200.0) as rig:
        steps = planned_steps(rig, Plan())
        entries = [step.as_dict(rig) for step in steps]
    assert [entry["step"] for entry in entries] == ["axes", "nominal", "compensated"]
    assert entries[0]["samples"] == len(steps[0].excitation)
    assert entries[0]["lowest_V"] == [0.0, 5.0, 0.0]
    assert all(max(entry["steepest_V_per_s"]) <= 200.0 * (1 + 1e-9) for entry in entries)


PLAIN = dehyst.Actuator(MaxwellSlip([1e-6, 3e-6], [1e6, 5e5]), Spring([0.0, 9e-6], [0.0, 60.0]))
WARM = replace(PLAIN, thermal=Thermal(-0.002, 5e-9, 20.0))
COUPLED = np.array([[1.0, 0.02], [-0.03, 1.0]])


@pytest.mark.parametrize(
    ("truth", "model", "unaware"),
    [
        (Stage((WARM,)), WARM, PLAIN),
        (Stage((PLAIN, WARM), COUPLED), Stage((PLAIN, WARM), COUPLED), Stage((PLAIN, PLAIN), COUPLED)),
    ],
    ids=["one axis", "two axes"],
)
def test_a_path_is_planned_at_the_measured_temperature(truth, model, unaware):
    """One of the axes loses a fifth of a percent of its motion a kelvin, while they warm by 10 K."""
    count = len(truth.axes)
    limits, names = (VoltageLimits(0, 60),) * count, ("x", "y")[:count] if count > 1 else ()
    planner = PathPlanner(Excitations(limits, 400.0, 1.0, 1.0, names))

    def degrees(time):
        return 22 + 0.5 * time

    def played(excitation, begin, states):
        time, voltage = begin + excitation.time, excitation.voltage.reshape(-1, count)
        moved = truth.simulate(voltage, time=time, temperature=degrees(time), states=states)
        others, y = {"temperature_C": degrees(time)}, moved.displacement.reshape(excitation.voltage.shape)
        return dehyst.Record(time, excitation.voltage, y + 1e-7, others=others), moved.state

    missed = []
    for trained in (model, unaware):
        start = [actuator.relaxed(0.0) for actuator in truth.actuators]
        first, state = played(planner.homing, 0.0, start)
        nominal, state = played(planner.nominal(trained, [first]).excitation, first.time[-1] + 0.0025, state)
        planned = planner.compensated(trained, [first, nominal])
        assert not planned.warnings
        last, _ = played(planned.excitation, nominal.time[-1] + 0.0025, state)
        missed.append([path.largest_percent for path in TrackedPath.of(planned, last, np.arange(len(last))).each])
    assert max(missed[0]) < 0.02
    assert missed[1][-1] > 0.3
