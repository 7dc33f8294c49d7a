"""Files of every format and version in `tests/golden/`, read for ever with the same numbers; newer ones are refused.

A file there is never written again: a new version of a format adds one.
"""

import json
import shutil

import h5py
import numpy as np
import places
import pyarrow.parquet as pq
import pytest
from command_line import run

import dehyst
from dehyst import Actuator, AdaptiveCompensator, Compensator, FileFormatError, ModelError, Stage
from dehyst.adaptation import AdaptiveSnapshot
from dehyst.calibration.session import claimed
from dehyst.control import Snapshot
from dehyst.fleet import load
from dehyst.model import serialization
from dehyst.records import salvage
from dehyst.trust import CheckHistory
from dehyst.workbench.folder import Folder

GOLDEN = places.TESTS / "golden"
# Volts, and the displacements of each version in micrometres.
VOLTAGE, TIME = [0.0, 40.0, 80.0, 20.0], [0.0, 0.5, 1.0, 1.5]
SEEN_THROUGH_PARTS = [11.0, 9.05715373379, 11.186744205, 7.55853619976]
DISPLACEMENT = {
    1: [0.895714285714, 5.45867724868, 11.6757142857, 4.03857142857],
    2: SEEN_THROUGH_PARTS,
    3: SEEN_THROUGH_PARTS,
    4: [11.33, 9.37952471266, 11.5087668548, 7.87207977881],
}


def golden(name):
    return json.loads((GOLDEN / name).read_text())


@pytest.mark.parametrize("version", DISPLACEMENT)
def test_an_actuator(version):
    actuator = Actuator.load(GOLDEN / f"actuator-{version}.json")
    assert actuator.name == f"version {version}"
    displacement = actuator.simulate(VOLTAGE, time=TIME).displacement
    assert 1e6 * displacement == pytest.approx(DISPLACEMENT[version], rel=1e-9)
    assert (actuator.limits, actuator.delay) == ((0.0, 90.0), 0.0 if version == 1 else 2e-4)


def test_what_an_actuator_of_version_2_knows_of_its_identification():
    known = Actuator.load(GOLDEN / "actuator-2.json").identification
    assert (known.method, known.norm, known.goal, known.largest_error) == ("record", "l1", 2.0, 5e-8)


@pytest.mark.parametrize(("version", "known"), [(1, (False, ("vx_V:x_um", "vy_V:y_um"))), (2, (True, ()))])
def test_a_stage(version, known):
    stage = Stage.load(GOLDEN / f"stage-{version}.json")
    assert (stage.is_matrix, stage.recorded_columns) == known
    displacement = stage.simulate([[0, 0], [40, 10], [20, 60]]).displacement
    expected = [[0.931542857143, 0.922585714286], [5.5269718395, 1.8711250886], [3.9203798839, 8.6402291108]]
    assert 1e6 * displacement == pytest.approx(np.array(expected), rel=1e-9)


def test_the_memory_of_a_loop():
    loop = Compensator(Actuator.load(GOLDEN / "actuator-1.json"), slew_rate=2e4, period=1e-3, warns=False)
    assert loop.restore(Snapshot.load(GOLDEN / "loop-2.json"))
    assert loop.clamps == (0, 3)
    assert (loop.voltage, loop.step(6e-6)) == pytest.approx((39.8454545454545, 40.838961038961), rel=1e-12)


def test_the_memory_of_a_loop_that_learns():
    actuator = Actuator.load(GOLDEN / "actuator-1.json")
    loop = AdaptiveCompensator(actuator, (0, 90), slew_rate=2e4, period=1e-3)
    loop.restore(AdaptiveSnapshot.load(GOLDEN / "adaptive-loop-1.json"))
    with pytest.warns(dehyst.ClampWarning):
        assert loop.step(6e-6, 5e-6) == pytest.approx(39.8454545454545, rel=1e-12)
    loop = AdaptiveCompensator(actuator, (0, 90), slew_rate=2e4, period=1e-3, zero_drifts=False, warns=False)
    loop.restore(AdaptiveSnapshot.load(GOLDEN / "adaptive-loop-2.json"))
    assert loop.step(5e-6, 4.9e-6) == pytest.approx(33.3909090909091, rel=1e-12)
    assert loop.snapshot().learnt["before"][:2] == pytest.approx([0.04226946, 0.0638009], rel=1e-6)
    again = AdaptiveCompensator(actuator, (0, 90), slew_rate=2e4, period=1e-3, zero_drifts=False, warns=False)
    again.restore(AdaptiveSnapshot.load(GOLDEN / "adaptive-loop-3.json"))
    assert (again.voltage, again.step(4e-6, 4.8e-6)) == (loop.voltage, loop.step(4e-6, 4.8e-6))


