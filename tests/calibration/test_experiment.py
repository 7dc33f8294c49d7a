"""The experiment on a bench in a time of its own: what it finds, what it leaves on disk, how it goes on; plans."""

import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from calibration_listener import Heard
from command_line import result

from dehyst import Actuator, DehystError, FileFormatError, Record, read
from dehyst.calibration import Plan, calibrate
from dehyst.calibration.experiment import _remarks
from dehyst.calibration.plan import Excitations, even_rate, steps
from dehyst.calibration.session import ProgressListener, Session
from dehyst.control import VoltageLimits
from dehyst.instruments import DeviceError
from dehyst.instruments.simulated import SimulatedRig
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


def test_the_model_takes_the_hysteresis_out(finished):
    found, _, _, _ = finished
    assert found.nominal.largest_percent > 10
    assert found.compensated.largest_percent < 0.2
    assert found.good
    assert found.checked[0].kept
    error = found.compensated.error - found.compensated.error.mean()
    assert 1 < found.checked[0].promise.largest / np.abs(error).max() < 3
    assert found.remarks == ()


def test_what_was_put_out_kept_the_limits_and_ended_at_a_safe_voltage(finished):
    _, _, rig, _ = finished
    log = rig.instrument.axis.log
    assert 0 <= log.lowest <= log.highest <= 200 and log.refused == 0
    assert rig.read().voltage == 0


def test_everything_is_on_disk(finished, tmp_path):
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


def test_the_error_is_what_was_measured(finished):
    """Told again from the files alone."""
    found, folder, _, _ = finished
    record = read(folder / "records" / "compensated.csv")
    along = slice(len(record) - found.compensated.wanted.size, None)
    error = record.displacement[along] - found.compensated.wanted
    assert 100 * np.abs(error).max() / found.compensated.stroke == found.compensated.largest_percent
    assert found.compensated.stroke == pytest.approx(PlayActuator().stroke, rel=1e-3)


def test_a_second_call_plays_nothing(finished):
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
        (0, [("gain", 0.01, 0.002, 1e-7)], 1),
        (0, [("gain", -0.01, 0.002, 1e-7), ("drift", 1e-7, 1e-9, 1e-7)], 2),
        (0, [("gain", 0.004, 0.002, 1e-7), ("zero", 1e-7, 1e-9, 1e-9), ("width", 0.5, 0.01, 1e-7)], 0),
    ],
)
def test_a_rig_that_warms_or_drifts_for_sure_is_remarked(degrees, changes, count):
    time = np.linspace(0, 1, 50)
    changed = [found for found in (Change(*change, 1e-8) for change in changes) if found.counts]
    for scale, wrong in ((1e-7, 0), (1e-10, 1), (1e-4, 1)):
        warm = [Record(time, 100 * time, 100 * scale * time, others={"temperature_C": 20 + degrees * time})]
        assert len([*_remarks(warm, [SimpleNamespace(changed=changed, stroke=1e-5)])]) == count + wrong


def test_it_goes_on_after_an_interrupt(tmp_path):
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


def test_creep_is_seen_and_followed(creeping):
    found, _, _ = creeping
    assert found.fit.actuator.displacement_creep is not None
    assert found.compensated.largest_percent < 0.4


@pytest.mark.nightly
def test_a_path_is_not_followed_by_an_old_record_of_what_creeps(creeping, tmp_path):
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


def test_it_retreats_from_what_stops_it_between_records(tmp_path, monkeypatch):
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


def test_a_rig_that_cannot_begin_leaves_the_records_where_they_are(tmp_path):
    rig = SimulatedRig(PlayActuator())
    with pytest.raises(KeyboardInterrupt):
        calibrate(rig, tmp_path, watcher=Heard("recommended", after=100))
    before = sorted(path.name for path in (tmp_path / "records").iterdir())
    with pytest.raises(DeviceError):
        calibrate(SimulatedRig(PlayActuator(), limits=(10, 60)), tmp_path, watcher=Heard())
    assert sorted(path.name for path in (tmp_path / "records").iterdir()) == before


def test_a_wave_that_was_left_playing_is_stopped_first(tmp_path):
    rig = SimulatedRig(PlayActuator())
    rig.instrument.start(np.linspace(0, 150, 5000), 100)
    first = Heard("recommended", after=100)
    with pytest.raises(KeyboardInterrupt):
        calibrate(rig, tmp_path, watcher=first)
    assert read(tmp_path / "records" / "recommended.csv").voltage[0] == 0


def test_a_record_without_samples_is_not_left(tmp_path):
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
        even_rate("wave.csv", np.array(time, dtype=float))


def test_the_rate_is_that_of_the_times():
    assert even_rate("wave.csv", np.arange(5) / 100) == pytest.approx(100.0)
