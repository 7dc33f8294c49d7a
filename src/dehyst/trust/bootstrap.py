"""Confidence intervals of a model's numbers for finite and noisy records, by a bootstrap over cycles.

The model is taken for the truth. Its simulation of each record, plus residuals of cycles picked at random, each with a
random sign, makes a new set of records; it is identified again by least squares. The scatter and the bias of the new
coefficients about the model's give basic bootstrap intervals: ``2 theta - quantile``. Sensor noise passes through the
stop operators as it does in the measurement, so the intervals have the bias due to noise removed. Extremes of the noise
drag carts, and thereby shift whole legs. The resampled noise shifts the legs' mean residuals again; the share that it
explains is removed from the residuals, so that it does not count twice. Directions of Maxwell-slip elements that the
records leave open keep the model's values, because resampling cannot show them (see `feasible_set`). The grids of all
parts stay fixed. In models with more parts than slip elements and a spring, open directions scatter too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.identification import Coefficients, Norm, RecordComparison
from dehyst.model import Actuator, State
from dehyst.records import Record
from dehyst.trust.evidence import Evidence, leg_starts, rows_of

# Fewer models have no tails.
LEAST_REPEATS = 20
# Entries of the table of rows by coefficients.
_ENTRIES = 800_000
# Sets of records that show how large the legs' mean residuals are by noise alone.
_TRIALS = 10
# Sets of records that are identified by both norms, and their entries, to see how much more one scatters.
_PAIRS, _FEWER = 20, 400_000
_NORMS: tuple[Norm, ...] = ("l2", "l1")


@dataclass(frozen=True, eq=False)
class Intervals:
    """Models identified from resampled records, and the intervals that follow.

    Attributes
    ----------
    actuator : Actuator
        The model whose numbers have these intervals.
    actuators : tuple of Actuator
        One for each resampled set of records.
    level : float
        Confidence level of the intervals, 0 to 1.
    spread : float
        Factor on the deviations, because estimates in the model's norm scatter more than least-squares estimates:
        measured if that norm is L1, else 1.
    few : float
        Factor on the deviations for the small number of cycles: Student's quantile over the normal quantile.
    own : tuple of Actuator
        Models identified from some of the resampled records in the model's own norm, if that is not least squares: they
        show the bias of this norm.
    """

    actuator: Actuator
    actuators: tuple[Actuator, ...]
    level: float
    spread: float
    few: float = 1.0
    own: tuple[Actuator, ...] = ()

    @property
    def stiffness(self) -> Array:
        """Lowest and highest kappa_i, (2, N) [V/m]; never below 0."""
        centre, every = self.actuator.slip.stiffness, np.array([a.slip.stiffness for a in self.actuators])
        ends = np.maximum(self._basic(lambda a: a.slip.stiffness), 0.0)
        # At the bound all deviations are upward, and turning them round would mean that it cannot be anything else.
        bound, factor = centre == 0, self.spread * self.few
        ends[0, bound], ends[1, bound] = 0.0, factor * np.quantile(every[:, bound], 0.5 * (1 + self.level), axis=0)
        return ends

    @property
    def creep(self) -> Array | None:
        """Lowest and highest c_j (2, J) [V/m], never below 0; None without creep."""
        return self._of_part("creep", "stiffness", 0.0)

    @property
    def smooth(self) -> Array | None:
        """Lowest and highest k_l (2, L) [V/m], never below 0; None without smooth elements."""
        return self._of_part("smooth", "stiffness", 0.0)

    @property
    def drive(self) -> Array | None:
        """Lowest and highest tau at its knots (2, K) [V]; None without a transformer."""
        return self._of_part("transformer", "drive", -np.inf)

    @property
    def gains(self) -> Array | None:
        """Lowest and highest slope of tau's segments, (2, K - 1) [V/V]; None without a transformer."""
        return self._of_part("transformer", "slopes", -np.inf)

    def _of_part(self, part: str, name: str, least: float) -> Array | None:
        if getattr(self.actuator, part) is None:
            return None
        return np.maximum(self._basic(lambda a: getattr(getattr(a, part), name)), least)

    @property
    def slopes(self) -> Array:
        """Lowest and highest slope of the spring's segments, (2, M - 1) [V/m]."""
        return self._basic(lambda a: a.spring.slopes)

    @property
    def spring(self) -> Array:
        """Lowest and highest voltage of the spring at its knots, relative to the first knot, (2, M) [V]."""
        return self._basic(lambda a: a.spring.voltage - a.spring.voltage[0])

    def prediction(
        self, voltage: ArrayLike, state: Callable[[Actuator], State], time: ArrayLike | None = None
    ) -> Array:
        """Return the lowest and highest displacement (2, n) [m] for a voltage (n,) [V], from each model's `state`."""
        return self._basic(lambda a: a.simulate(voltage, time=time, state=state(a), extrapolate=True).displacement)

    def _basic(self, value: Callable[[Actuator], Array]) -> Array:
        centre = value(self.actuator)
        deviation = np.array([value(a) for a in self.actuators]) - centre
        scatter = deviation - deviation.mean(axis=0)
        middle, more = deviation.mean(axis=0), 1.0
        if self.own:
            middle = np.mean([value(a) for a in self.own], axis=0) - centre
            # The mean of so few scatters, too.
            more = float(np.sqrt(1 + 1 / len(self.own)))
        tails = 0.5 * (1 - self.level), 0.5 * (1 + self.level)
        low, high = middle + self.spread * self.few * more * np.quantile(scatter, tails, axis=0)
        return np.array([centre - high, centre - low])