@pytest.mark.parametrize("suffix", ["csv", "npz", "h5"])
def test_a_record(suffix):
    record = dehyst.read(GOLDEN / f"record-1.{suffix}")
    assert (len(record), record.voltage[15]) == (60, 90.0)
    assert record.displacement[15] == pytest.approx(1.32471428571429e-5, rel=1e-12)
    known = {"rig": "sim"} if suffix == "h5" else {"guesses": {"displacement": "column 'y' in um"}}
    assert known.items() <= record.meta.items()


def test_the_journal_of_a_record(tmp_path):
    shutil.copy(GOLDEN / "journal-1.h5.part.csv", tmp_path)
    (path,) = salvage(tmp_path)
    record = dehyst.read(path)
    assert (record.name, record.meta["rig"]) == ("look", "sim")
    assert record.displacement.tolist() == [0.0, 1.25e-6, 2.5e-6, 1.5e-6]


def test_the_path_of_a_scan_and_its_wave_table(tmp_path):
    model = GOLDEN / "actuator-1.json"
    outputs = ("-o", tmp_path / "v.csv", "--table", tmp_path / "t.csv")
    status, out, _ = run("compensate", model, GOLDEN / "scan-1.csv", *outputs)
    assert status == 0, out
    old, new = (dehyst.read(folder / name) for folder, name in ((GOLDEN, "wave-table-1.csv"), (tmp_path, "t.csv")))
    assert old.voltage.tolist()[:3] == pytest.approx([7.02727272727273, 12.8837320574, 19.7765550239])
    assert new.voltage == pytest.approx(old.voltage, rel=1e-9)


def test_the_table_of_a_fleet():
    table = load(GOLDEN / "fleet-1.parquet")
    assert [row["outcome"] for row in table.rows] == ["identified"] * 2
    assert [row["stroke_um"] for row in table.rows] == [16.152, 19.3824]
    first, second = (actuator.simulate([0, 50]).displacement[-1] for actuator in table.actuators())
    assert (1e6 * first, second / first) == pytest.approx((6.29678760026, 1.2), rel=1e-9)


def test_a_history_of_checks():
    checks = CheckHistory.read(GOLDEN / "history-1", "75044281c6e6e63f").checks
    assert sorted((one.record, round(one.error, 3)) for one in checks) == [("a", 0.086), ("b", 13.756)]


def test_the_folder_of_a_calibration(tmp_path):
    folder = tmp_path / "calibration"
    shutil.copytree(GOLDEN / "calibration-1", folder)
    assert claimed(folder, "simulated 0123", "1") == folder / "records"
    with pytest.raises(FileFormatError, match="holds a calibration of simulated 0123"):
        claimed(folder, "another", "1")


NEWER = "got (format .* )?version 99, need .*a newer dehyst wrote it: install that one"


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Actuator, "actuator-4.json"),
        (Stage, "stage-2.json"),
        (Snapshot, "loop-2.json"),
        (AdaptiveSnapshot, "adaptive-loop-3.json"),
    ],
)
def test_a_newer_model_or_memory_is_refused(kind, name):
    with pytest.raises(ModelError, match=NEWER):
        kind.from_dict({**golden(name), "version": 99})


def places_of(data, place=()):
    """Where the values of JSON data are; of a list the first two."""
    yield place
    entries = data.items() if isinstance(data, dict) else list(enumerate(data))[:2] if isinstance(data, list) else ()
    for key, value in entries:
        yield from places_of(value, (*place, key))


