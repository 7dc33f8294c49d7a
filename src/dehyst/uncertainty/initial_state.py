"""The state in which a record began, from its first rise (theory section 2): where the carts stood, and how surely."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst._threads import one_thread
from dehyst._types import Array, Mask
from dehyst.identification.preprocessing.cleaning import remove_glitches
from dehyst.identification.solvers import program
from dehyst.model import Actuator, State
from dehyst.model.elements import segment_of
from dehyst.records import Record
from dehyst.records.metrics import rms
from dehyst.uncertainty.rest_states import ROUNDING, Indices, RestStates, demand_actuator, size_of

# A relaxed start explains a rise as well as the best one if its RMS error is not above the best one's by this factor
# (what N free carts gain on white noise stays below it from 3.3 N samples on), or not above the model's error on the
# loops, where the state is known, by the other one.
_AS_GOOD, _AS_LOOPS, _NOTHING = 1.2, 3.0, 1e-6
_MOST_ON_RISE, _MOST_AFTER = 1500, 500
_STARTS, _MOST_STEPS, _STEP = 4, 60, 1e-7
# Residuals below this part of the actuator's size are rounding.
_FINEST = 1e-10


@dataclass(frozen=True, eq=False)
class FirstRise:
    """The state from which a first rise started, as far as the rise determines it.

    Attributes
    ----------
    state : State
        At the record's first sample, on the model's axis.
    datum : float
        What to add to the sensor's reading [m] to come to the model's axis.
    unknown : (N,) bool array
        Elements that did not surely slide on the rise, so that at most the sum of their voltages is determined, or have
        no stiffness.
    doubt : (N,) array
        Standard deviation of each cart [m], from the noise and the sampling; good where much is determined, a hint
        where little is (a normal distribution about the best state, what the inequality allows being the prior); its
        breakaway for a cart without stiffness.
    rms, rms_relaxed : float
        Measured minus simulated displacement on the rise [m], from this state and from the relaxed one.
    relaxed : bool
        Whether the relaxed state explains the rise as well, or about as well as the model explains the loops after it.
    remarks : tuple of str
        Sentences: what was extrapolated, what is not determined.
    """

    state: State
    datum: float
    unknown: Mask
    doubt: Array
    rms: float
    rms_relaxed: float
    relaxed: bool
    remarks: tuple[str, ...]


def state_from_first_rise(actuator: Actuator, record: Record) -> FirstRise:
    """Return the state before t = 0, from a record that begins at rest with a first rise and goes on with a full loop.

    Least squares on the displacement of the whole record, simulated from equilibria at the record's first voltage that
    obey the inequality of reachable states. The sensor's zero comes from what follows the rise, where an initial state
    does no more than shift the loop (Eq. 10). The unknowns are the carts: with t_i = rho_i - s_i(0), the way up to
    where cart i slides, ``v = eta(y) + sum_i kappa_i (rho_i - max(t_i - (y - y(0)), 0))`` on the rise.

    Parameters
    ----------
    actuator : Actuator
        Identified from loops of the same actuator, its sensor zeroed anywhere.
    record : Record
        As it was measured: `identify` leaves a first rise out, this needs it.

    Raises
    ------
    ModelError
        If the actuator is none, or a wider one.
    RecordError
        If the record cannot be used, falls first, or has no full loop after its first rise.
    """
    demand_actuator(actuator)
    if actuator.wide:
        raise ModelError(
            "the state from a first rise is sought for plain slip elements and a spring only; home a wider actuator "
            "before it is used (dehyst.control.homing.shortest_homing), which needs no record"
        )
    if not isinstance(record, Record):
        raise RecordError(f"got {type(record).__name__}, need a Record; read a file with dehyst.read(path)")
    record, _, repairs = remove_glitches(record)
    record.check_usable()
    used = record.delayed(actuator.delay) if actuator.delay else record
    rise = _Rise(actuator, used, _first_top(used))
    with one_thread():
        shares, doubt = rise.solve()
    found = rise.result(rise.state(shares), doubt)
    return replace(found, remarks=(*repairs, *found.remarks))


def _first_top(record: Record) -> int:
    """Return the sample at which the first rise ends; a full loop follows."""
    v = record.voltage
    first = int(record.reversals()[0])
    if v[first] < v[0]:
        raise RecordError(
            f"record '{record.name}': the voltage falls first, from {v[0]:.4g} to {v[first]:.4g} V; the initial state "
            "shows on a first rise: start recording at rest, before the voltage rises"
        )
    if not record.slice(first, None).cycles():
        raise RecordError(
            f"record '{record.name}': no full loop after the first rise, which ends at {record.time[first]:.4g} s; it "
            "shows the sensor's zero: go on down and up again"
        )
    return first


@dataclass(frozen=True, eq=False)
class _Rise:
    """The least-squares problem; its unknowns are shares, 0 to 1, of the room that each t_i has above the one before.

    Elements without stiffness are left out and put between their neighbours afterwards.
    """

    actuator: Actuator
    record: Record
    top: int

    @cached_property
    def stiff(self) -> Indices:
        return np.flatnonzero(self.actuator.slip.stiffness > 0)

    @cached_property
    def room(self) -> Array:
        return 2 * np.diff(self.actuator.slip.breakaway[self.stiff], prepend=0.0)

    @cached_property
    def kept(self) -> Indices:
        """Samples enough for the solution, the turning points among them: between those the simulation is exact."""
        rise = np.linspace(0, self.top, min(self.top + 1, _MOST_ON_RISE))
        after = np.linspace(self.top, len(self.record) - 1, min(len(self.record) - self.top, _MOST_AFTER))
        return np.unique(np.concatenate([rise, after, self.record.reversals()]).astype(np.intp))

    def state(self, shares: Array) -> State:
        rho, stiff = self.actuator.slip.breakaway, self.stiff
        way = np.interp(rho, np.append(0.0, rho[stiff]), np.append(0.0, np.cumsum(self.room * shares)))
        # Beyond the last stiff element a cart hangs as far back as that one's.
        way += np.maximum(rho - rho[stiff[-1]], 0.0) if stiff.size else rho
        return RestStates(self.actuator, float(self.record.voltage[0])).state(rho - way)

    def difference(self, state: State) -> Array:
        """Return simulated displacement minus the sensor's reading (n,) [m]; from the top on its mean is the datum."""
        return self._played(self.record.voltage, state) - self.record.displacement

    def _played(self, voltage: Array, state: State) -> Array:
        return self.actuator.simulate(voltage, state=state, extrapolate=True).displacement

    def solve(self) -> tuple[Array, Array]:
        """Shares and doubts of the best of several starts."""
        size, kept = size_of(self.actuator), self.kept
        voltage, measured = self.record.voltage[kept], self.record.displacement[kept]

        def residual(shares: Array) -> Array:
            error = self._played(voltage, self.state(shares)) - measured
            return np.asarray((error - error[kept >= self.top].mean()) / size)

        if not self.stiff.size:
            return np.zeros(0), self.actuator.slip.breakaway.copy()
        shares, error = min((_descend(residual, start) for start in self._starts()), key=lambda found: rms(found[1]))
        deviation = float(np.sqrt(error @ error / max(kept.size - self.stiff.size - 1, 1)))
        weight = 1 / max(deviation, _FINEST)

        def with_prior(shares: Array) -> Array:
            return np.append(weight * residual(shares), np.sqrt(12) * (shares - 0.5))

        # Each share is uniform, of variance 1/12, about the relaxed state's: what is not determined stays near that
        # one.
        shares, error = _descend(with_prior, shares)
        return shares, self._doubt(shares, _slopes(with_prior, shares, error))

    def _starts(self) -> list[Array]:
        """Return the closed form, the relaxed state, then any."""
        n = self.stiff.size
        some = np.random.default_rng(0).uniform(0.01, 0.99, (_STARTS - 2, n))
        return [np.clip(self._closed_form(), 0.0, 1.0), np.full(n, 0.5), *some]

    def _closed_form(self) -> Array:
        """Return the friction missing, S(y) = sum_i kappa_i max(t_i - y, 0), is convex with known slopes.

        So sum_{m > i} kappa_m t_m is the least of S(y) + y sum_{m > i} kappa_m: exact on data without noise.
        """
        slip, spring, v = self.actuator.slip, self.actuator.spring, self.record.voltage
        force, kappa = float(slip.friction.sum()), slip.stiffness[self.stiff]
        at_top = self.actuator.relaxed(float(v[self.top]) - force, extrapolate=True).displacement
        after = self._played(v[self.top :], self.actuator.turned(at_top, extrapolate=True))
        datum = float(np.mean(after - self.record.displacement[self.top :]))
        y = self.record.displacement[: self.top + 1] + datum
        missing = spring(y) + force - v[: self.top + 1]
        left = kappa.sum() - np.append(0.0, np.cumsum(kappa))
        sums = np.array([np.min(missing + slope * (y - y[0])) for slope in left])
        way = -np.diff(sums) / kappa
        return np.asarray(np.diff(way, prepend=0.0) / self.room)

    def _doubt(self, shares: Array, jacobian: Array) -> Array:
        """Return standard deviations of the carts (N,) [m], the problem linearised at the best state."""
        slip, stiff = self.actuator.slip, self.stiff
        _, values, axes = np.linalg.svd(jacobian, full_matrices=False)
        spread = axes.T / np.where(values > _STEP * values.max(), values, np.sqrt(12))
        way = np.tril(np.ones((stiff.size, stiff.size))) * self.room
        y = self.state(shares).displacement
        knots, slopes = self.actuator.spring.displacement, self.actuator.spring.slopes
        slope = slopes[segment_of(knots, y)]
        moved = way + slip.stiffness[stiff] @ way / slope
        doubt = slip.breakaway.copy()
        noise, sampling = np.linalg.norm(moved @ spread, axis=1), self._crowded(np.cumsum(self.room * shares))
        doubt[stiff] = np.minimum(doubt[stiff], np.maximum(noise, sampling))
        return doubt

    def _crowded(self, way: Array) -> Array:
        """Distance of the samples [m] between which two carts begin to slide: no data distinguish these; else 0."""
        reading = self.record.displacement[self.kept[self.kept <= self.top]]
        seen = np.maximum.accumulate(reading - reading[0])
        before = np.searchsorted(seen * (1 - 1e-6), way[:-1], side="right").clip(1, seen.size - 1) - 1
        distance = np.where(way[1:] <= seen[before + 1] * (1 + 1e-6), seen[before + 1] - seen[before], 0.0)
        return np.asarray(np.maximum(np.append(distance, 0.0), np.append(0.0, distance)))

    def result(self, state: State, doubt: Array) -> FirstRise:
        """Return the answer in words."""
        voltage, reading = float(self.record.voltage[0]), self.record.displacement[: self.top + 1]
        rise, own = slice(0, self.top + 1), self.difference(state)
        datum, plain = float(own[self.top :].mean()), self.difference(self.actuator.relaxed(voltage, extrapolate=True))
        best, usual = rms(own[rise] - datum), rms(own[self.top :] - datum)
        if_relaxed = rms(plain[rise] - plain[self.top :].mean())
        height = float(np.ptp(reading))
        highest = self._played(self.record.voltage[rise], state).max()
        still = state.carts + self.actuator.slip.breakaway + doubt >= highest
        unknown = still | (self.actuator.slip.stiffness == 0)
        remarks = [
            *self._extrapolated(state, height),
            *self._untold(unknown, doubt, height),
            *self._missed(best, height),
        ]
        same = if_relaxed <= max(_AS_GOOD * best, _AS_LOOPS * usual) + _NOTHING * height
        return FirstRise(state, datum, unknown, doubt, best, if_relaxed, same, tuple(remarks))

    def _extrapolated(self, state: State, height: float) -> list[str]:
        below = float(self.actuator.spring.displacement[0]) - state.displacement
        if below <= ROUNDING * size_of(self.actuator):
            return []
        return [
            f"The first {below * 1e6:.4g} um of the rise of {height * 1e6:.4g} um lie below the spring's identified "
            "range: it was extrapolated there, and the carts depend on that."
        ]

    def _untold(self, unknown: Mask, doubt: Array, height: float) -> list[str]:
        remarks, best = [], float(doubt[~unknown].min(initial=np.inf))
        if unknown.any():
            numbers = ", ".join(str(i + 1) for i in np.flatnonzero(unknown))
            remarks.append(
                f"Elements {numbers} did not surely slide on the rise or have no stiffness: their carts are not "
                f"determined."
            )
        if 0.01 * height < best < np.inf:
            remarks.append(
                f"No cart is determined better than to {best * 1e6:.2g} um: the loops are too small to show where "
                f"on its "
                "axis the model stands. Go as far as all elements slide."
            )
        if self.top + 1 < 4 * self.stiff.size:
            remarks.append(
                f"The rise has {self.top + 1} samples for {self.stiff.size} elements: carts that begin to slide "
                "between two samples cannot be distinguished. Sample faster, or rise more slowly."
            )
        return remarks

    def _missed(self, error: float, height: float) -> list[str]:
        if error <= max(3 * self.record.noise, 0.005 * height):
            return []
        return [
            f"The rise is met to {100 * error / height:.2g} % of its height only (RMS): it did not begin at "
            "rest, the model does not fit it, or the state is one that no slow history leaves (an abrupt discharge)."
        ]


