"""The identification against actuators that are known: what records tell, what they leave open, what is refused."""

import json
import signal
from dataclasses import replace
from functools import cache

import coupled_stage
import numpy as np
import plain_records
import pytest
import structured_records as wide

import dehyst
from dehyst import Actuator, IdentifyError, Record, RecordError
from dehyst.identification import Deadline, Structure, messages
from dehyst.model import Outcome, turned
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine
from examples import at_night

PLANT, STROKE = plain_records.plant(10), plain_records.STROKE
TEN = Structure(elements=10, knots=11, smoothing=0.0)
TOPS = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, name="tops")
EXCITATIONS = {
    "tops": plain_records.DESCENDING_TOPS,
    "curves": plain_records.REVERSAL_CURVES,
    "three loops": plain_records.THREE_LOOPS,
}


def assert_recovered(fit, plant, tolerance=1e-5):
    assert fit.outcome is Outcome.IDENTIFIED
    np.testing.assert_allclose(fit.actuator.slip.breakaway, plant.slip.breakaway, rtol=tolerance)
    assert plain_records.stiffness_error(fit.actuator, plant) < tolerance
    assert plain_records.spring_error(fit.actuator, plant) < tolerance
    assert all(error.settled_largest < tolerance * error.stroke for error in fit.errors)


@pytest.mark.parametrize("name", ["tops", *map(at_night, ["curves", "three loops"])])
def test_a_known_model_is_recovered(name):
    plant = plain_records.plant(10, seed=3)
    fit = dehyst.identify(plain_records.loops(plant, EXCITATIONS[name]), structure=TEN)
    assert_recovered(fit, plant)
    assert fit.repairs == ()
    np.testing.assert_allclose(fit.actuator.spring.voltage, plant.spring.voltage, atol=1e-3)
    # A path that it never saw.
    path = plain_records.path(np.append(1.0, np.random.default_rng(1).uniform(0, 1, 30)))
    v = plant.compensate(path).voltage
    assert np.abs(fit.simulate(v).displacement - path).max() < 1e-5 * STROKE


@pytest.mark.parametrize("seed", [0, at_night(1)])
def test_the_initial_positions_of_carts_have_no_effect(seed):
    y = plain_records.path((0.4, *plain_records.THREE_LOOPS))
    state = plain_records.any_state(PLANT, float(y[0]), seed)
    assert_recovered(dehyst.identify(plain_records.record(PLANT, y, state=state), structure=TEN), PLANT)


@pytest.mark.parametrize(("lines", "bound"), [(0, 5e-3), (60, 1e-2)])
def test_a_single_loop_is_identified_as_after_equal_loops(lines, bound):
    truth = PlayActuator(plays=60)
    loops = raised_cosine(truth.highest, cycles=2, drive=Sampling(0.1, sample_rate=100.0))
    whole = Record(loops.time, loops.voltage, truth.play(loops.voltage))
    loop = whole[1000:]
    if lines:
        known = np.append(False, np.diff(np.floor(lines * loop.displacement / truth.stroke)) != 0)
        loop = replace(loop, displacement=np.where(known, loop.displacement, np.nan), measured=known)
    fit = dehyst.identify(loop)
    assert fit.errors[0].rms == fit.promise.measured < 1e-3 * truth.stroke
    moved = fit.simulate(loops.voltage).displacement - whole.displacement
    assert np.ptp(moved[1000:]) < bound * truth.stroke
    assert "motion before the record" in fit.options["records"][0]["guesses"]
    beside = dehyst.identify([whole, replace(whole[1000:], name="one")])
    assert not any("guesses" in record for record in beside.options["records"])


@cache
def automatic():
    """The default structure, from loops with 1 nm of noise; and the record."""
    record = plain_records.loops(PLANT, plain_records.DESCENDING_TOPS, noise=1e-9, name="tops")
    return dehyst.identify(record), record


def test_the_dictionary_approximates_an_actuator_of_another_class():
    fit, _ = automatic()
    assert fit.outcome is Outcome.IDENTIFIED
    assert fit.good and fit.model is fit.actuator
    path = plain_records.path(np.append(1.0, np.random.default_rng(1).uniform(0, 1, 30)))
    unseen = plain_records.record(PLANT, path)
    assert fit.score(unseen).rms_percent < fit.promise.rms / STROKE * 100 < 0.5
    assert {trial.structure.smoothing for trial in fit.trials if trial.structure} >= {1e-2, 3e-2, 3e-3}
    assert json.loads(json.dumps(fit.as_dict(), allow_nan=False))["outcome"] == "IDENTIFIED"
    assert Actuator.from_dict(fit.actuator.as_dict()).as_dict() == fit.actuator.as_dict()


