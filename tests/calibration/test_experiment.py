"""The experiment in a time of its own: what it finds, leaves on disk, goes on from and refuses; its path, its plans."""

import os
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_listener import Heard
from command_line import result

import dehyst
from dehyst import Actuator, DehystError, FileFormatError, Record, read
from dehyst.calibration import Plan, TrackedPath, calibrate, experiment
from dehyst.calibration.experiment import _remarks
from dehyst.calibration.following import _apart
from dehyst.calibration.plan import Excitations, steps
from dehyst.calibration.session import ProgressListener, Session, slower
from dehyst.calibration.tracking import later_temperature
from dehyst.control import VoltageLimits
from dehyst.instruments import DeviceError
from dehyst.instruments.simulated import SimulatedRig
from dehyst.operations.paths import even_rate
from dehyst.records import about_of
from dehyst.report import write_report
from dehyst.trust import Change
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation, raised_cosine


@pytest.fixture(scope="module")
def creeping(tmp_path_factory):
    """A calibration of what creeps: the result, its folder, and the rig as it left it."""
    folder, rig = tmp_path_factory.mktemp("bench") / "creep", SimulatedRig(PlayActuator(creep=0.01))
    return calibrate(rig, folder, watcher=Heard()), folder, rig


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench") / "play"
    rig, heard = SimulatedRig(PlayActuator()), Heard()
    return calibrate(rig, folder, watcher=heard), folder, rig, heard


@pytest.fixture
def identified(finished, monkeypatch):
    """The record of that calibration is identified once."""
    monkeypatch.setattr(experiment, "_identified", lambda *_: (finished[0].fit, finished[0].insight))


def test_the_model_reduces_the_error_of_the_path(finished):
    found, _, _, _ = finished
    assert found.nominal.largest_percent > 10
    assert found.compensated.largest_percent < 0.2
    assert found.good
    assert found.checked[0].kept
    error = found.compensated.error - found.compensated.error.mean()
    assert 1 < found.checked[0].promise.largest / np.abs(error).max() < 3
    # The tracking error has the sensor's noise, which the check leaves out.
    assert 0.7 < np.std(error) / np.hypot(found.checked[0].noise, found.checked[0].rms_without_noise) < 1.3
    assert found.remarks == ()


def test_the_output_keeps_the_limits_and_ends_at_a_safe_voltage(finished):
    _, _, rig, _ = finished
    log = rig.instrument.axis.log
    assert 0 <= log.lowest <= log.highest <= 200 and log.refused == 0
    assert rig.read().voltage == 0


def test_the_folder_has_all_results(finished, tmp_path):
    found, folder, rig, heard = finished
    names = ["recommended", "nominal", "compensated"]
    for name in names:
        record = read(folder / "records" / f"{name}.csv")
        assert about_of(folder / "records" / f"{name}.csv")["rig"] == rig.identity
        assert len(record) == heard.samples_of[name]
    assert sorted(path.name for path in folder.iterdir()) == ["model.json", "records"]
    assert sorted(path.stem for path in (folder / "records").iterdir()) == sorted(names)
    assert Actuator.load(folder / "model.json").limits is not None
    write_report(tmp_path / "report.html", found.fit, followed={"nominal": found.nominal})
    page = (tmp_path / "report.html").read_text()
    assert "Measured along" in page


def test_the_stated_error_is_that_of_the_record(finished):
    """Told again from the files alone."""
    found, folder, _, _ = finished
    record = read(folder / "records" / "compensated.csv")
    along = slice(len(record) - found.compensated.wanted.size, None)
    error = record.displacement[along] - found.compensated.wanted
    assert 100 * np.abs(error).max() / found.compensated.stroke == found.compensated.largest_percent
    assert found.compensated.stroke == pytest.approx(PlayActuator().stroke, rel=1e-3)


