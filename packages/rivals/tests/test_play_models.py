"""Baselines made of play operators: their own truths recovered, fair fits of virtual actuators, refusals."""

from functools import cache, partial
from itertools import pairwise

import numpy as np
import pytest
from truths import BoucWenActuator, PreisachActuator
from virtual_trials import TRIALS

from dehyst import IdentifyError, ModelError, Record, RecordError
from dehyst.trust import AbstractBaseline
from dehyst.trust.baselines import Linear
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, standard
from dehyst_rivals import RIVALS
from dehyst_rivals.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    differences,
    low_pass,
    with_unknown_start,
)
from dehyst_rivals.plays import PlayBank
from dehyst_rivals.training import PlayRows, prepare_training, ramps
from examples import at_night

MODELS = [PrandtlIshlinskii, ModifiedPrandtlIshlinskii, GeneralizedPrandtlIshlinskii, KrasnoselskiiPokrovskii]
VOLTS, STROKE = 200.0, 16e-6
TOPS = (0, 1, 0, 1, 0, 0.9, 0, 0.8, 0, 0.7, 0, 0.6, 0, 0.5, 0, 0.4, 0, 0.3, 0, 0.2, 0, 0.1, 0)
CURVES = (0, 1, 0, 1, *(x for low in np.arange(0.95, 0, -0.05) for x in (low, 1)), 0)


def through(turns, samples=100, volts=VOLTS):
    """Voltage [V] through turning points given as fractions, half a cosine for each branch."""
    u = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples + 1) / samples)
    return volts * np.concatenate([[turns[0]], *(a + (b - a) * u for a, b in pairwise(turns))])


def recorded(simulate, voltage, *, seconds=0.05, name="made", **options):
    """The record of what `simulate` makes of a voltage."""
    time = seconds * np.arange(1, voltage.size + 1)
    return Record(time, voltage, simulate(voltage, time=time, **options), name)


def of_bank(bank, voltage, **options):
    return recorded(lambda v, time: bank.simulate(v, bank.state_after_descent(0.0), time)[0], voltage, **options)


def wander(seed, turns=100, samples=50):
    """Voltage [V] through random turning points."""
    return through(np.concatenate([[0, 1, 0], np.random.default_rng(seed).uniform(0.02, 0.98, turns)]), samples)


def missed(found, truth, seed=1, seconds=0.05):
    """Largest and RMS error in % of the stroke on a held-out path: simulated, and tracked by compensation."""
    home = through((0, 1, 0, 1, 0))
    voltage = wander(seed)
    time = seconds * np.arange(1, home.size + 1)
    later = time[-1] + seconds * np.arange(1, voltage.size + 1)
    truth.play(home, time=time)
    start = found.simulate(home, time=time).state
    y = truth.play(voltage, time=later, measured=False)
    free = y - found.simulate(voltage, state=start, time=later).displacement
    start = found.simulate(voltage, state=start, time=later).state
    after = later[-1] + seconds * np.arange(1, voltage.size + 1)
    path = 0.03 * STROKE + 0.93 * STROKE / VOLTS * wander(seed + 1)
    sent = found.compensate(path, state=start, time=after).voltage
    track = truth.play(sent, time=after, measured=False) - path
    return [
        100 * norm / truth.stroke
        for e in (free - free.mean(), track - track.mean())
        for norm in (np.abs(e).max(), np.sqrt(np.mean(e**2)))
    ]


def training(kind, **options):
    """Falling tops at two speeds, and a staircase where there is creep."""
    records = [
        recorded(kind(seed=i, **options).play, through(TOPS, 100 + 100 * i), seconds=0.02 + 0.03 * i) for i in range(2)
    ]
    if options:
        stairs = standard.staircase(VOLTS, steps=5, hold=60.0, drive=Sampling(0.1, sample_rate=20.0))
        voltage = np.concatenate([through((0, 1, 0, 1, 0), 200), stairs.voltage])
        records.append(recorded(kind(seed=9, **options).play, voltage, name="stairs"))
    return records