def _descend(residual: Callable[[Array], Array], start: Array) -> tuple[Array, Array]:
    """Least squares over 0 <= x <= 1 and its residual, by Levenberg and Marquardt.

    Each step obeys the bounds as a problem of its own, so that they are met exactly: carts on the edge of what the
    inequality allows are the rule after a history.
    """
    from scipy.optimize import lsq_linear

    x, error, damping = start, residual(start), 1e-3
    for _ in range(_MOST_STEPS):
        triangle = program.triangle_of(np.column_stack([_slopes(residual, x, error), error]))
        rows, goal = triangle[:, :-1], -triangle[:, -1]
        size, before = float(np.linalg.norm(rows, axis=0).max()), float(error @ error)
        for _ in range(8):
            damped = np.vstack([rows, np.sqrt(damping) * size * np.eye(x.size)])
            step = lsq_linear(damped, np.append(goal, np.zeros(x.size)), (-x, 1 - x), method="bvls").x
            trial = np.clip(x + step, 0.0, 1.0)
            missed = residual(trial)
            if missed @ missed < before:
                break
            damping *= 10
        else:
            return x, error
        x, error, damping = trial, missed, 0.1 * damping
        if before - error @ error < 1e-14 * before:
            break
    return x, error


def _slopes(residual: Callable[[Array], Array], x: Array, error: Array) -> Array:
    """Return derivatives of the residual (n, K), by differences towards the middle of the bounds."""
    steps = np.diag(np.where(x < 0.5, _STEP, -_STEP))
    return np.column_stack([(residual(x + step) - error) / step.sum() for step in steps])
