"""The integral of a sensor's error: its gain, its bound, and when it is no longer believed."""

import warnings
from dataclasses import replace

import numpy as np
import plain_records
import pytest

import dehyst
from dehyst import ClampWarning, Compensator, Dynamics, Feedback, ModelError
from dehyst.control import SensorFault, SensorWarning
from dehyst.model import turned
from examples import at_night

PLANT, STROKE, PERIOD = plain_records.plant(10, seed=4), plain_records.STROKE, 1e-3
AGED = replace(PLANT, spring=replace(PLANT.spring, voltage=1.02 * PLANT.spring.voltage))
PATH = STROKE * (0.45 - 0.4 * np.cos(2 * np.pi * np.arange(2000) / 1000))


def tracked(sensor, *, plant=AGED, path=PATH, **options):
    """Follow a path on a plant; return true displacements (n,), and the feedback."""
    start = turned(PLANT, float(path[0]), rising=False)
    loop = Compensator(PLANT, (-20, 220), period=PERIOD, state=start, warns=False)
    feedback, state, said, found = Feedback(loop, **options), start, None, np.empty(path.size)
    for k, wanted in enumerate(path.tolist()):
        motion = plant.simulate([feedback.step(wanted, said)], state=state, extrapolate=True)
        state, found[k] = motion.state, motion.displacement[0]
        said = sensor(k, found[k])
    return found, feedback