def test_a_second_call_plays_nothing(finished, identified):
    found, folder, _, _ = finished
    rig, heard = SimulatedRig(PlayActuator()), Heard()
    again = calibrate(rig, folder, watcher=heard)
    assert (again.kept, again.played) == (("recommended", "nominal", "compensated"), ())
    assert again.compensated.largest_percent == found.compensated.largest_percent
    assert heard.samples_of == {}
    status, told = result("calibrate", "sim://", "-o", folder, "--goal", 0.01, keep=True)
    assert (status, tuple(told["kept"]), told["played"]) == (1, again.kept, [])


def test_two_calibrations_into_one_folder_are_refused(tmp_path):
    rig = SimulatedRig(PlayActuator())
    refused = pytest.raises(FileFormatError, match="another calibration")
    with Session(tmp_path, SimulatedRig(PlayActuator()), ProgressListener()), refused:
        calibrate(rig, tmp_path)
    assert rig.instrument.axis.log.highest == 0
    Session(tmp_path, rig, ProgressListener()).close()


@pytest.mark.parametrize(
    ("degrees", "changes", "count"),
    [
        (0.4, [], 0),
        (0.6, [], 1),
        (0, [("gain", 0.01, 0.002, 1e-7, True)], 1),
        (0, [("gain", -0.01, 0.002, 1e-7, True), ("drift", 1e-7, 1e-9, 1e-7, True)], 2),
        (0, [("gain", 0.004, 0.002, 1e-7, False), ("width", 0.5, 0.01, 1e-7, True)], 0),
    ],
)
def test_a_rig_that_warms_drifts_or_reads_wrong_is_remarked(degrees, changes, count):
    time = np.linspace(0, 1, 50)
    changed = [found for found in (Change(*change) for change in changes) if found.counts]
    for scale, wrong in ((1e-7, 0), (1e-10, 1), (1e-4, 1)):
        warm = [Record(time, 100 * time, 100 * scale * time, others={"temperature_C": 20 + degrees * time})]
        checked = [SimpleNamespace(changed=changed, stroke=1e-5)]
        for factor in (1.0, 1.04):
            found = [*_remarks(warm, checked, factor * warm[0].voltage)]
            assert len(found) == count + wrong + (factor != 1)


def test_a_calibration_continues_after_an_interrupt(identified, tmp_path):
    truth = PlayActuator()
    first, rig = Heard("nominal", after=500), SimulatedRig(truth)
    with pytest.raises(KeyboardInterrupt) as caught:
        calibrate(rig, tmp_path, watcher=first)
    assert rig.instrument.axis.log.steepest <= rig.slew_rate * (1 + 1e-6)
    assert "brought to 0 V" in caught.value.__notes__[0]
    cut = read(tmp_path / "records" / "nominal.csv")
    assert len(cut) == first.samples_of["nominal"] >= 500
    found = calibrate(SimulatedRig(truth), tmp_path, watcher=Heard())
    assert found.kept == ("recommended",)
    assert found.played == ("nominal", "compensated")
    assert found.compensated.largest_percent < 0.2
    # The truncated file is still there, under another name.
    [aside] = (tmp_path / "records" / "set-aside").iterdir()
    assert len(read(aside)) == len(cut)


@pytest.mark.parametrize(("most", "left"), [(0.0, 0.03), (5e-3, 0.015), (10e-3, 5e-4)])
def test_an_error_is_without_the_delay_that_the_promise_excludes(most, left):
    time = np.linspace(0, 2, 2001)
    wanted, reached = (np.sin(np.pi * (time - late)) for late in (0.0, 0.01))
    error = _apart(TrackedPath(time, wanted, reached, 1.0), most)
    assert np.abs(error).max() == pytest.approx(left, rel=0.1, abs=3e-4)


def test_a_rig_that_takes_longer_than_planned_is_remarked():
    planned = raised_cosine([100.0])
    jumped = planned.time + 20.0 * (np.arange(len(planned)) > 99)
    for time, numbers in ((planned.time, []), (10.0 * planned.time, ["10 times"]), (jumped, ["20.2 s"])):
        remarks = [*slower(Record(time, planned.voltage, 1e-7 * planned.voltage), planned)]
        assert [number in remark for number, remark in zip(numbers, remarks, strict=True)] == [True] * len(numbers)