@cache
def fitted(kind, truth):
    """A rival fitted to the training records of a truth, which may be `CREEPING`."""
    options = CREEPING.keywords if truth is CREEPING else {}
    return kind.fit(training(truth.func if options else truth, **options), delay=0.0)


def test_the_weights_of_a_prandtl_ishlinskii_truth_are_recovered():
    rng = np.random.default_rng(3)
    weights = rng.exponential(2e-9, 20) * (rng.random(20) > 0.3)
    weights[0] = 5e-8
    bank = PlayBank(0.5 * VOLTS * np.arange(20) / 20, [()] * 20, list(weights[:, None]), 2e-6)
    found = PrandtlIshlinskii.fit(of_bank(bank, through(TOPS)), delay=0.0, drift=False)
    np.testing.assert_allclose(found.weights, weights, rtol=0, atol=1e-9 * weights.max())
    assert found.parameters == 21
    lowest = bank.simulate(np.zeros(1), bank.state_after_descent(0.0), None)[0]
    assert found.simulate(np.zeros(1)).displacement == pytest.approx(lowest, abs=1e-9 * STROKE)


def test_plays_that_never_move_only_add_a_constant():
    """A small loop from an unknown state and a large one: each stretch has its offset, and the weights are exact."""
    weights = np.append(5e-8, np.full(9, 3e-9))
    bank = PlayBank(10.0 * np.arange(10), [()] * 10, list(weights[:, None]))
    start = bank.simulate(through((0, 1, 0.3, 0.6)), bank.state_after_descent(0.0), None)[1]
    small = recorded(lambda v, time: bank.simulate(v, start, time)[0] + 3e-6, through((0.6, 0.4, 0.65, 0.4, 0.65, 0.4)))
    large = of_bank(bank, through((0, 1, 0, 1, 0)))
    found = PrandtlIshlinskii.fit([small, large], plays=10, delay=0.0, drift=False)
    np.testing.assert_allclose(found.weights, weights, rtol=0, atol=1e-9 * weights.max())


def test_a_modified_prandtl_ishlinskii_truth_is_recovered():
    weights = np.append(0.5, 0.1 * np.exp(-np.arange(9.0)))
    thresholds = 10.0 * np.arange(10)
    weights /= weights @ (VOLTS - 2 * thresholds) / VOLTS
    bank = PlayBank(thresholds, [()] * 10, list(weights[:, None]), -float(weights @ thresholds))
    places = np.linspace(0, VOLTS, 6)
    values = np.concatenate([[0.0], np.cumsum([1.4, 0.9, 0.7, 0.9, 1.1])]) / 5.0 * STROKE
    own = ModifiedPrandtlIshlinskii(bank, places, values, bank.state_after_descent(0.0))
    record = recorded(lambda v, time: own.simulate(v, time=time).displacement, through(TOPS))
    found = ModifiedPrandtlIshlinskii.fit(record, plays=10, segments=5, delay=0.0, drift=False)
    np.testing.assert_allclose(found.weights, weights, rtol=0, atol=1e-4)
    np.testing.assert_allclose(found.values, values, rtol=0, atol=1e-4 * STROKE)
    assert found.parameters == 15


def test_kernels_agree_with_their_definition():
    """K <- min(max(k, r(v - p2)), r(v - p1)), kernel by kernel, against the plays with ramps."""
    found = KrasnoselskiiPokrovskii.fit(recorded(PreisachActuator().play, through(TOPS)), levels=6, delay=0.0)
    voltage, spacing = wander(5, 40, 10)[1:], VOLTS / 6
    expected = np.zeros(voltage.size)
    for i, (knots, slopes) in enumerate(zip(found.bank.knots, found.bank.slopes, strict=True)):
        weights = slopes[1:-1] * spacing
        assert knots.size == 7 - i
        for j, weight in enumerate(weights):
            p1, p2, k = j * spacing, (j + i) * spacing, 0.0
            for t, v in enumerate(voltage):
                low, high = (np.clip((v - p) / spacing, 0, 1) for p in (p2, p1))
                k = min(max(k, low), high)
                expected[t] += weight * k
    y = found.simulate(voltage, state=found.bank.state_after_descent(0.0)).displacement
    np.testing.assert_allclose(y - y[0], expected - expected[0], rtol=0, atol=1e-12 * STROKE)
    assert found.parameters == 22