DAMAGE = (None, [], [1.0], [[]], {}, {"x": 1}, 3, -1.5, "x", np.nan, np.inf, True, 10**400)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((Actuator, f"actuator-{version}.json") for version in DISPLACEMENT),
        *((Stage, f"stage-{version}.json") for version in (1, 2)),
        (Snapshot, "loop-2.json"),
        *((AdaptiveSnapshot, f"adaptive-loop-{version}.json") for version in (1, 2, 3)),
    ],
)
def test_a_damaged_value_anywhere_is_refused_or_can_be_used(kind, name):
    """Whatever takes the place of one value, nothing but `ModelError` is raised: at reading, and in a loop after it."""
    actuator, refused = Actuator.load(GOLDEN / "actuator-1.json"), 0
    for place in places_of(golden(name)):
        for bad in DAMAGE:
            data = {"all": golden(name)}
            *parents, last = ("all", *place)
            part = data
            for key in parents:
                part = part[key]
            part[last] = bad
            try:
                read = kind.from_dict(data["all"])
                if kind is Snapshot:
                    Compensator(actuator, slew_rate=2e4, period=1e-3).restore(read)
                elif kind is AdaptiveSnapshot:
                    AdaptiveCompensator(actuator, (0, 90), slew_rate=2e4, period=1e-3, zero_drifts=False).restore(read)
            except ModelError:
                refused += 1
    assert refused > len(DAMAGE)


def newer(path, old, new):
    """Write a copy of a text with a newer version."""
    text = (GOLDEN / path.name).read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def test_newer_records_and_paths_are_refused(tmp_path):
    shutil.copy(GOLDEN / "record-1.h5", tmp_path)
    with h5py.File(tmp_path / "record-1.h5", "r+") as file:
        file.attrs["dehyst"] = file.attrs["dehyst"].replace("{", '{"version": 99, ', 1)
    text = newer(tmp_path / "record-1.csv", '{"guesses"', '{"version": 99, "guesses"')
    scan = newer(tmp_path / "scan-1.csv", '{"kind"', '{"version": 99, "kind"')
    for path in (text, tmp_path / "record-1.h5"):
        with pytest.raises(FileFormatError, match=NEWER):
            dehyst.read(path)
    status, _, error = run("compensate", GOLDEN / "actuator-1.json", scan, "-o", tmp_path / "v.csv")
    assert status == 2
    assert "a newer dehyst wrote it" in error


def test_newer_folders_and_tables_are_refused(tmp_path):
    shutil.copytree(GOLDEN / "calibration-1", tmp_path / "calibration-1")
    path = tmp_path / "calibration-1" / "campaign.json"
    path.write_text(path.read_text().replace('"version": 1', '"version": 99'))
    with pytest.raises(FileFormatError, match=NEWER):
        claimed(path.parent, "simulated 0123", "1")
    shutil.copytree(GOLDEN / "history-1", tmp_path / "history-1")
    for path in (tmp_path / "history-1").glob("check-*"):
        path.write_text(path.read_text().replace('"version": 1', '"version": 99'))
    with pytest.raises(FileFormatError, match=NEWER):
        CheckHistory.read(tmp_path / "history-1", "75044281c6e6e63f")
    table = pq.read_table(GOLDEN / "fleet-1.parquet")
    about = {b"dehyst-fleet": table.schema.metadata[b"dehyst-fleet"].replace(b"{", b'{"version": 99, ', 1)}
    pq.write_table(table.replace_schema_metadata(about), tmp_path / "fleet.parquet")
    with pytest.raises(FileFormatError, match=NEWER):
        load(tmp_path / "fleet.parquet")
    folder = Folder(tmp_path / "bench")
    folder.save({"version": 99})
    with pytest.raises(FileFormatError, match=NEWER):
        folder.saved()
    folder.close()


def test_every_version_of_a_model_has_a_file():
    names = {path.name for path in GOLDEN.iterdir()}
    assert {f"actuator-{k}.json" for k in range(1, serialization.VERSION + 1)} <= names
    assert sum(path.stat().st_size for path in GOLDEN.rglob("*")) < 200_000