def resample(
    evidence: Evidence,
    *,
    level: float = 0.9,
    repeats: int = 100,
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Intervals:
    """Identify resampled records and return the intervals.

    Parameters
    ----------
    evidence : Evidence
        The model and its records. Datums stay fixed; constants, drifts and all coefficients are fitted again.
    level : float, optional
        Confidence level of the intervals, 0 to 1.
    repeats : int, optional
        Number of resampled sets of records.
    seed : int, optional
    progress : callable, optional
        Called with a short text from time to time.

    Raises
    ------
    IdentifyError
        If the level is not between 0 and 1, or there are fewer than 20 repeats.
    """
    if not 0 < level < 1 or repeats < LEAST_REPEATS:
        raise IdentifyError(
            got=f"level {level} and {repeats} repeats",
            need=f"a level between 0 and 1 and at least {LEAST_REPEATS} repeats",
        )
    random = np.random.default_rng(seed)
    worlds = [_World(one, evidence.actuator) for one in evidence.comparisons]
    again = _Again(evidence)
    found: list[Actuator] = []
    with one_thread():
        share = _unexplained(again, worlds, random)
        spread, own = _spread(again, worlds, share, random)
        for k in range(repeats):
            if k % 10 == 0:
                progress(f"identifying resampled cycles, {k} of {repeats}")
            other = again.actuator([world.resampled(random, share) for world in worlds])
            if other is not None:
                found.append(other)
    if len(found) < LEAST_REPEATS:
        raise IdentifyError(
            f"only {len(found)} of {repeats} resampled records could be identified", hint="record more cycles"
        )
    return Intervals(evidence.actuator, tuple(found), level, spread, _few(worlds, level), own)


class _Again:
    """Identifies resampled records by least squares."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._most = rows_of(evidence.regression.grid, _ENTRIES)
        self._step = max(1, len(evidence.regression.rows) // self._most)
        self._held = open_combinations(evidence)

    @property
    def by_absolutes(self) -> bool:
        """Whether the model was identified by least absolute deviations."""
        known = self._evidence.actuator.identification
        return known is not None and (known.method, known.norm) == ("record", "l1")

    @property
    def few_rows(self) -> int:
        """Rows for the comparison of two norms."""
        return rows_of(self._evidence.regression.grid, _FEWER)

    def errors(self, found: Coefficients) -> Array:
        """Return the voltage errors without the epochs' constants, divided by the slopes [m]."""
        rows = self._evidence.regression.rows
        step = max(1, len(rows) // self.few_rows)
        few = self._evidence.regression.thinned(self.few_rows)
        left = few.model(found)
        for epoch in np.unique(few.rows.epoch):
            left[few.rows.epoch == epoch] -= left[few.rows.epoch == epoch].mean()
        return left * self._evidence.weights[::step]

    def actuator(self, pieces: list[list[Record]]) -> Actuator | None:
        """Return the actuator of records; None if the program was not solved or the model is not invertible."""
        return self.made(self.identified(pieces))

    def made(self, answer: Coefficients) -> Actuator | None:
        """Return the actuator with these coefficients; None as in `actuator`."""
        if not answer.solved.optimal:
            return None
        try:
            return self._evidence.actuator_of(answer)
        except ModelError:
            return None

    def identified(self, pieces: list[list[Record]], norm: Norm = "l2", most: int | None = None) -> Coefficients:
        """Return the coefficients fitted to resampled records, with about `most` rows."""
        rows = self._most if most is None else most
        again = self._evidence.with_pieces(pieces)
        step = max(1, len(again.rows) // rows)
        weights = self._evidence.weights[::step]
        few = replace(again, rows=again.rows.thinned(rows))
        return few.fit(norm, weights, self._held)

    def slow(self, found: Coefficients) -> float:
        """Mean square of the legs' mean residuals [m2]."""
        weights = self._evidence.weights[:: self._step]
        weighted = found.solved.residual[: weights.size] * weights
        return float(np.mean(_leg_means(weighted, np.unique(self._evidence.leg_starts // self._step)) ** 2))

    def slow_of_model(self) -> float:
        """Return the mean square of the legs' mean residuals [m2] that the model itself leaves."""
        weighted = self._evidence.model.solved.residual * self._evidence.weights
        return float(np.mean(_leg_means(weighted, self._evidence.leg_starts) ** 2))


def _leg_means(values: Array, starts: Any) -> Array:
    """Return, at each sample (n,), the mean over its leg."""
    size = np.diff(np.append(starts, values.size))
    return np.repeat(np.add.reduceat(values, starts) / size, size)


def _unexplained(again: _Again, worlds: list[_World], random: np.random.Generator) -> float:
    """Return the share of the legs' mean residuals, 0 to 1, that resampled noise does not explain."""
    found = [again.identified([world.resampled(random, 0.0) for world in worlds]) for _ in range(_TRIALS)]
    made = float(np.mean([again.slow(one) for one in found if one.solved.optimal] or [0.0]))
    there = again.slow_of_model()
    return float(np.sqrt(max(0.0, 1 - made / there))) if there else 0.0


class _World:
    """One record as simulated by the model, and the residuals of its cycles."""

    def __init__(self, compared: RecordComparison, actuator: Actuator) -> None:
        self._pieces = compared.measured
        self._parts = [
            (number, slice(epoch.start, epoch.stop), played[3] - compared.datum, played[2] - played[3])
            for number, epoch, played in compared.played(actuator)
        ]
        self._residual = np.concatenate([residual for *_, residual in self._parts])
        voltage = np.concatenate([self._pieces[number].voltage[span] for number, span, *_ in self._parts])
        edges = np.cumsum([residual.size for *_, residual in self._parts])[:-1]
        self._slow = _leg_means(self._residual, leg_starts(voltage, edges))
        lengths = [cycle.stop - cycle.start for cycle in compared.record.record.cycles()]
        size = self._residual.size
        self._block = min(int(np.median(lengths)) if lengths else size, max(size // 4, 1))

    @property
    def cycles(self) -> int:
        """Number of cycles to draw from."""
        return self._residual.size // self._block

    def resampled(self, random: np.random.Generator, share: float) -> list[Record]:
        """Return the pieces with resampled displacements, which keep a share of the legs' mean residuals.

        A cycle starts at the same phase as the one that it replaces.
        """
        residual = self._residual - (1 - share) * self._slow
        new = [piece.displacement.copy() for piece in self._pieces]
        for number, span, simulated, _ in self._parts:
            count = -(-simulated.size // self._block)
            starts = self._block * random.integers(0, self.cycles, count)
            blocks = [
                sign * residual[start : start + self._block]
                for start, sign in zip(starts, random.choice([-1.0, 1.0], count), strict=True)
            ]
            new[number][span] = simulated + np.concatenate(blocks)[: simulated.size]
        return [replace(piece, displacement=y) for piece, y in zip(self._pieces, new, strict=True)]


def _few(worlds: list[_World], level: float) -> float:
    """Return Student's quantile over the normal quantile, with one degree of freedom less than there are cycles."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 * (1 + level)
    return float(stdtrit(max(sum(world.cycles for world in worlds) - 1, 1), upper) / ndtri(upper))


def open_combinations(evidence: Evidence) -> tuple[Array, Array] | None:
    """Return combinations of the movable stiffnesses that the records leave open, and their values in the model [V].

    None if the combinations are not known for this class of models, or none is open.
    """
    directions = evidence.identifiability
    combinations = directions.vectors[directions.determined :] * directions.breakaway[directions.movable]
    if directions.probing or not len(combinations):
        return None
    return combinations, combinations @ evidence.actuator.slip.stiffness[directions.movable]


def _spread(
    again: _Again, worlds: list[_World], share: float, random: np.random.Generator
) -> tuple[float, tuple[Actuator, ...]]:
    """Return how much more the model's norm scatters than least squares, and the models identified in that norm.

    Both norms see the same resampled records and are compared by voltage errors, because open coefficients scatter
    arbitrarily in either norm. The ratio is at least 1. For a least-squares model it is 1, without models.
    """
    both, own = [], []
    for _ in range(_PAIRS if again.by_absolutes else 0):
        pieces = [world.resampled(random, share) for world in worlds]
        pair = [again.identified(pieces, norm, again.few_rows) for norm in _NORMS]
        if all(one.solved.optimal for one in pair):
            both.append([again.errors(one) for one in pair])
            own.append(again.made(pair[1]))
    kept = tuple(one for one in own if one is not None)
    if len(both) < 2:
        return 1.0, kept
    squares, absolutes = np.var(both, axis=0).mean(axis=1)
    return float(np.sqrt(max(1.0, absolutes / squares))) if squares else 1.0, kept