def test_a_krasnoselskii_pokrovskii_truth_is_recovered():
    rng = np.random.default_rng(2)
    first = KrasnoselskiiPokrovskii.fit(recorded(PreisachActuator().play, through(TOPS)), levels=10, delay=0.0)
    slopes = [s * np.where(s > 0, rng.uniform(0.5, 1.5, s.size), 0) for s in first.bank.slopes]
    slopes[0][[0, -1]] = slopes[0][[1, -2]]
    truth = PlayBank(first.bank.thresholds, first.bank.knots, slopes)
    found = KrasnoselskiiPokrovskii.fit(
        of_bank(truth, through(CURVES)), levels=10, smoothing=0.0, delay=0.0, drift=False
    )
    voltage = wander(8)
    y, guess = truth.simulate(voltage, truth.state_after_descent(0.0), None)[0], found.simulate(voltage).displacement
    np.testing.assert_allclose(guess - guess[0], y - y[0], rtol=0, atol=1e-7 * STROKE)


CREEPING = partial(PlayActuator, creep=0.02)
# Largest and RMS error simulated, then tracked, in % of the stroke, as measured. The first truth is of Kuhnen's class.
NUMBERS = [
    (PrandtlIshlinskii, PlayActuator, (2.67, 0.69, 2.37, 0.64)),
    (ModifiedPrandtlIshlinskii, PlayActuator, (0.12, 0.021, 0.089, 0.021)),
    (GeneralizedPrandtlIshlinskii, PlayActuator, (0.19, 0.039, 0.26, 0.053)),
    (KrasnoselskiiPokrovskii, PlayActuator, (0.17, 0.037, 0.24, 0.051)),
    (PrandtlIshlinskii, PreisachActuator, (3.06, 1.48, 3.02, 1.33)),
    (ModifiedPrandtlIshlinskii, PreisachActuator, (0.40, 0.12, 0.43, 0.12)),
    (GeneralizedPrandtlIshlinskii, PreisachActuator, (0.049, 0.012, 0.053, 0.011)),
    (KrasnoselskiiPokrovskii, PreisachActuator, (0.037, 0.010, 0.047, 0.010)),
    (GeneralizedPrandtlIshlinskii, CREEPING, (0.36, 0.14, 0.30, 0.072)),
    (KrasnoselskiiPokrovskii, CREEPING, (3.1, 0.55, 2.2, 0.46)),
]


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "truth", "numbers"), NUMBERS)
def test_errors_on_held_out_paths_are_within_their_bounds(kind, truth, numbers):
    got = missed(fitted(kind, truth), truth())
    # Half as much again for other processors' rounding, which moves what nonnegative least squares keeps.
    assert np.all(np.array(got) < 1.5 * np.array(numbers))


@pytest.mark.nightly
def test_low_passes_are_kept_only_with_creep():
    assert fitted(GeneralizedPrandtlIshlinskii, CREEPING).bank.times.size > 4
    assert fitted(GeneralizedPrandtlIshlinskii, PreisachActuator).bank.times.size == 0
    assert fitted(GeneralizedPrandtlIshlinskii, BoucWenActuator).bank.times.size == 0


def test_low_passes_of_a_record_are_exact_for_straight_branches():
    time, v = np.array([0.0, 1, 3, 3.5]), np.array([2.0, 5, 5, -1])
    fine = np.linspace(0, 3.5, 70001)
    expected, q = [2.0], 2.0
    step = fine[1]
    for middle in np.interp(0.5 * (fine[1:] + fine[:-1]), time, v):
        q += (middle - q) * -np.expm1(-step / 0.7)
        expected.append(q)
    passed = low_pass(Record(time, v, v), np.array([0.7]))
    np.testing.assert_allclose(passed[:, 0], np.interp(time, fine, expected), atol=1e-7)


