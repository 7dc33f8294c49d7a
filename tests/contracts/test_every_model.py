"""What every model must do, ours and every baseline. To enter a model, add one line to `MODELS`.

A candidate makes a model that answers voltages between 0 and 100 V with displacements it can also be asked for.
"""

from collections.abc import Callable
from dataclasses import is_dataclass, replace
from functools import cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from dehyst import (
    Actuator,
    Creep,
    DisplacementCreep,
    GradedSlip,
    MaxwellSlip,
    ModelError,
    Record,
    SmoothSlip,
    Spring,
    Transformer,
)
from dehyst.baselines import GoldfarbCelanovic
from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.linear import Linear
from dehyst.baselines.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
)
from dehyst.baselines.preisach import Preisach
from dehyst.model import AbstractModel, Motion
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, standard

VOLTS = 100.0


class Candidate(NamedTuple):
    """A model, how far its inverse may be from exact as a fraction of the range, whether inner loops leave no trace."""

    name: str
    factory: Callable[[], AbstractModel]
    tolerance: float = 1e-12
    wipes_out: bool = True


def actuator(elements, knots, volts):
    """Return an actuator of 10 um; elements of increasing stiffness on a uniform grid."""
    rho = 5e-6 * np.arange(1, elements + 1) / max(elements, 1)
    kappa = 4e6 * np.arange(1, elements + 1) / max(elements, 1) ** 2
    return Actuator(MaxwellSlip(rho, kappa), Spring(knots, volts))


CREEP = Creep([0.01, 0.3, 10.0], [1e5, 3e5, 2e5])
BEHIND = DisplacementCreep([0.01, 0.3, 10.0], [0.01, 0.02, 0.03])


def wider(elements, *, creep):
    """Return an actuator whose elements are stiffer in the middle, seen through a bent transformer."""
    rho = 5e-6 * np.arange(1, elements + 1) / elements
    slip = GradedSlip(rho, [0, 3e-6, 7e-6, 1e-5], np.outer(4e6 * rho / rho.sum(), [0.9, 1.2, 1.0]))
    bend = Transformer([0, 0.3 * VOLTS, VOLTS], [0, 0.35 * VOLTS, VOLTS])
    return Actuator(slip, Spring([0, 1e-5], [0, 80]), transformer=bend, creep=CREEP if creep else None)


def goldfarb():
    """Return the baseline identified from a rise to 10 um and 100 V."""
    u = np.linspace(0, 1, 101)
    return GoldfarbCelanovic.fit(Record(u, VOLTS * (0.7 * u + 0.3 * np.sqrt(u)), 1e-5 * u))


def preisach():
    """Return a baseline with a ridge of relays, more of them at high voltages."""
    nodes = np.linspace(0, 1, 13)
    alpha, beta = np.meshgrid(nodes, nodes, indexing="ij")
    return Preisach((0.0, VOLTS), 1e-5 * (alpha - beta) * (0.6 + 0.3 * (alpha - beta) + 0.2 * alpha), 2e-6)


def boucwen():
    """Return a baseline with a bent map."""
    return BoucWen(0.45, 0.04, 0.02, (-5.0, 95.0), [1e-6, 1.2e-5, -6e-6, 4e-6])


def duhem():
    """Return a baseline with a bent middle line."""
    return Duhem((0.0, VOLTS), 5.0, [1e-6, 1.2e-5, -3e-6, 1e-6], [8e-6, -1e-6])


def smooth():
    """Return ten elements beside three smooth ones."""
    plain = actuator(10, np.linspace(0, 1e-5, 11), 60 * np.linspace(0, 1, 11) ** 1.3)
    return Actuator(plain.slip, plain.spring, smooth=SmoothSlip([3e-7, 1e-6, 4e-6], [1, 0.5, 0.8], [5e6, 3e6, 2e6]))


@cache
def fitted(kind, **options):
    """Return a baseline identified from loops of falling tops up to 100 V."""
    voltage = standard.descending_tops(VOLTS, steps=5, drive=Sampling(sample_rate=1.0)).voltage
    y = PlayActuator(highest=VOLTS).play(voltage)
    return kind.fit(Record(np.arange(y.size), voltage, y), delay=0.0, **options)