def test_a_model_of_other_limits_is_not_replaced(tmp_path):
    truth = PlayActuator(highest=100.0)
    (tmp_path / "model.json").write_text("{}")
    (tmp_path / "records").mkdir()
    rig = SimulatedRig(truth)
    with pytest.raises(FileFormatError, match="another calibration"):
        calibrate(rig, tmp_path)
    assert (tmp_path / "model.json").read_text() == "{}" and rig.instrument.axis.log.largest_step == 0.0


def test_creep_is_identified_and_compensated(creeping):
    found, _, _ = creeping
    assert found.fit.actuator.displacement_creep is not None
    assert found.compensated.largest_percent < 0.4


@pytest.mark.nightly
def test_with_creep_an_old_record_is_not_followed_by_the_path(creeping, tmp_path):
    """What crept in an hour between the nominal path and the compensated one, a new nominal path tells."""
    # The only test that drives this rig on.
    _, before, rig = creeping
    folder = shutil.copytree(before, tmp_path / "creep")
    (folder / "records" / "compensated.csv").unlink()
    rig._wait(3600.0)
    found = calibrate(rig, folder)
    assert found.played == ("nominal", "compensated")
    assert found.compensated.largest_percent < 0.4


def test_a_folder_of_another_instrument_is_refused(finished):
    _, folder, _, _ = finished
    truth = PlayActuator()
    rig = SimulatedRig(truth)
    rig.identity = "another controller"
    with pytest.raises(FileFormatError, match="simulated play-"):
        calibrate(rig, folder, watcher=Heard())


def test_an_error_between_records_causes_a_retreat(tmp_path, monkeypatch):
    """The excitation ends at 100 V, where the voltage stays while the model is identified."""
    rising = raised_cosine([200, 100], cycles=1, drive=Excitations((VoltageLimits(0, 200),), 400.0, 1.0).samplings()[0])
    given = Excitation("rising", rising.voltage[:-200], rising.sample_rate)
    monkeypatch.setattr(Excitations, "recommended", lambda _: given)
    rig = SimulatedRig(PlayActuator())

    class Impatient(Heard):
        def step(self, name, seconds=0.0):
            super().step(name, seconds)
            if name == "identify":
                assert rig.instrument.axis.voltage == 100
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        calibrate(rig, tmp_path, watcher=Impatient())
    assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
    assert rig.instrument.axis.voltage == 0


def test_a_rig_that_cannot_begin_does_not_move_the_records(tmp_path):
    rig = SimulatedRig(PlayActuator())
    with pytest.raises(KeyboardInterrupt):
        calibrate(rig, tmp_path, watcher=Heard("recommended", after=100))
    before = sorted(path.name for path in (tmp_path / "records").iterdir())
    with pytest.raises(DeviceError):
        calibrate(SimulatedRig(PlayActuator(), limits=(10, 60)), tmp_path, watcher=Heard())
    assert sorted(path.name for path in (tmp_path / "records").iterdir()) == before


def test_a_wave_that_still_plays_is_stopped_first(tmp_path):
    rig = SimulatedRig(PlayActuator())
    rig.instrument.start(np.linspace(0, 150, 5000), 100)
    first = Heard("recommended", after=100)
    with pytest.raises(KeyboardInterrupt):
        calibrate(rig, tmp_path, watcher=first)
    assert read(tmp_path / "records" / "recommended.csv").voltage[0] == 0


def test_a_record_without_samples_is_removed(tmp_path):
    rig = SimulatedRig(PlayActuator())
    rig._wave = lambda voltage, rate: iter(())
    with pytest.raises(DeviceError, match=r"recorded 0 of \d+ samples") as caught:
        calibrate(rig, tmp_path, watcher=Heard())
    assert len(caught.value.__notes__) == 1
    assert list((tmp_path / "records").iterdir()) == []