@pytest.mark.parametrize("kind", [MODELS[0], *map(at_night, MODELS[1:])])
def test_each_record_has_a_free_offset(kind):
    trial = training(PlayActuator)
    moved = [Record(r.time, r.voltage, r.displacement + 2e-6 * q, r.name) for q, r in enumerate(trial)]
    alike = fitted(kind, PlayActuator), kind.fit(moved, delay=0.0)
    first, second = (model.simulate(wander(3), time=None).displacement for model in alike)
    np.testing.assert_allclose(second - second[0], first - first[0], rtol=0, atol=1e-6 * STROKE)


@pytest.mark.parametrize("kind", [MODELS[0], *map(at_night, MODELS[1:])])
def test_the_zero_of_the_voltage_has_no_effect(kind):
    trial = training(PlayActuator)
    moved = [Record(r.time, r.voltage - 70.0, r.displacement, r.name) for r in trial]
    first = fitted(kind, PlayActuator).simulate(wander(3)).displacement
    second = kind.fit(moved, delay=0.0).simulate(wander(3) - 70.0).displacement
    np.testing.assert_allclose(second, first, rtol=0, atol=1e-6 * STROKE)


def test_a_delay_is_found_and_the_voltage_is_delayed_by_it():
    truth, voltage, seconds = PlayActuator(), through(TOPS), 0.05
    time = seconds * np.arange(1, voltage.size + 1)
    late = np.interp(time - 0.08, time, voltage)
    record = Record(time, voltage, truth.play(late), "late")
    assert prepare_training(record).delay == pytest.approx(0.08, abs=0.1 * seconds)
    assert prepare_training(recorded(PlayActuator().play, voltage)).delay == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("kind", MODELS)