MODELS = [
    Candidate("spring alone", lambda: actuator(0, [0, 4e-6, 1e-5], [0, 60, 100])),
    Candidate("one element", lambda: actuator(1, [0, 1e-5], [0, 80])),
    Candidate("ten elements", lambda: actuator(10, np.linspace(0, 1e-5, 11), 90 * np.linspace(0, 1, 11) ** 1.3)),
    Candidate("thousand elements", lambda: actuator(1000, [0, 2e-6, 1e-5], [0, 10, 90])),
    Candidate("graded elements and a transformer", lambda: wider(10, creep=False)),
    Candidate("graded elements, a transformer and creep", lambda: wider(10, creep=True)),
    Candidate("plain elements and creep", lambda: replace(actuator(10, [0, 1e-5], [0, 80]), creep=CREEP)),
    Candidate(
        "plain elements and creep in displacement",
        lambda: replace(actuator(10, [0, 1e-5], [0, 80]), displacement_creep=BEHIND),
    ),
    Candidate("Goldfarb and Celanovic", goldfarb),
    Candidate("Prandtl and Ishlinskii", partial(fitted, PrandtlIshlinskii)),
    Candidate("Kuhnen", partial(fitted, ModifiedPrandtlIshlinskii)),
    Candidate("generalised Prandtl and Ishlinskii", partial(fitted, GeneralizedPrandtlIshlinskii, lowpasses=())),
    Candidate("Krasnosel'skii and Pokrovskii", partial(fitted, KrasnoselskiiPokrovskii)),
    Candidate("linear ratio", lambda: Linear(1e-7, 1e-6)),
    Candidate("Preisach", preisach),
    Candidate("Bouc-Wen", boucwen, wipes_out=False),
    Candidate("Duhem", duhem, wipes_out=False),
    Candidate("smooth elements", smooth, wipes_out=False),
]


@pytest.fixture(params=MODELS, ids=lambda candidate: candidate.name)
def candidate(request):
    return request.param


@pytest.fixture
def model(candidate):
    return candidate.factory()


def only(has):
    """Run a test on the candidates that have a property."""
    chosen = [one for one in MODELS if has(one)]
    assert chosen
    return pytest.mark.parametrize("candidate", chosen, ids=lambda candidate: candidate.name, indirect=True)


def walk(n, seed=0):
    """Return n voltages [V] within what every candidate takes, turning often."""
    return np.random.default_rng(seed).uniform(0.05 * VOLTS, 0.95 * VOLTS, n)


def both_ways(model, n=60, seed=0):
    """Yield each method with a path it can follow and the name of what comes out."""
    motion = timed(model.simulate)(walk(n, seed))
    yield timed(model.simulate), motion.voltage, "displacement"
    yield timed(model.compensate), motion.displacement, "voltage"


def timed(run):
    """Tell the method the time of each sample: every model takes it, and those that need none leave it alone."""

    def at(drive, **options):
        time = 0.01 * np.arange(np.size(drive)) if np.ndim(drive) == 1 else None
        return run(drive, time=time, **options)

    return at


def knows_time(model):
    return getattr(model, "needs_time", False)


def close(got, expected, tolerance):
    return np.abs(np.subtract(got, expected)).max(initial=0.0) <= tolerance * np.ptp(expected)


def test_is_an_abstract_model_that_cannot_be_changed(model):
    assert isinstance(model, AbstractModel)
    assert is_dataclass(model)
    for name in [*type(model).__dataclass_fields__, "anything"]:
        with pytest.raises(AttributeError):
            setattr(model, name, 1.0)


def test_shapes_and_the_other_column_is_the_input(model):
    for n in (0, 1, 60):
        for run, drive, out in both_ways(model, n):
            motion = run(drive.tolist())
            assert isinstance(motion, Motion)
            assert motion.voltage.shape == motion.displacement.shape == (n,)
            assert motion.voltage.dtype == motion.displacement.dtype == np.float64
            assert np.isfinite(getattr(motion, out)).all()
            given_in = motion.voltage if out == "displacement" else motion.displacement
            assert np.array_equal(given_in, drive)


