"""Files of every format in `tests/golden/` are read with the same numbers; another version is refused."""

import contextlib
import copy
import json
from functools import reduce
from itertools import islice

import numpy as np
import places
import pytest
from command_line import run

import dehyst
from dehyst import Actuator, Compensator, FileFormatError, ModelError, Stage
from dehyst.workbench.folder import Folder
from examples import NIGHTLY

GOLDEN = places.TESTS / "golden"


def golden(name):
    return json.loads((GOLDEN / name).read_text())


def test_the_stored_actuator_has_its_stored_numbers():
    actuator = Actuator.load(GOLDEN / "actuator-1.json")
    displacement = actuator.simulate([0.0, 40.0, 80.0, 20.0], time=[0.0, 0.5, 1.0, 1.5]).displacement
    assert 1e6 * displacement == pytest.approx([11.33, 7.63768068944, 12.0183741873, 4.5334838802], rel=1e-9)
    assert (actuator.name, actuator.limits, actuator.delay) == ("all parts", (0.0, 90.0), 2e-4)
    known = actuator.identification
    assert (known.lag_of, known.goal, known.largest_error) == ("", 2.0, 5e-8)


def test_the_stored_stage_has_its_stored_numbers():
    stage = Stage.load(GOLDEN / "stage-1.json")
    assert stage.recorded_columns == ()
    displacement = stage.simulate([[0, 0], [40, 10], [20, 60]]).displacement
    expected = [[0.931542857143, 0.922585714286], [5.5269718395, 1.8711250886], [3.9203798839, 8.6402291108]]
    assert 1e6 * displacement == pytest.approx(np.array(expected), rel=1e-9)


def test_the_stored_snapshot_of_a_loop_has_its_stored_numbers():
    loop = Compensator(Actuator.load(GOLDEN / "plain-1.json"), slew_rate=2e4, period=1e-3, warns=False)
    loop.restore((GOLDEN / "loop-1.bin").read_bytes())
    assert loop.clamps == (0, 3)
    assert (loop.voltage, loop.step(6e-6)) == pytest.approx((39.8454545454545, 40.838961038961), rel=1e-12)


@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_the_stored_record_has_its_stored_numbers(suffix):
    record = dehyst.read(GOLDEN / f"record-1.{suffix}")
    assert (len(record), record.voltage[15]) == (60, 90.0)
    assert record.displacement[15] == pytest.approx(1.32471428571429e-5, rel=1e-12)
    assert record.meta["guesses"] == {"displacement": "column 'y' in um"}


def test_the_stored_scan_and_wave_table_have_their_stored_numbers(tmp_path):
    model = GOLDEN / "plain-1.json"
    outputs = ("-o", tmp_path / "v.csv", "--table", tmp_path / "t.csv")
    status, out, _ = run("compensate", model, GOLDEN / "scan-1.csv", *outputs)
    assert status == 0, out
    old, new = (dehyst.read(folder / name) for folder, name in ((GOLDEN, "wave-table-1.csv"), (tmp_path, "t.csv")))
    assert old.voltage.tolist()[:3] == pytest.approx([7.02727272727273, 12.8837320574, 19.7765550239])
    assert new.voltage == pytest.approx(old.voltage, rel=1e-9)


MODELS = [(Actuator, "actuator-1.json"), (Stage, "stage-1.json")]


@pytest.mark.parametrize("version", [0, 2, 99, True, 1.0, "1", None])
@pytest.mark.parametrize(("kind", "name"), MODELS)
def test_another_version_of_a_model_is_refused(kind, name, version):
    with pytest.raises(ModelError) as caught:
        kind.from_dict({**golden(name), "version": version})
    assert repr(version) in caught.value.got
    assert "version 1" in caught.value.need and caught.value.hint


def places_of(data, place=()):
    """Where the values of JSON data are; of a list the first two."""
    yield place
    entries = data.items() if isinstance(data, dict) else list(enumerate(data))[:2] if isinstance(data, list) else ()
    for key, value in entries:
        yield from places_of(value, (*place, key))


DAMAGE = (None, [], [1.0], [[]], {}, {"x": 1}, 3, -1.5, "x", np.nan, np.inf, True, 10**400, 5e-324, 1e30, 1e308)
# Numbers times these: another sign, a neighbour, and other exponents.
FACTORS = (-1, 0, 1 + 1e-15, 1 + 1e-9, 0.5, 1e3, 1e-12, 1e150, 1e-150)


def damaged(data):
    """Model files in which one value is another, or is missing, or is there twice."""
    for place in places_of(data):
        value = reduce(lambda part, key: part[key], place, data)
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        for bad in (*DAMAGE, *(factor * value for factor in FACTORS if number), "absent", "twice"):
            copied = {"all": copy.deepcopy(data)}
            *parents, last = ("all", *place)
            parent = reduce(lambda part, key: part[key], parents, copied)
            if bad == "absent":
                del parent[last]
            elif bad == "twice" and isinstance(parent, list):
                parent.insert(last, value)
            else:
                parent[last] = bad
            if "all" in copied:
                yield copied["all"]


def used(model):
    """Simulate a model, and step a loop of it: what is not refused is a number, and within limits and slew rate."""
    axes = model.actuators if isinstance(model, Stage) else [model]
    for axis in axes:
        low, high = axis.limits or tuple(axis.spring.voltage[[0, -1]].tolist())
        time = 1e-3 * np.arange(12)
        with contextlib.suppress(ModelError):
            assert np.isfinite(axis.simulate(np.linspace(low, high, 12), time=time).displacement).all()
        path = np.linspace(*axis.spring.displacement[[0, -1]], 12)
        with contextlib.suppress(ModelError):
            assert np.isfinite(axis.compensate(path[[0, 9, 3, 11, 5]], time=time[:5]).voltage).all()
        with contextlib.suppress(ModelError):
            loop = Compensator(axis, (low, high), 50 * (high - low), period=1e-3, warns=False)
            for wanted in path[[0, 9, 3, 11, 5]].tolist():
                before, sent = loop.voltage, loop.step(wanted)
                assert low <= sent <= high and abs(sent - before) <= 0.05 * (high - low) * (1 + 1e-9)


@pytest.mark.parametrize(("kind", "name"), MODELS)
@pytest.mark.filterwarnings("ignore")
def test_a_model_with_a_damaged_value_is_refused_or_usable(kind, name):
    """Whatever takes the place of one value, nothing but `ModelError` is raised: at reading, and in a loop after it."""
    refused = 0
    # A push takes every fifth; neighbours differ in what takes the place.
    for data in islice(damaged(golden(name)), 0, None, 1 if NIGHTLY else 5):
        try:
            model = kind.from_dict(data)
        except ModelError:
            refused += 1
        else:
            used(model)
            text = json.dumps(model.as_dict())
            assert json.dumps(kind.from_dict(json.loads(text)).as_dict()) == text
    assert refused > len(DAMAGE)


def test_another_version_of_records_and_folders_is_refused(tmp_path):
    record, folder = tmp_path / "record-1.csv", Folder(tmp_path / "bench")
    text = (GOLDEN / record.name).read_text()
    record.write_text(text.replace('{"guesses"', '{"version": 99, "guesses"', 1))
    folder.save({"version": 99})
    for read in (lambda: dehyst.read(record), folder.saved):
        with pytest.raises(FileFormatError, match="got version 99, need version 1"):
            read()
    folder.close()