def test_a_resonance_does_not_shift_the_axis(kind):
    """Driven slowly, a model of an actuator that was recorded swinging is nowhere far off, and on the whole not off."""
    trial = TRIALS["boucwen"]
    found = kind.fit(trial.records(), delay=2e-4)
    slow = standard.raised_cosine(VOLTS, cycles=2, drive=Sampling(frequency=1.0, sample_rate=2000.0))
    y = trial.truth(3).play(slow.voltage, time=slow.time, measured=False)
    error = (found.simulate(slow.voltage, time=slow.time).displacement - y)[slow.time.size // 2 :] / STROKE
    assert np.abs(error).max() < 0.03
    assert abs(error.mean()) < 0.01


def test_the_initial_outputs_of_low_passes_have_no_effect():
    """One record, begun from rest and begun in the midst of motion: low-passes and slopes are the truth's."""
    truth = PlayBank([0.0, 20.0], [()] * 2, [[5e-8], [2e-8]], 0.0, [2.0, 30.0], [3e-9, 4e-9])
    before, voltage = through((0, 1, 0.4, 1)), through((1, 0, 1, 0, 0.7, 0.2, 0.9, 0))
    time = 0.05 * np.arange(before.size + voltage.size)
    state = truth.simulate(before, truth.state_after_descent(0.0), time[: before.size])[1]
    y = truth.simulate(voltage, state, time[before.size :])[0]
    record = Record(time[before.size :], voltage, y, "later")
    ready = prepare_training(record, delay=0.0, drift=False)

    def fitted_to(training):
        rows = PlayRows.from_training(training, truth.thresholds)
        passed = rows.training.sampled(lambda piece: low_pass(piece, truth.times))
        return rows.fit(np.hstack([rows.ramps(), passed]))

    found = fitted_to(with_unknown_start(ready, truth.times))
    np.testing.assert_allclose(found.weights, [5e-8, 2e-8, 3e-9, 4e-9], rtol=1e-6)
    assert found.rms < 1e-9 * STROKE
    assert fitted_to(ready).rms > 1e-5 * STROKE


@pytest.mark.parametrize("kind", [Linear, *dict.fromkeys(fit.__self__ for fit in RIVALS.values())])
def test_every_model_is_a_final_subclass_of_the_baseline(kind):
    assert issubclass(kind, AbstractBaseline)
    assert kind.__final__


def test_only_a_model_with_creep_needs_the_time():
    creeping = GeneralizedPrandtlIshlinskii.fit(training(PlayActuator), lowpasses=[1.0, 30.0], delay=0.0)
    with pytest.raises(ModelError, match="model creeps:"):
        creeping.simulate([0, 1])
    with pytest.raises(ModelError, match="model creeps:"):
        creeping.compensate([0, 1e-6])
    path = creeping.simulate(wander(1), time=np.arange(wander(1).size)).displacement
    sent = creeping.compensate(path, time=np.arange(path.size)).voltage
    np.testing.assert_allclose(sent, wander(1), rtol=0, atol=1e-9 * VOLTS)


def test_ramps_and_differences_of_neighbours_are_right():
    z = np.array([-1.0, 0.5, 1.5, 4.0])
    np.testing.assert_allclose(ramps(z, np.array([0.0, 1, 3])) @ [1, 2, 3, 4], [-1, 1, 3.5, 12])
    np.testing.assert_allclose(ramps(z, np.zeros(0)) @ [2], 2 * z)
    rough = differences([3, 2, 2])
    assert rough.shape == (4, 7)
    np.testing.assert_array_equal(rough[:, :3], 0)
    np.testing.assert_allclose(rough @ np.array([9, 9, 9, 1, 2, 4, 8.0]), [-1, -3, -6, -4])


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"slope_floor": 0.0}, "slope_floor: got 0, need a number"),
        ({"delay": -1.0}, r"delay: got -1.0, need seconds, 0 or more and less than a quarter of a cycle of 10.05 s"),
        ({"delay": 2.6}, r"delay: got 2.6, need seconds"),
        ({"plays": 0, "levels": 0}, r"(plays|levels): got 0, need a whole number from 1 to"),
        ({"plays": True, "levels": True}, r"(plays|levels): got True, need a whole number"),
    ],
)
def test_impossible_options_are_refused(kind, options, message):
    own = {
        key: value
        for key, value in options.items()
        if key != ("plays" if kind is KrasnoselskiiPokrovskii else "levels")
    }
    with pytest.raises(IdentifyError, match=message):
        kind.fit(recorded(PlayActuator().play, through(TOPS)), **own)


@pytest.mark.parametrize("kind", MODELS)
def test_other_objects_than_records_are_refused(kind):
    with pytest.raises(IdentifyError, match="no records"):
        kind.fit([])
    with pytest.raises(IdentifyError, match=r"need records"):
        kind.fit("loop.csv")
    with pytest.raises(RecordError, match="full cycle"):
        kind.fit(recorded(PlayActuator().play, through((0, 1))))


def test_impossible_curves_and_times_are_refused():
    record = recorded(PlayActuator().play, through(TOPS))
    with pytest.raises(IdentifyError, match="constants above 0"):
        GeneralizedPrandtlIshlinskii.fit(record, lowpasses=[0.0])
    with pytest.raises(IdentifyError, match="lowpasses: 1 of 1 values"):
        GeneralizedPrandtlIshlinskii.fit(record, lowpasses=[np.nan])
    bank = PlayBank([0.0], [()], [[1.0]])
    with pytest.raises(ModelError, match=r"values: got .*strictly increasing"):
        ModifiedPrandtlIshlinskii(bank, [0, 1], [1, 1], bank.state_after_descent(0))
    with pytest.raises(ModelError, match="values: got 3"):
        ModifiedPrandtlIshlinskii(bank, [0, 1], [1, 2, 3], bank.state_after_descent(0))