def test_steps_send_nothing_and_fit_the_limits():
    rig = SimulatedRig(PlayActuator(), limits=(10, 120), slew_rate=300)
    told = steps(rig, Plan())
    assert [step.name for step in told] == ["recommended", "nominal", "compensated"]
    for step in told:
        assert step.excitation.voltage_range == (10, 120)
        steepest = np.abs(np.diff(step.excitation.voltage)).max() * step.excitation.sample_rate
        assert steepest <= 300 * (1 + 1e-6)
    assert rig.instrument.axis.log.highest == 0


@pytest.mark.parametrize("wrong", [{"frequency": 0}, {"goal": -1}, {"frequency": np.nan}])
def test_impossible_plans_are_refused(wrong):
    with pytest.raises(DehystError, match=next(iter(wrong))):
        Plan(**wrong).excitations(SimulatedRig(PlayActuator()))


@pytest.mark.parametrize(
    "time", [[0, 0, 0, 0], [0, 1, 1, 2], [3, 2, 1, 0], [0, 1, 2, 4], [0]], ids=["zero", "twice", "back", "gap", "one"]
)
def test_times_that_do_not_rise_evenly_are_refused(time):
    with pytest.raises(FileFormatError, match=r"wave\.csv"):
        even_rate("wave.csv", {"time_s": np.array(time, dtype=float)})


def test_the_sample_rate_is_that_of_the_times():
    assert even_rate("wave.csv", {"time_s": np.arange(5) / 100}) == pytest.approx(100.0)


def test_the_drift_of_a_temperature_is_extrapolated_for_its_duration():
    time, noise = 0.1 * np.arange(100), np.random.default_rng(0).normal(0, 0.05, 100)
    warm = SimpleNamespace(thermal=0.0)
    for drift in (0.0, 0.2):
        degrees = 25 + drift * time + noise
        record = dehyst.Record(time, time, time, "", others={"temperature_C": degrees})
        expected = degrees[-5:].mean() if not drift else 25 + drift * (9.9 + np.array([0.0, 5.0, 9.9, 9.9]))
        assert later_temperature(warm, record, [0.0, 5.0, 9.9, 500.0]) == pytest.approx(expected, abs=0.1)
    assert later_temperature(warm, dehyst.Record(time, time, time), [0.0]) is None
    assert later_temperature(SimpleNamespace(thermal=None), record, [0.0]) is None


LOOK = Excitations((VoltageLimits(0, 200),), 400.0).homing()
RECORD = "records/look.csv"


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    folder = tmp_path_factory.mktemp("base") / "out"
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        job.record(LOOK, "look")
    return folder


@pytest.fixture
def folder(base, tmp_path):
    return shutil.copytree(base, tmp_path / "out")


def go_on(folder, aside=None):
    """Go on in a folder; returns whether its record was kept. `aside`: files that must be reported as moved."""
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        record = job.record(LOOK, "look")
    assert len(record) == len(read(folder / RECORD)) == len(LOOK)
    assert job.kept + job.played == ["look"]
    assert aside is None or job.aside == aside
    return bool(job.kept)


def edited(change):
    """Change the lines of a record."""

    def damage(folder):
        lines = (folder / RECORD).read_text().splitlines(keepends=True)
        (folder / RECORD).write_text("".join(change(lines)))

    return damage


def replaced(content):
    return lambda folder: (folder / RECORD).write_bytes(content)


def row(number, text):
    """Replace a row of samples."""
    return edited(lambda lines: [*lines[: number + 2], f"{text}\n", *lines[number + 3 :]])


def link(target):
    def damage(folder):
        (folder / RECORD).unlink()
        (folder / RECORD).symlink_to(folder / target)

    return damage


def become_a_folder(folder):
    (folder / RECORD).unlink()
    (folder / RECORD).mkdir()