@pytest.mark.nightly
def test_the_same_call_gives_the_same_bits():
    fit, record = automatic()
    assert json.dumps(fit.as_dict()) == json.dumps(dehyst.identify(record, time_limit=1e6).as_dict())


def test_the_major_loop_alone_is_undetermined():
    fit = dehyst.identify(plain_records.loops(PLANT, plain_records.MAJOR * 2))
    assert fit.outcome is Outcome.UNDETERMINED
    assert fit.outcome.good
    # Nothing of that is missing in the text.
    assert fit.errors[0].settled_largest < 5e-3 * STROKE


def test_maxwell_slip_has_twenty_elements_and_a_spring():
    fit = dehyst.identify(TOPS, structure="maxwell_slip")
    assert not fit.actuator._wide
    assert fit.actuator.slip.stiffness.shape == (20,)
    assert fit.actuator.slip.stiffness.min() >= 0
    assert fit.errors[0].largest_percent < 1


def test_validation_records_get_errors_of_their_own():
    y = plain_records.path((0.3, 0.8, 0.2, 0.65, 0.1, 0.9, 0.3, 0.8, 0.35, 0.75))
    state = plain_records.any_state(PLANT, float(y[0]), 5)
    held_out = plain_records.record(PLANT, y, state=state, name="check", zero=0.05 * STROKE)
    alone, fit = dehyst.identify(TOPS, structure=TEN), dehyst.identify(TOPS, structure=TEN, validate=held_out)
    assert [(error.record, error.role) for error in fit.errors] == [("tops", "training"), ("check", "validation")]
    assert [(trace.record, trace.role) for trace in fit.traces] == [("tops", "training"), ("check", "validation")]
    assert fit.actuator.slip.stiffness.tobytes() == alone.actuator.slip.stiffness.tobytes()
    check, trace = fit.errors[1], fit.traces[1]
    assert check.largest_percent < 1e-3
    assert check.zero == pytest.approx(0.05 * STROKE, abs=1e-5 * STROKE)
    assert (check.samples, check.samples + check.left_out) == (trace.residual.size, len(held_out))
    assert fit.promise.basis == "validation records" != alone.promise.basis


def test_a_large_validation_error_is_the_outcome():
    other = plain_records.loops(plain_records.plant(10, seed=7, share=0.6), plain_records.THREE_LOOPS, name="other")
    fit = dehyst.identify(TOPS, structure=TEN, validate=other)
    assert fit.outcome is Outcome.VALIDATION_MISSED
    assert not fit.good


def test_a_loop_that_no_actuator_has_is_inaccurate():
    t = np.arange(4000) / 200
    y = 8e-6 * (1 - np.cos(0.5 * np.pi * t - 0.3)) + 3e-6 * np.sin(2 * np.pi * t / 1.37)
    fit = dehyst.identify(Record(t, 100 * (1 - np.cos(0.5 * np.pi * t)), y, "nonsense"), structure="maxwell_slip")
    assert fit.outcome is Outcome.INACCURATE
    assert not fit.outcome.good
    assert fit.errors[0].largest_percent > 5


def late(samples=4):
    """A record whose displacement is some samples late, with 1 nm of noise."""
    made = plain_records.loops(PLANT, plain_records.THREE_LOOPS, samples=100)
    y = np.interp(made.time - samples * made.sample_time, made.time, made.displacement)
    return Record(made.time, made.voltage, y + 1e-9 * np.random.default_rng(0).normal(size=y.size), "late")


@pytest.mark.parametrize("lag_of", [None, "actuator", "sensor"])
def test_the_cause_of_a_lag_is_stated_only_if_it_is_known(lag_of):
    fit = dehyst.identify(late(), structure=TEN, lag_of=lag_of)
    lag = fit.actuator.delay + fit.actuator.lag
    assert lag == pytest.approx(0.02, abs=0.001) == fit.options["delay_s"]
    assert fit.actuator.identification.lag_of == (lag_of or "")
    assert (fit.promise.promise.delay > 0) == (lag_of is None)
    without = dehyst.identify(TOPS, structure=TEN, lag_of=lag_of)
    assert (messages.NO_LAG in without.remarks) == (lag_of is not None)
    assert Actuator.from_dict(fit.actuator.as_dict()).identification.lag_of == (lag_of or "")