def largest(found, path=PATH):
    return float(np.abs(found - path)[path.size // 2 :].max())


def test_an_aged_actuator_is_followed():
    frozen, none = tracked(lambda k, y: None)
    assert none.correction == 0 and none.believed
    fast, feedback = tracked(lambda k, y: y)
    slow, _ = tracked(lambda k, y: y if k % 7 == 0 else None)
    assert largest(fast) < 0.5 * largest(frozen) and largest(fast) < largest(slow) < largest(frozen)
    assert feedback.believed and 0 < abs(feedback.correction) < feedback.bound


SMALL = STROKE * (0.45 - 0.05 * np.cos(2 * np.pi * np.arange(2000) / 100))
LIES = {
    "inverted": (lambda k, y: 0.9 * STROKE - y, SensorFault.CONTRADICTS),
    "late by a quarter": (lambda k, y: float(SMALL[(k - 25) % 100]), SensorFault.CONTRADICTS),
    "micrometres": (lambda k, y: 1e6 * y, SensorFault.FAR),
    "zero far away": (lambda k, y: y + 0.25 * STROKE, SensorFault.FAR),
    "stuck": (lambda k, y: 0.45 * STROKE, SensorFault.STUCK),
    "three times": (lambda k, y: 0.45 * STROKE + 3 * (y - 0.45 * STROKE), SensorFault.SCALED),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_sensor_that_contradicts_the_model_is_not_believed(lie):
    sensor, fault = LIES[lie]
    with pytest.warns(SensorWarning, match="SENSOR NOT BELIEVED") as caught:
        found, feedback = tracked(sensor, plant=PLANT, path=SMALL, bound=0.2 * STROKE)
    assert [type(warning.message) for warning in caught] == [SensorWarning] and caught[0].message.fault is fault
    assert caught[0].filename == __file__
    assert not feedback.believed and feedback.fault is fault and feedback.correction == 0
    assert np.abs(found[-1000:] - SMALL[-1000:]).max() < 1e-9 * STROKE
    feedback.reset()
    assert feedback.believed


@pytest.mark.parametrize("cycles", [0, 1, at_night(2)])
def test_a_sensor_late_by_whole_cycles_is_not_believed(cycles):
    """Its motion is right; it answers the correction a cycle later. One in time is believed, noise and knocks too."""
    path = np.tile(STROKE * (0.45 - 0.3 * np.cos(2 * np.pi * np.arange(600) / 600)), 25)
    rng, told = np.random.default_rng(1), [float(path[0])] * 1200

    def sensor(k, y):
        knock = 0.02 * STROKE if cycles == 0 and 7000 <= k < 7100 else 0.0
        told.append(float(y) + 1e-3 * STROKE * rng.standard_normal() + knock)
        return told[-1 - 600 * cycles * (k > 3000)]

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SensorWarning)
        found, feedback = tracked(sensor, path=path)
    errors = np.abs(found - path).reshape(25, 600).max(axis=1)
    frozen = np.abs(AGED.simulate(PLANT.compensate(path).voltage, extrapolate=True).displacement - path).max()
    assert feedback.believed is (cycles == 0) and errors.max() < 4 * frozen
    assert errors[-1] < (0.5 if cycles == 0 else 1.1) * frozen


def test_readings_that_are_no_numbers_hold_the_correction():
    _, feedback = tracked(lambda k, y: y if k < 1000 else (np.nan, np.inf, -np.inf)[k % 3])
    kept = tracked(lambda k, y: y if k < 1000 else None)[1].correction
    assert feedback.believed and feedback.correction == kept != 0


def test_missing_readings_hold_the_mean_correction():
    path = np.tile(PATH, 3)
    found, feedback = tracked(lambda k, y: y if k < 2250 else None, path=path)
    frozen = tracked(lambda k, y: None, path=path)[0]
    assert feedback.believed and 0 < abs(feedback.correction) < feedback.bound
    assert np.abs(found - path)[-1000:].max() < np.abs(frozen - path)[-1000:].max()


def test_the_integral_does_not_wind_up_at_a_limit():
    loop = Compensator(PLANT, (0, 100), period=PERIOD, state=turned(PLANT, 0.3 * STROKE), warns=False)
    feedback, state = Feedback(loop), loop.state
    said = None
    for _ in range(3000):
        motion = AGED.simulate([feedback.step(2 * STROKE, said)], state=state)
        state, said = motion.state, float(motion.displacement[0])
    assert loop.voltage == 100
    assert feedback.correction == pytest.approx(loop.displacement - said, abs=1e-6 * STROKE)


def test_a_refused_step_changes_nothing():
    feedback = Feedback(Compensator(PLANT, (-20, 220), period=PERIOD, state=turned(PLANT, 0.3 * STROKE)))
    feedback.step(0.3 * STROKE, 0.3 * STROKE)
    before = feedback.correction, feedback.compensator.snapshot()
    for bad in ((np.nan, 0.31 * STROKE), *((0.3 * STROKE, reading) for reading in ("abc", b"x", 1j, [1, 2], {}))):
        with pytest.raises(ModelError, match="number"):
            feedback.step(*bad)
    with warnings.catch_warnings():
        warnings.simplefilter("error", ClampWarning)
        with pytest.raises(ClampWarning):
            feedback.step(5 * STROKE, 0.31 * STROKE)
    assert (feedback.correction, feedback.compensator.snapshot()) == before


def test_a_wrong_argument_of_a_feedback_is_named():
    with pytest.raises(ModelError, match="period"):
        Feedback(Compensator(PLANT, (0, 100)))
    for margin in (-1, 1e9):
        with pytest.raises(ModelError, match="margin_db"):
            Feedback(Compensator(PLANT, (0, 100), period=PERIOD), margin)
    with pytest.raises(ModelError, match="63"):
        Feedback(Compensator(replace(PLANT, delay=0.1), (0, 100), period=PERIOD))
    with pytest.raises(ModelError, match="bound"):
        Feedback(Compensator(PLANT, (0, 100), period=PERIOD), bound=0.0)


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize(("frequency", "quality"), [(300.0, 5), (800.0, 25), (800.0, 100), (5000.0, 50)])
def test_the_gain_keeps_its_margin_with_a_resonance(frequency, quality, preview):
    """A linear plant by its own mathematics, its resonance 3 % beside the identified one."""
    period, zeta = 1e-4, 0.5 / quality
    spring = dehyst.Spring([0, 1e-5], [0, 100])
    model = dehyst.Actuator(
        dehyst.MaxwellSlip([], []), spring, dynamics=Dynamics(1.03 * frequency, zeta), limits=(0, 100)
    )
    gain, bandwidth = model.margins(period, preview=preview)
    assert 0 < gain <= model.margins(period, 3, preview=preview)[0] <= 1 and 0 < bandwidth < 0.5 / period
    loop = Compensator(model, period=period, preview=preview, state=turned(model, 5e-6))
    feedback, pole = Feedback(loop), 2 * np.pi * frequency * complex(-zeta, np.sqrt(1 - zeta**2))
    swing, pushed, y = 0j, 5e-6, 5e-6
    for _ in range(int(30 / gain)):
        push = 1e-7 * feedback.step(5e-6, y + 1e-7)
        swing = (swing + complex(1, pole.real / pole.imag) * (push - pushed)) * np.exp(pole * period)
        pushed, y = push, push - swing.real
    assert abs(y + 1e-7 - 5e-6) < 1e-9
