"""Whether records on disk are of the actuator that is connected: one loop is played again before they are kept."""

import hashlib
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from calibration_listener import Heard
from plain_records import plant
from rehearsal import DEHYST
from truths import VIRTUAL, BoucWenActuator, ModelledActuator, PreisachActuator

from dehyst import Actuator, FileFormatError, RecordError, read
from dehyst._io import unwritten
from dehyst.calibration import Plan, calibrate
from dehyst.calibration.comparison_loop import agreement, cycles, replay
from dehyst.calibration.plan import ExcitationPlan, steps
from dehyst.calibration.session import NullProgress, Session
from dehyst.instruments import open_rig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.operations.bench import _left
from dehyst.virtual import PlayActuator
from dehyst.waveforms import staircase
from examples import spanning

PACE = ExcitationPlan(0, 200, 400.0)
STROKE = PlayActuator().stroke


class Inverted(PlayActuator):
    """A play actuator whose sensor is mounted the other way round."""

    def play(self, voltage, **options):
        return -super().play(voltage, **options)


def rig_of(truth, identity="one and the same", **options):
    rig = SimulatedRig(truth, **options)
    rig.identity = identity
    return rig


def contents(folder):
    """Hash of each file below a folder, by its name."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def compared(rig, record, excitation, other=None):
    """Play the loop of a record again, after something else and a pause."""
    other = other or rig
    loop = replay(excitation)
    played = other.play(loop)
    return agreement(record, excitation, played, rig.rows(len(excitation)), other.rows(len(loop)))


def as_model(scale=1.0):
    """An identified actuator, and the same with another stroke."""
    data = replace(plant(), limits=(0.0, 90.0)).as_dict()
    for part in (data["spring"], data["slip"], data["state"]):
        for key in ("displacement_m", "deformation_m", "breakaway_m", "carts_m"):
            if key in part:
                part[key] = (scale * np.asarray(part[key])).tolist()
    data["slip"]["stiffness_V_per_m"] = [value / scale for value in data["slip"]["stiffness_V_per_m"]]
    return Actuator.from_dict(data)


# The loop


def test_a_cycle_follows_an_earlier_top_and_returns_to_the_lowest_voltage():
    look = PACE.look().voltage
    found = cycles(look)
    assert len(found) == 2
    for cycle in found:
        assert look[cycle.first] == look[cycle.last] == 0
        assert look[cycle.first : cycle.last + 1].max() == 200
        assert look[: cycle.first].max() == 200
    assert found[-1].last == look.size - 1
    assert cycles(np.zeros(50)) == cycles(np.linspace(0, 1, 50)) == []


def test_what_has_no_such_cycle_has_no_replay():
    assert replay(staircase(200, steps=5, hold=0.1, back=True, drive=PACE.sampling())) is None


@pytest.mark.parametrize("name", ["look", "loops", "others", "homing"])
def test_a_replay_is_within_limits_and_slew_rate_of_what_it_repeats(name):
    excitation = getattr(PACE, name)()
    loop = replay(excitation)
    assert loop.voltage_range == excitation.voltage_range
    assert np.abs(np.diff(loop.voltage)).max() <= np.abs(np.diff(excitation.voltage)).max() * (1 + 1e-9)
    assert loop.sample_rate == excitation.sample_rate
    assert len(cycles(loop.voltage)) == 1


def same_actuators():
    for seed in (0, 1, 2, 3):
        yield PlayActuator(seed=seed, noise=2e-9)
        yield PlayActuator(seed=seed, noise=1e-7)
        yield PlayActuator(seed=seed, creep=0.01)
        yield PlayActuator(seed=seed, creep=0.05, noise=5e-8)
        yield PreisachActuator(seed=seed, noise=3e-8)
        yield BoucWenActuator(seed=seed, noise=3e-8)


BETWEEN = [(1.0, 131.0, 0.5), (1.0, 200.0, 3600.0), (20.0, 17.0, 5.0)]


@pytest.mark.parametrize(("truth", "between"), spanning(list(same_actuators()), BETWEEN))
def test_the_same_actuator_agrees_whatever_came_between(truth, between):
    frequency, left_at, rest = between
    truth.relax()
    rig = SimulatedRig(truth)
    pace = Plan(frequency=frequency).excitations(rig)
    record = rig.play(pace.look())
    rig.set_voltage(left_at)
    rig._wait(rest)
    rig.retreat()
    found = compared(rig, record, pace.look())
    assert found.good, found
    assert found.difference < 0.8 * found.allowed


@pytest.mark.parametrize("longest", [150, 401, 65536])
def test_a_device_with_short_tables_plays_it_in_pieces(longest):
    truth = PlayActuator()
    rig = SimulatedRig(truth, wave_points=longest, record_points=longest)
    found = compared(rig, rig.play(PACE.look()), PACE.look())
    assert found.good
    assert found.difference < 1e-3


OTHERS = {
    "60 % of the stroke": PlayActuator(stroke=0.6 * STROKE),
    "160 % of the stroke": PlayActuator(stroke=1.6 * STROKE),
    "gain 2 % higher": PlayActuator(stroke=1.02 * STROKE),
    "narrower": PlayActuator(width=0.4),
    "wider": PlayActuator(width=0.75),
    "another sign": Inverted(),
    "Preisach": PreisachActuator(),
    "Bouc and Wen": BoucWenActuator(),
    "dead sensor, nearly": PlayActuator(stroke=1e-3 * STROKE),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_actuator_does_not_agree(name):
    rig, other = SimulatedRig(PlayActuator()), SimulatedRig(OTHERS[name])
    found = compared(rig, rig.play(PACE.look()), PACE.look(), other)
    assert not found.good, found


@pytest.mark.parametrize("truth", [PlayActuator(creep=0.05), PlayActuator(noise=2e-7)])
def test_neither_noise_nor_creep_lets_60_percent_of_the_stroke_pass(truth):
    other = replace(truth, stroke=0.6 * truth.stroke)
    rig = SimulatedRig(truth)
    found = compared(rig, rig.play(PACE.look()), PACE.look(), SimulatedRig(other))
    assert found.difference == pytest.approx(0.4, abs=0.06)
    assert not found.good


# The folder


@pytest.fixture
def folder(tmp_path):
    """A folder with two records of a play actuator, made on a rig that answers as any other does."""
    job = Session(tmp_path / "out", rig_of(PlayActuator()), NullProgress())
    for name, excitation in (("look", PACE.look()), ("loops", PACE.tops(10))):
        job.record(excitation, name)
    assert job.agreement is None
    return tmp_path / "out"


def test_records_are_kept_after_one_loop(folder):
    before, heard = contents(folder), Heard()
    rig = rig_of(PlayActuator(seed=7))
    job = Session(folder, rig, heard)
    look, loops = job.record(PACE.look(), "look"), job.record(PACE.tops(10), "loops")
    assert (job.kept, job.played, heard.steps) == (["look", "loops"], [], ["comparison"])
    assert job.agreement.record == "look"
    assert job.agreement.difference < 1e-3
    after = contents(folder)
    assert set(after) - set(before) == {"records/comparisons/comparison.csv"}
    assert {name: after[name] for name in before} == before
    whole = len(read(folder / "records/comparisons/comparison.csv"))
    assert whole > 100
    # What is played next follows the loop, and the history of the actuator has it at its place.
    others = job.record(PACE.others(), "others")
    assert [one.name for one in job.sequence] == ["look", "loops", "comparison", "others"]
    assert job.sequence[0].time[0] == look.time[0]
    assert others.time[0] > job.sequence[2].time[-1]
    assert len(loops) == len(PACE.tops(10))


def test_another_actuator_behind_an_equal_identity_is_refused(folder):
    before, rig = contents(folder), rig_of(PlayActuator(stroke=0.6 * STROKE))
    for attempt in (1, 2):
        job = Session(folder, rig, NullProgress())
        for _ in range(2):
            with pytest.raises(RecordError, match="differs by 4"):
                job.record(PACE.look(), "look")
        assert (job.kept, job.played, attempt) == ([], [], attempt)
    after = contents(folder)
    assert {name: after[name] for name in before} == before
    assert all(name.startswith("records/comparisons/") for name in set(after) - set(before))
    # The one that was recorded goes on.
    job = Session(folder, rig_of(PlayActuator()), NullProgress())
    job.record(PACE.look(), "look")
    assert job.kept == ["look"]


def test_a_calibration_refuses_it_and_leaves_a_safe_voltage(folder):
    rig = rig_of(PreisachActuator())
    look = Plan().excitations(rig).look()
    (folder / "records" / "look.csv").unlink()
    Session(folder, rig_of(PlayActuator()), NullProgress()).record(look, "look")
    before = contents(folder)
    with pytest.raises(RecordError, match="looks like") as caught:
        calibrate(rig, folder)
    assert "The voltage was brought to 0 V." in caught.value.__notes__
    assert rig.instrument.axis.voltage == 0
    assert rig.instrument.axis.log.highest <= 200
    assert rig.instrument.axis.log.steepest <= rig.slew_rate * (1 + 1e-6)
    after = contents(folder)
    assert {name: after[name] for name in before} == before
    assert not (folder / "model.json").exists()


def test_a_record_without_a_loop_is_played_anew_not_trusted(tmp_path):
    stairs = staircase(200, steps=5, hold=0.1, back=True, drive=PACE.sampling())
    Session(tmp_path, rig_of(PlayActuator()), NullProgress()).record(stairs, "stairs")
    job = Session(tmp_path, rig_of(PlayActuator(stroke=0.6 * STROKE)), NullProgress())
    job.record(stairs, "stairs")
    assert job.played == ["stairs"]
    assert len(list((tmp_path / "records" / "set-aside").iterdir())) == 1


def test_a_later_record_is_compared_if_the_first_was_lost(folder):
    (folder / "records" / "look.csv").write_bytes(b"")
    job = Session(folder, rig_of(PlayActuator(stroke=0.6 * STROKE)), NullProgress())
    job.record(PACE.look(), "look")
    with pytest.raises(RecordError, match="record 'loops'"):
        job.record(PACE.tops(10), "loops")


@pytest.mark.parametrize("after", [20, 300])
def test_an_interrupted_comparison_loses_nothing(folder, after):
    before = contents(folder)
    with pytest.raises(KeyboardInterrupt):
        Session(folder, rig_of(PlayActuator()), Heard("comparison", after)).record(PACE.look(), "look")
    left = contents(folder)
    assert {name: left[name] for name in before} == before
    cut = len(read(folder / "records/comparisons/comparison.csv"))
    job = Session(folder, rig_of(PlayActuator()), NullProgress())
    job.record(PACE.look(), "look")
    assert job.kept == ["look"]
    assert len(read(folder / "records/comparisons/comparison-2.csv")) > cut


def test_it_goes_on_from_any_step(tmp_path):
    """Stopped where each step begins, again and again: each session keeps what the ones before it recorded."""
    truth, names = PlayActuator(), ["look", "loops", "others"]
    protocol = dict(zip(names, (PACE.look(), PACE.tops(10), PACE.others()), strict=True))
    for done in range(len(names)):
        job = Session(tmp_path, rig_of(truth), NullProgress())
        for name in names[: done + 1]:
            job.record(protocol[name], name)
        assert (job.kept, job.played) == (names[:done], names[done : done + 1])
        assert (job.agreement is None) == (done == 0)
        kept = contents(tmp_path / "records")
    assert not (tmp_path / "records" / "set-aside").exists()
    assert {f"{name}.csv" for name in names} <= set(kept)


def test_the_plan_has_the_loop_and_its_time():
    rig = SimulatedRig(PlayActuator(), limits=(10, 120), slew_rate=300)
    first = steps(rig, Plan())[0]
    assert first.name == "comparison"
    assert first.excitation.duration == pytest.approx(2 * 1.0, rel=0.25)
    rig.check(first.excitation)


# Identities


def test_an_identity_is_of_what_is_driven_not_of_its_name(tmp_path):
    one, other = (ModelledActuator(as_model(*scale)) for scale in ((), (0.6,)))
    renamed = ModelledActuator(replace(one.actuator, name="stage 3", provenance={"source": "x"}, limits=(0.0, 80.0)))
    assert renamed.fingerprint() == one.fingerprint() == SimulatedRig(one).instrument.serial
    assert other.fingerprint() != one.fingerprint()
    named = {make().fingerprint() for make in VIRTUAL.values()}
    options = {PlayActuator(**each).fingerprint() for each in ({"creep": 0.02}, {"seed": 1}, {"stroke": 1e-5})}
    assert len(named | options) == len(VIRTUAL) + 3
    assert PlayActuator(creep=0.01).fingerprint() == VIRTUAL["creep"]().fingerprint()
    driven = PlayActuator()
    driven.play(np.linspace(0, 200, 50))
    assert driven.fingerprint() == PlayActuator().fingerprint()


def test_a_second_model_is_another_rig(tmp_path):
    pace = ExcitationPlan(0, 90, 400.0)
    first, second, same = (SimulatedRig(ModelledActuator(as_model(scale))) for scale in (1.0, 0.6, 1.0))
    Session(tmp_path / "out", first, NullProgress()).record(pace.look(), "look")
    before = contents(tmp_path / "out")
    with pytest.raises(FileFormatError, match="simulated model-"):
        Session(tmp_path / "out", second, NullProgress())
    assert contents(tmp_path / "out") == before
    job = Session(tmp_path / "out", same, NullProgress())
    job.record(pace.look(), "look")
    assert job.kept == ["look"]


def calibrated(address, out):
    command = [*DEHYST, "calibrate", address, "-o", str(out), "--options", '{"rounds": 0}']
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)


def test_a_rig_of_ones_own_with_another_actuator_is_refused(tmp_path):
    """The identity is equal, as that of a controller whose stage was changed."""
    source = (
        "from dehyst.instruments.simulated import SimulatedRig\n"
        "from dehyst.virtual import PlayActuator\n"
        "def make(limits=None, slew_rate=None, stroke={stroke}):\n"
        "    rig = SimulatedRig(PlayActuator(stroke=stroke), limits=limits, slew_rate=slew_rate)\n"
        "    rig.identity = 'controller 12345'\n"
        "    return rig\n"
    )
    own = tmp_path / "own.py"
    own.write_text(source.format(stroke=STROKE))
    with open_rig(f"{own}:make") as rig:
        Session(tmp_path / "out", rig, NullProgress()).record(Plan().excitations(rig).look(), "look")
    before = contents(tmp_path / "out")
    own.write_text(source.format(stroke=0.6 * STROKE))
    done = calibrated(f"{own}:make", tmp_path / "out")
    assert done.returncode == 2, done.stderr
    assert "another actuator (loop differs" in done.stderr
    assert "another folder" in done.stderr
    assert "The voltage was brought to 0 V." in done.stderr
    assert "the same command goes on" not in done.stderr
    after = contents(tmp_path / "out")
    assert {name: after[name] for name in before} == before
    assert set(after) - set(before) == {"records/comparisons/comparison.csv"}


def test_only_what_can_be_mended_is_said_to_go_on(tmp_path):
    """A full disk may have room later; a folder of another instrument stays one."""
    (tmp_path / "records").mkdir()
    (tmp_path / "records" / "look.csv").touch()
    another, full = FileFormatError("holds a calibration of another"), unwritten("a.csv", OSError(28, "No space left"))
    full.__cause__ = OSError(28, "No space left")
    for error, goes_on in ((another, False), (full, True), (RecordError("another actuator"), False)):
        with pytest.raises(type(error)), _left(tmp_path, again=True):
            raise error
        (said,) = error.__notes__
        assert ("the same command goes on from there" in said) == goes_on