RECORDS = {
    "cut off": edited(lambda lines: lines[:500]),
    "cut off in a line": lambda folder: (folder / RECORD).write_bytes((folder / RECORD).read_bytes()[:20_000]),
    "empty": replaced(b""),
    "zeros": replaced(bytes(50_000)),
    "zeros behind it": edited(lambda lines: [*lines[:500], "\0" * 4096]),
    "text": replaced(b"no record"),
    "a folder": become_a_folder,
    "a dangling link": link("nowhere"),
    "a link to itself": link(RECORD),
    "no head": edited(lambda lines: lines[1:]),
    "head no JSON": edited(lambda lines: ["# dehyst-record: {bad\n", *lines[1:]]),
    "head a list": edited(lambda lines: ["# dehyst-record: [1]\n", *lines[1:]]),
    "key of another excitation": edited(lambda lines: ['# dehyst-record: {"key": "0"}\n', *lines[1:]]),
    "key a list": edited(lambda lines: ['# dehyst-record: {"key": [1]}\n', *lines[1:]]),
    "NaN": row(5, "0.02,nan,1.0"),
    "infinity": row(5, "0.02,1.0,inf"),
    "no number": row(5, "0.02,1.0,1.0x"),
    "time goes back": row(5, "-1.0,1.0,1.0"),
    "a line is missing": edited(lambda lines: [*lines[:700], *lines[701:]]),
    "no voltage": edited(lambda lines: [lines[0], lines[1].replace("voltage_V", "spare"), *lines[2:]]),
}


@pytest.mark.parametrize("name", RECORDS)
def test_a_damaged_record_is_set_aside_and_played_again(folder, name):
    RECORDS[name](folder)
    aside = folder / "records" / "set-aside" / "look.csv"
    assert not go_on(folder, [aside])
    assert os.path.lexists(aside)
    if name.startswith("a dangling"):
        # Nothing was written to where the link leads.
        assert not (folder / "nowhere").exists()
    assert go_on(folder)


def test_records_that_were_set_aside_are_not_replaced(folder):
    aside = folder / "records" / "set-aside"
    aside.mkdir()
    (aside / "look.csv").write_text("first")
    (aside / "look-2.csv").symlink_to(folder / "nowhere")
    RECORDS["empty"](folder)
    assert not go_on(folder, [aside / "look-3.csv"])
    assert (aside / "look.csv").read_text() == "first" and not (folder / "nowhere").exists()


def test_an_unreadable_record_is_played_again(folder, monkeypatch):
    """As another user than root: its file may not be read, but moved."""
    real = Path.open

    def refuse(path, mode="r", **options):
        if path == folder / RECORD and mode == "rb":
            raise PermissionError(13, "Permission denied")
        return real(path, mode, **options)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", refuse)
        with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
            assert job.stored("look", LOOK) is None
    assert go_on(folder)


def test_an_undamaged_record_is_kept(folder, base):
    assert go_on(folder)
    assert (folder / RECORD).read_bytes() == (base / RECORD).read_bytes()


def test_a_copy_of_another_record_is_not_used(folder):
    with Session(folder, SimulatedRig(PlayActuator(plays=30)), ProgressListener()) as job:
        job.record(Excitations((VoltageLimits(0, 200),), 200.0).homing(), "homing")
    shutil.copy(folder / "records" / "homing.csv", folder / RECORD)
    assert not go_on(folder)


def test_an_unknown_file_is_not_changed(folder):
    path = folder / "records" / "notes.txt"
    path.write_text("a,b\n1,2\n")
    assert go_on(folder)
    assert path.read_text() == "a,b\n1,2\n"


def records_a_file(folder):
    shutil.rmtree(folder / "records")
    (folder / "records").write_text("x")


def aside_a_file(folder):
    (folder / "records" / "set-aside").write_text("x")
    (folder / RECORD).write_bytes(b"")


REFUSED = {
    "records a file": (records_a_file, r"records: is a file where a folder is needed"),
    "set-aside a file": (aside_a_file, r"set-aside: is a file where a folder is needed"),
    "records of another axis": (
        edited(lambda lines: ['# dehyst-record: {"rig": "x", "axis": "2"}\n', *lines[1:]]),
        "axis 2",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_unusable_folder_is_refused_with_a_sentence(folder, name):
    damage, message = REFUSED[name]
    damage(folder)
    before = sorted(folder.rglob("*"))
    with pytest.raises(FileFormatError, match=message):
        go_on(folder)
    assert sorted(folder.rglob("*")) == before