def test_the_state_handed_back_carries_on(model, candidate):
    for run, drive, out in both_ways(model):
        whole, parts, state = getattr(run(drive), out), [], None
        for start, stop in pairwise([0, 1, 17, 18, 50, drive.size]):
            # A part begins with the sample at which the last one ended: what goes by between the two counts.
            motion = run(drive[max(start - 1, 0) : stop], state=state)
            parts.append(getattr(motion, out)[start > 0 :])
            state = motion.state
        assert close(np.concatenate(parts), whole, candidate.tolerance)


def test_input_and_state_are_not_modified(model):
    for run, drive, out in both_ways(model):
        state, before = run(drive[:10]).state, drive.copy()
        first = getattr(run(drive, state=state), out)
        assert np.array_equal(drive, before)
        assert np.array_equal(getattr(run(drive, state=state), out), first)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(model, bad):
    for run, drive, _ in both_ways(model):
        with pytest.raises(ModelError, match=r"(voltage|displacement).*not finite, the first at index 7"):
            run(np.where(np.arange(drive.size) == 7, bad, drive))


@pytest.mark.parametrize("bad", [[[0.0]], "text", None, [1j]])
def test_what_is_no_path_is_refused(model, bad):
    for run in (timed(model.simulate), timed(model.compensate)):
        with pytest.raises(ModelError, match=r"voltage|displacement"):
            run(bad)


def test_the_same_question_gets_the_same_answer(model, candidate):
    for run, drive, out in both_ways(model):
        first = getattr(run(drive), out)
        assert np.array_equal(getattr(run(drive), out), first)
        again = {name: other for other, _, name in both_ways(candidate.factory())}[out]
        assert np.array_equal(getattr(again(drive), out), first)


@only(lambda candidate: not knows_time(candidate.factory()))
def test_rate_independence(model, candidate):
    for run, drive, out in both_ways(model):
        between = drive[:-1, None] + np.diff(drive)[:, None] * [0, 0.25, 0.5, 0.5]
        slow = getattr(run(np.append(between.ravel(), drive[-1])), out)
        assert close(slow[::4], getattr(run(drive), out), candidate.tolerance)


@only(lambda candidate: candidate.wipes_out and not knows_time(candidate.factory()))
def test_wiping_out(model, candidate):
    """A loop within the last one, closed again, leaves no trace in what follows."""
    for run, drive, out in both_ways(model):
        low, high = drive.min(), drive.max()
        at = low + (high - low) * np.array([0, 1, 0.2, 0.9, 0.4, 0.7, 0.5, 0.9, 0.3, 0.2, 0.1, 0.6, 1])
        kept = np.array([0, 1, 2, 3, 8, 9, 10, 11, 12])
        assert close(getattr(run(at), out)[kept], getattr(run(at[kept]), out), candidate.tolerance)


def test_simulating_the_compensation_gives_the_path(model, candidate):
    simulate = timed(model.simulate)
    state = simulate(walk(30, seed=1)).state
    path = simulate(walk(200, seed=2), state=state).displacement
    sent = timed(model.compensate)(path, state=state)
    assert close(simulate(sent.voltage, state=state).displacement, path, candidate.tolerance)


def test_compensating_the_simulation_gives_the_voltage(model, candidate):
    simulate = timed(model.simulate)
    state = simulate(walk(30, seed=3)).state
    voltage = walk(200, seed=4)
    path = simulate(voltage, state=state).displacement
    assert close(timed(model.compensate)(path, state=state).voltage, voltage, candidate.tolerance)


def test_more_voltage_more_displacement(model):
    rise = timed(model.simulate)(np.linspace(0.05, 0.95, 50) * VOLTS).displacement
    assert np.all(np.diff(rise) > 0)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("far", [1e16, -1e100, 1e281, -1.7e308])
def test_huge_numbers_have_a_finite_answer_or_a_clear_error(model, far):
    for run, drive, out in both_ways(model, 20):
        given = drive.copy()
        given[5::4] = far
        anywhere = {"extrapolate": True} if isinstance(model, Actuator) else {}
        try:
            motion = run(given, **anywhere)
        except ModelError as error:
            assert out in str(error) or "state" in str(error) or "displacement" in str(error)
        else:
            assert np.isfinite(getattr(motion, out)).all()
