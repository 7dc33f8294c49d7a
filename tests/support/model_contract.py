"""The contract of every model, here and in packages/rivals: shapes, states, errors, and laws of model and inverse."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

from dehyst._errors import ModelError
from dehyst.model import AbstractModel, Actuator, Motion, needs_time

_VOLTS = 100.0


class ModelCandidate(NamedTuple):
    """A model under test.

    `name`: in the reports of pytest. `make`: function that returns a model, which has a displacement for each voltage
    between 0 and 100 V, and a voltage for each of these. `tolerance`: largest error of its inverse, as a fraction of
    the range. `wipes_out`: whether closed inner loops leave no trace, as in the models of Preisach's class. `moves`:
    whether each change of the voltage moves it.
    """

    name: str
    make: Callable[[], AbstractModel]
    tolerance: float = 1e-12
    wipes_out: bool = True
    moves: bool = True


def _walk(n, seed=0):
    """Return n voltages [V] with many turns, within the range of every candidate."""
    return np.random.default_rng(seed).uniform(0.05 * _VOLTS, 0.95 * _VOLTS, n)


def _timed(run):
    """Give the method the time of each sample: every model takes it, and a model without time ignores it."""

    def at(drive, **options):
        time = 0.01 * np.arange(np.size(drive)) if np.ndim(drive) == 1 else None
        return run(drive, time=time, **options)

    return at


def _both_ways(model, n=60, seed=0):
    """Yield each method with a path it can follow and the name of its result."""
    motion = _timed(model.simulate)(_walk(n, seed))
    yield _timed(model.simulate), motion.voltage, "displacement"
    yield _timed(model.compensate), motion.displacement, "voltage"


def _knows_time(model):
    return isinstance(model, Actuator) and needs_time(model)


def _close(got, expected, tolerance):
    return bool(np.abs(np.subtract(got, expected)).max(initial=0.0) <= tolerance * np.ptp(expected))


class ModelContract:
    """The tests of a model; a subclass has a fixture `candidate` that returns a `ModelCandidate`."""

    @pytest.fixture
    def model(self, candidate):
        """Return a new model."""
        return candidate.make()

    def test_a_model_is_frozen(self, model):
        assert isinstance(model, AbstractModel)
        assert is_dataclass(model)
        for name in [*(part.name for part in fields(model)), "anything"]:
            with pytest.raises(AttributeError):
                setattr(model, name, 1.0)

    def test_the_result_has_the_shape_of_the_input_and_contains_it(self, model):
        for n in (0, 1, 60):
            for run, drive, out in _both_ways(model, n):
                motion = run(drive.tolist())
                assert isinstance(motion, Motion)
                assert motion.voltage.shape == motion.displacement.shape == (n,)
                assert motion.voltage.dtype == motion.displacement.dtype == np.float64
                assert np.isfinite(getattr(motion, out)).all()
                given_in = motion.voltage if out == "displacement" else motion.displacement
                assert np.array_equal(given_in, drive)

    def test_the_returned_state_continues_the_motion(self, model, candidate):
        for run, drive, out in _both_ways(model):
            whole, parts, state = getattr(run(drive), out), [], None
            for start, stop in pairwise([0, 1, 17, 18, 50, drive.size]):
                # A part begins with the last sample of the part before: the time between two samples counts.
                motion = run(drive[max(start - 1, 0) : stop], state=state)
                parts.append(getattr(motion, out)[start > 0 :])
                state = motion.state
            assert _close(np.concatenate(parts), whole, candidate.tolerance)

    def test_equal_calls_have_equal_results_and_modify_nothing(self, model, candidate):
        others = {name: other for other, _, name in _both_ways(candidate.make())}
        for run, drive, out in _both_ways(model):
            state, before = run(drive[:10]).state, drive.copy()
            first = getattr(run(drive, state=state), out)
            assert np.array_equal(drive, before)
            assert np.array_equal(getattr(run(drive, state=state), out), first)
            assert np.array_equal(getattr(others[out](drive), out), getattr(run(drive), out))

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_numbers_that_are_not_finite_are_refused(self, model, bad):
        for run, drive, _ in _both_ways(model):
            with pytest.raises(ModelError, match=r"(voltage|displacement).*index 7"):
                run(np.where(np.arange(drive.size) == 7, bad, drive))

    @pytest.mark.parametrize("bad", [[[0.0]], "text", ["1"], None, [1j], 3.0])
    def test_other_arguments_than_a_path_are_refused(self, model, bad):
        for run in (_timed(model.simulate), _timed(model.compensate)):
            with pytest.raises(ModelError, match=r"voltage|displacement"):
                run(bad)

    def test_the_displacement_does_not_depend_on_the_rate(self, model, candidate):
        if _knows_time(model):
            pytest.skip("it depends on time")
        for run, drive, out in _both_ways(model):
            between = drive[:-1, None] + np.diff(drive)[:, None] * [0, 0.25, 0.5, 0.5]
            slow = getattr(run(np.append(between.ravel(), drive[-1])), out)
            assert _close(slow[::4], getattr(run(drive), out), candidate.tolerance)

    def test_a_larger_loop_wipes_out_smaller_ones(self, model, candidate):
        """A closed loop within the last loop has no effect on the later displacements."""
        if _knows_time(model) or not candidate.wipes_out:
            pytest.skip("inner loops leave a trace")
        for run, drive, out in _both_ways(model):
            low, high = drive.min(), drive.max()
            at = low + (high - low) * np.array([0, 1, 0.2, 0.9, 0.4, 0.7, 0.5, 0.9, 0.3, 0.2, 0.1, 0.6, 1])
            kept = np.array([0, 1, 2, 3, 8, 9, 10, 11, 12])
            assert _close(getattr(run(at), out)[kept], getattr(run(at[kept]), out), candidate.tolerance)

    def test_the_simulation_of_compensated_voltages_gives_the_path(self, model, candidate):
        simulate = _timed(model.simulate)
        state = simulate(_walk(30, seed=1)).state
        path = simulate(_walk(1000, seed=2), state=state).displacement
        sent = _timed(model.compensate)(path, state=state)
        assert _close(simulate(sent.voltage, state=state).displacement, path, candidate.tolerance)

    @pytest.mark.parametrize("middle", [0.15, 0.85], ids=["below", "above"])
    def test_a_displacement_beyond_the_range_is_compensated_or_refused(self, model, candidate, middle):
        """At -30 to 60 V, and 40 to 130 V: a model may refuse a path, but must not lead to another displacement."""
        simulate, beyond = _timed(model.simulate), _walk(200, seed=6) + (middle - 0.5) * _VOLTS
        try:
            path = simulate(beyond).displacement
            reached = simulate(_timed(model.compensate)(path).voltage).displacement
        except ModelError:
            pytest.skip("it refuses them")
        assert _close(reached, path, candidate.tolerance)

    def test_the_compensation_of_a_simulated_path_gives_the_voltages(self, model, candidate):
        if not candidate.moves:
            pytest.skip("many voltages lead to a displacement")
        simulate = _timed(model.simulate)
        state = simulate(_walk(30, seed=3)).state
        voltage = _walk(1000, seed=4)
        path = simulate(voltage, state=state).displacement
        assert _close(_timed(model.compensate)(path, state=state).voltage, voltage, candidate.tolerance)

    def test_the_displacement_rises_with_the_voltage(self, model):
        rise = _timed(model.simulate)(np.linspace(0.05, 0.95, 50) * _VOLTS).displacement
        assert np.all(np.diff(rise) > 0)

    @pytest.mark.filterwarnings("ignore::RuntimeWarning")
    @pytest.mark.parametrize("far", [1e16, -1e100, 1e281, -1.7e308])
    def test_huge_numbers_have_a_finite_answer_or_a_clear_error(self, model, far):
        for run, drive, out in _both_ways(model, 20):
            given = drive.copy()
            given[5::4] = far
            anywhere = {"extrapolate": True} if isinstance(model, Actuator) else {}
            try:
                motion = run(given, **anywhere)
            except ModelError as error:
                assert out in str(error) or "state" in str(error) or "displacement" in str(error)
            else:
                assert np.isfinite(getattr(motion, out)).all()