def test_a_given_delay_is_kept():
    assert dehyst.identify(late(), structure=TEN, delay=0.015).actuator.delay == 0.015


IMPOSSIBLE = [
    {"delay": np.inf},
    {"delay": -1.0},
    {"delay": 1e3},
    *({"sensor_lag": lag} for lag in (-1.0, 1e3, np.nan, "soon")),
    {"lag_of": "both"},
    {"structure": "wide"},
    {"structure": None},
    {"goal": 0},
    {"goal": 101},
    *({"time_limit": limit} for limit in (0, -1, float("nan"), float("inf"), "5", True)),
]


@pytest.mark.parametrize("options", IMPOSSIBLE, ids=str)
def test_impossible_options_are_refused(options):
    with pytest.raises(IdentifyError):
        dehyst.identify(TOPS, **options)


GROWING = plain_records.loops(PLANT, (0.5, 0.55, 0.44, 0.7, 0.2, 1.0), samples=16, state=turned(PLANT, 0.5 * STROKE))
COPY = Record(TOPS.time, TOPS.voltage, TOPS.displacement, "copy")


@pytest.mark.parametrize(
    "call",
    [
        lambda: dehyst.identify([]),
        lambda: dehyst.identify("record.csv"),
        lambda: dehyst.identify(GROWING),
        lambda: dehyst.identify([TOPS, COPY]),
        lambda: dehyst.identify(TOPS, validate=COPY),
    ],
)
def test_repeated_records_are_refused(call):
    with pytest.raises((IdentifyError, RecordError)):
        call()


BROKEN = {
    "constant": lambda v, y: (0 * v, y),
    "still": lambda v, y: (v, 0 * y),
    "clipped": lambda v, y: (v, np.minimum(y, 0.8 * y.max())),
    "half a cycle": lambda v, y: (v[:90], y[:90]),
}


@pytest.mark.parametrize("name", BROKEN)
def test_unusable_records_are_refused_in_training_and_validation(name):
    v, y = BROKEN[name](TOPS.voltage, TOPS.displacement)
    broken = Record(np.arange(v.size) / 200, v, y, name)
    for options in ({"records": [TOPS, broken]}, {"records": TOPS, "validate": broken}):
        with pytest.raises(RecordError, match=f"'{name}'"):
            dehyst.identify(**options)


@cache
def graded():
    return wide.plant(wide.STRUCTURES["graded"]).record(noise=1e-9)


@cache
def steps():
    """Number of the sentences of progress of an identification."""
    said = []
    dehyst.identify(graded(), progress=said.append)
    return len(said)


@pytest.mark.parametrize("place", [0.0, at_night(0.2), 0.5, at_night(0.8), at_night(1.0)])
def test_the_model_at_a_deadline_is_usable(place):
    """A request ends the searches at one of the steps, from the first to the last."""
    said, deadline = [], Deadline()
    at = round(place * (steps() - 1))

    def progress(words):
        said.append(words)
        if len(said) == at + 1:
            deadline.end()

    fit = dehyst.identify(graded(), progress=progress, time_limit=deadline)
    assert bool(deadline.cut) == (place < 1)
    assert len(fit.remarks) >= 1
    assert fit.outcome.good
    assert max(error.largest_percent for error in fit.errors) < 5
    voltage = np.linspace(*fit.actuator.limits, 50)
    assert np.isfinite(fit.actuator.simulate(voltage, time=np.arange(50) / 10).displacement).all()


def test_ctrl_c_in_python_is_a_keyboard_interrupt():
    def progress(words):
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        dehyst.identify(graded(), progress=progress)


def test_records_of_several_axes_give_a_stage():
    training, _ = coupled_stage.excited()
    fit = dehyst.identify(training)
    off = ~np.eye(2, dtype=bool)
    away = np.abs(fit.coupling - coupled_stage.COUPLING)[off]
    assert away.max() < 0.0005
    assert np.all(away < 3 * fit.uncertainty[off])
    assert fit.good
    assert [type(found) for found in fit.fits] == [dehyst.Fit, dehyst.Fit]
    assert fit.model is fit.stage
    assert max(error.rms_percent for error in fit.errors) < 0.2
    with pytest.raises((RecordError, IdentifyError)):
        dehyst.identify([training, training.axis(0)])
