"""A path that is repeated learns from its own error."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import ClampWarning, Compensator, ModelError, Repetition
from dehyst.control import SensorFault, SensorWarning
from dehyst.model import Identification, Validity, turned

PLANT, STROKE, PERIOD = plain_records.plant(10, seed=4), plain_records.STROKE, 1e-3
AGED = replace(PLANT, spring=replace(PLANT.spring, voltage=1.02 * PLANT.spring.voltage))
PATH = STROKE * (0.45 - 0.4 * np.cos(2 * np.pi * np.arange(250) / 250))
NOISE = 1e-4 * STROKE


class Life:
    """A plant, its repetition, and the true errors of its cycles."""

    def __init__(self, *, limits=(-20, 220), path=PATH, late=0, known=None, **options):
        self.state = turned(PLANT, float(path[0]), rising=False)
        plant, given = (
            replace(PLANT, delay=late * PERIOD, identification=known),
            {"state": self.state, "preview": late > 0},
        )
        self.loop = Compensator(plant, limits, period=PERIOD, warns=False, **given)
        self.repetition, self.errors = Repetition(self.loop, path, **options), []
        self.sent, self.late = np.full(late, self.loop.voltage), late
        self.random = np.random.default_rng(0)

    def cycle(self, sensor=lambda y: y):
        self.sent = np.append(self.sent[self.sent.size - self.late :], self.repetition.next())
        motion = AGED.simulate(self.sent[: len(PATH)], state=self.state, extrapolate=True)
        self.state = motion.state
        self.errors.append(float(np.sqrt(np.mean((motion.displacement - self.repetition.path[:, 0]) ** 2))))
        return self.repetition.learn(sensor(motion.displacement + NOISE * self.random.standard_normal(len(PATH))))


@pytest.mark.parametrize("late", [0, 5])
def test_learning_reduces_the_error_to_the_noise(late):
    life = Life(late=late)
    learnt = [life.cycle() for _ in range(12)]
    assert learnt[0]
    assert life.errors[-1] < 1.5 * NOISE < 0.05 * life.errors[0]
    assert max(life.errors) == life.errors[0] and len(life.repetition.errors) == 12
    assert np.abs(life.repetition.correction).max() <= life.repetition.bound


def test_what_was_learnt_is_a_wave_table():
    life = Life()
    assert sum(life.cycle() for _ in range(10)) > 1
    table = life.repetition.table()
    assert len(table.cycle) == len(PATH) and table.settled and table.sample_rate == 1 / PERIOD
    again = AGED.simulate(np.tile(table.cycle.voltage, 2), state=life.state, extrapolate=True).displacement
    assert np.abs(again - np.tile(PATH, 2))[len(PATH) :].max() < 10 * NOISE
    with pytest.raises(ModelError, match="nothing was learnt"):
        Life().repetition.table()


def test_a_cycle_of_a_slow_sensor_is_learnt_and_one_with_a_gap_is_not():
    life = Life()
    life.cycle(lambda y: np.where(np.arange(y.size) % 7, np.nan, y))
    assert np.any(life.repetition.correction)
    life = Life()
    assert not life.cycle(lambda y: np.where(np.arange(y.size) < 50, np.nan, y))
    assert not np.any(life.repetition.correction) and life.repetition.believed


def test_a_first_cycle_without_any_error_is_the_best_one():
    repetition = Repetition(Compensator(PLANT, (-20, 220), period=PERIOD), PATH)
    for worse in (0.0, 0.01, 0.02, 0.02, 0.02):
        repetition.next()
        repetition.learn(PATH + worse * np.ptp(PATH) * np.sin(np.arange(len(PATH))))
    assert repetition.errors[0] == 0 and repetition.believed
    assert np.abs(repetition.correction).max() <= repetition.bound


def test_a_clamped_cycle_is_not_learnt():
    life = Life(limits=(-20, 100))
    assert not life.cycle() and not life.repetition.errors
    with pytest.warns(ClampWarning):
        Repetition(Compensator(PLANT, (0, 100), period=PERIOD), PATH).next()


@pytest.mark.parametrize(
    "sensor",
    [lambda y: 0.9 * STROKE - y, lambda y: 1e6 * y, lambda y: 0 * y + 0.45 * STROKE, lambda y: np.roll(y, 60)],
)
def test_a_faulty_sensor_is_not_believed(sensor):
    life = Life()
    for _ in range(3):
        life.cycle()
    with pytest.warns(SensorWarning) as caught:
        life.cycle(sensor)
    assert len(caught) == 1 and life.repetition.fault is SensorFault.FAR and not np.any(life.repetition.correction)
    assert not life.cycle(sensor) and not life.cycle(sensor)
    assert life.errors[-1] == pytest.approx(life.errors[0], rel=0.05)
    life.repetition.reset()
    assert life.repetition.believed and life.cycle()


def test_an_error_that_grows_returns_to_the_best_cycle():
    life = Life()
    assert all([life.cycle() for _ in range(8)][:1])
    best = life.repetition._best.correction
    assert not life.cycle(lambda y: y + 0.01 * STROKE)
    np.testing.assert_array_equal(life.repetition.correction, best)


@pytest.mark.parametrize(
    ("hertz", "quality"), [(80, 25), (60, 10), (120, 50), (150, 100), (20, 20), (24, 100), (34, 5)]
)
def test_a_resonance_that_no_record_showed_does_no_harm(hertz, quality):
    """A plain law multiplies the error at the resonance, of the fifth to 38th harmonic, in each cycle."""
    life, pole = Life(), 2 * np.pi * hertz * PERIOD * complex(-0.5 / quality, np.sqrt(1 - 0.25 / quality**2))
    swing, pushed, errors = 0j, PATH[0], []
    for _ in range(25):
        motion = AGED.simulate(life.repetition.next(), state=life.state, extrapolate=True)
        life.state, found = motion.state, []
        for push in motion.displacement.tolist():
            swing = (swing + complex(1, pole.real / pole.imag) * (push - pushed)) * np.exp(pole)
            pushed = push
            found.append(push - swing.real)
        errors.append(float(np.sqrt(np.mean((found - PATH) ** 2))))
        life.repetition.learn(found + NOISE * life.random.standard_normal(len(PATH)))
    assert max(errors) <= 1.2 * errors[0] and min(errors) < 0.3 * errors[0] and life.repetition.believed


@pytest.mark.parametrize(("rates", "learnt"), [((0.05, 2.0), True), ((2.0, 2.0), False)])
def test_records_of_several_speeds_exclude_a_resonance_at_the_harmonics_of_an_error(rates, learnt):
    tested = Validity(NOISE, NOISE, 0.0, STROKE, limits=(0, 200), speeds=(10.0, 400.0), rates=rates)
    life, ripple = Life(known=Identification(validity=tested)), 0.01 * STROKE * np.sin(np.arange(250) * np.pi * 6 / 125)
    for _ in range(7):
        life.cycle(lambda y: y + ripple)
    assert (life.repetition.errors[-1] < 0.02 * life.repetition.errors[0]) == learnt


def test_axes_of_a_stage_are_learnt_together():
    stage = dehyst.Stage((PLANT, PLANT), coupling=[[1, 0.02], [0.01, 1]])
    aged = dehyst.Stage((AGED, PLANT), coupling=stage.coupling)
    path = np.column_stack([PATH, 0.9 * np.roll(PATH, 60) + 0.05 * STROKE])
    starts = [turned(PLANT, float(y), rising=False) for y in path[0] @ np.linalg.inv(stage.coupling).T]
    loop = dehyst.Compensator(stage, period=PERIOD, limits=(-20, 220), state=starts)
    repetition, states, errors = Repetition(loop, path), starts, []
    for _ in range(6):
        motion = aged.simulate(repetition.next(), states=states)
        states, moved = motion.state, motion.displacement
        errors.append(np.abs(moved - path).max())
        repetition.learn(moved)
    assert errors[-1] < 0.2 * errors[0]
    assert [len(table.cycle) for table in repetition.table()] == [250, 250]


def test_a_wrong_argument_of_a_repetition_is_named():
    loop = Compensator(PLANT, (0, 100), period=PERIOD)
    with pytest.raises(ModelError, match="period"):
        Repetition(Compensator(PLANT, (0, 100)), PATH)
    for path in ([], np.zeros(1), [0.0, np.nan], [1e40, 2.0], np.zeros((5, 2)), ["a", "b"], [1j, 2j]):
        with pytest.raises(ModelError):
            Repetition(loop, path)
    life = Life()
    with pytest.raises(ModelError, match="next"):
        life.repetition.learn(PATH)
    life.repetition.next()
    with pytest.raises(ModelError, match="shape"):
        life.repetition.learn(PATH[:-1])
