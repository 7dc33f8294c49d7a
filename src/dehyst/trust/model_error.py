"""The error of a model on motions that it was not identified from: of noise and of the model class together.

Parts of the records are left out, by time and by amplitude, the coefficients are identified from the rest, and the
model of the rest is simulated along what was left out: a cross-validation. The quantile of these errors is what the
model class and noise make together on motions like those of the records. A path may turn where no record does. There
models that agree on the records part: a plain model and a structured one of the same records, or the structured models
of the parts. By how much more they differ on the path than on the records, the error grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst.identification import RecordComparison, Structure
from dehyst.model import Actuator
from dehyst.records import rms, turning_points
from dehyst.trust.bootstrap import Intervals, open_combinations
from dehyst.trust.evidence import Evidence

# Parts of the records that are left out in turn: so many in the order of time, and as many in that of the ranges.
_PARTS = 8
# Legs wider than this part of the widest are never left out: nothing else shows the ends of the range.
_WIDEST = 0.9
# What stays must cover the displacements of what is left out but for this part of the stroke, and have so many rows.
_BEYOND, _LEAST_ROWS = 0.02, 0.2
# Rows of each regression.
_ROWS, _WIDE_ROWS = 20_000, 4_000
_SHORTEST_LEG = 8
# Models that agree on a short path may be wrong together: its error is at least this part of that on held-out parts.
_LEAST_GROWTH = 0.5
# Resampled models that are simulated along the records.
_MODELS = 20
# The structured model beside a plain one.
_BESIDE = Structure(elements=10, grades=3, knots=9, transformer=5)

Play = Callable[[Actuator], Array]


@dataclass(frozen=True)
class ClassError:
    """How far a path is missed by the error of the model class.

    Attributes
    ----------
    half : float
        Half of the width at the level [m], without what noise makes of the coefficients.
    held_out : float
        Largest error of that share of the held-out samples [m], noise of the sensor removed.
    growth : float
        Times as far as held-out parts the path is missed, for models that agree on the records part on it; it may be
        less than 1.
    parts : int
        How many parts were held out.
    open : bool
        Whether the records leave directions of the stiffnesses open, of which no part of them shows anything.
    """

    half: float
    held_out: float
    growth: float
    parts: int
    open: bool

    @property
    def sentence(self) -> str:
        """Where it comes from, in words."""
        if not self.parts:
            return (
                "No part of these records can be held out, so the largest misfit on them stands for the error of the "
                "model class: record loops of several amplitudes."
            )
        open_ = " Open directions of the stiffnesses come on top." if self.open else ""
        grown = f", times {self.growth:.2g} as this path turns where they do not" if self.growth > 1.05 else ""
        return f"The error of the model class is that on {self.parts} held-out parts of the records{grown}.{open_}"


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Models of parts of the records, and their errors on the other parts.

    Attributes
    ----------
    actuator : Actuator
    fits : tuple of Actuator
        One a part that is left out.
    error : float
        Largest error of the share `level` of the held-out samples [m], noise of the sensor removed.
    noise : float
        Half width of the interval by noise along the records [m].
    score : float
        Quantile of `level` in standard deviations of a normal distribution.
    beside : Actuator or None
        A structured model of the same records, of a plain one.
    apart : float
        RMS difference along the records [m] to `beside`; without one, of `fits` to the model.
    open : bool
        Whether the records leave directions of the stiffnesses open.
    """

    actuator: Actuator
    fits: tuple[Actuator, ...]
    error: float
    noise: float
    score: float
    beside: Actuator | None
    apart: float
    open: bool

    @classmethod
    def of(cls, evidence: Evidence, intervals: Intervals) -> HeldOut:
        """Leave out parts of the records in turn."""
        from scipy.special import ndtri

        score = float(ndtri(0.5 * (1 + intervals.level)))
        pairs = [pair for legs in _parts(evidence) if (pair := _fit_without(evidence, legs)) is not None]
        fits = tuple(fit for fit, _ in pairs)
        # All parts weigh by their samples.
        errors = np.abs(np.concatenate([error for _, error in pairs])) if pairs else np.zeros(1)
        sensor = max(item.record.noise for item in evidence.comparisons)
        error = float(np.quantile(errors, intervals.level))
        beside = None if evidence.actuator.wide else _beside(evidence)
        own = _along(evidence, evidence.actuator)
        others = fits if beside is None else (beside,)
        return cls(
            evidence.actuator,
            fits,
            float(np.sqrt(max(error**2 - (score * sensor) ** 2, 0.0))),
            score * intervals.widening * _scatter(evidence, intervals, own),
            score,
            beside,
            _apart((_along(evidence, one) for one in others), own),
            evidence.identifiability.determined < evidence.identifiability.of,
        )

    def on(self, play: Play, misfit: float) -> ClassError:
        """Return the error on a path, which `play` simulates with a model; without held-out parts it is the misfit."""
        if not self.fits:
            return ClassError(misfit, misfit, 1.0, 0, self.open)
        own = play(self.actuator)
        others = self.fits if self.beside is None else (self.beside,)
        apart = _apart((play(one) for one in others), own)
        growth = max(self._growth(apart), _LEAST_GROWTH)
        total = growth * self.error
        half = float(np.sqrt(max(total**2 - self.noise**2, 0.0)))
        return ClassError(half, self.error, growth, len(self.fits), self.open)

    def _growth(self, apart: float) -> float:
        """Return by how much a path is missed farther than held-out parts, where models are so far apart [m] on it."""
        if self.beside is None:
            return apart / self.apart if self.apart else 1.0
        more = self.score**2 * (apart**2 - self.apart**2)
        return float(np.sqrt(max(1 + more / self.error**2, 0.0))) if self.error else 1.0


@dataclass(frozen=True)
class _Leg:
    """Samples start..stop-1 of a piece of a record, between turning points and within an epoch."""

    record: int
    piece: int
    start: int
    stop: int
    low: float
    high: float

    @property
    def range(self) -> float:
        return self.high - self.low


def _legs(number: int, item: RecordComparison) -> Iterator[_Leg]:
    """Yield the legs of a record, their displacements on the model's axis."""
    for piece, epochs in enumerate(item.epochs):
        voltage, y = item.pieces[piece][1].voltage, item.measured[piece].displacement + item.datum
        turns = turning_points(voltage, 0.02 * float(np.ptp(voltage))).tolist()
        for epoch in epochs:
            edges = [epoch.start, *(turn for turn in turns if epoch.start < turn < epoch.stop), epoch.stop]
            for start, stop in pairwise(edges):
                if stop - start >= _SHORTEST_LEG:
                    own = y[start:stop]
                    yield _Leg(number, piece, start, stop, float(own.min()), float(own.max()))


def _parts(evidence: Evidence) -> Iterator[list[_Leg]]:
    """Yield legs to leave out: neighbours in time, then those of like ranges."""
    legs = [leg for number, item in enumerate(evidence.comparisons) for leg in _legs(number, item)]
    widest = max((leg.range for leg in legs), default=0.0)
    inner = [leg for leg in legs if leg.range < _WIDEST * widest]
    groups = [*_split(inner), *_split(sorted(inner, key=lambda leg: leg.range))]
    for group in groups:
        if group and _covered(group, [leg for leg in legs if leg not in group], _BEYOND * evidence.stroke):
            yield group


def _split(legs: list[_Leg]) -> list[list[_Leg]]:
    """Return runs of legs of about as many samples."""
    ends = np.cumsum([leg.stop - leg.start for leg in legs])
    number = (_PARTS * (ends - 1) // ends[-1]).tolist() if legs else []
    return [[leg for leg, k in zip(legs, number, strict=True) if k == part] for part in range(_PARTS)]


def _covered(group: list[_Leg], rest: list[_Leg], slack: float) -> bool:
    """Whether the displacements of a group lie within those of the rest."""
    if not rest:
        return False
    low, high = min(leg.low for leg in rest) - slack, max(leg.high for leg in rest) + slack
    return all(low <= leg.low and leg.high <= high for leg in group)


def _fit_without(evidence: Evidence, legs: list[_Leg]) -> tuple[Actuator, Array] | None:
    """Return the actuator that the other legs give, and its errors on these; None if they do not give one."""
    rows = evidence.regression.rows
    kept = ~_within(evidence, legs)
    if kept.sum() < _LEAST_ROWS * len(rows) or np.unique(rows.epoch[kept]).size < np.unique(rows.epoch).size:
        return None
    most = _WIDE_ROWS if evidence.actuator.wide else _ROWS
    step = max(1, int(kept.sum()) // most)
    chosen = np.flatnonzero(kept)[::step]
    mask = np.zeros(len(rows), dtype=bool)
    mask[chosen] = True
    held = None if evidence.actuator.wide else open_combinations(evidence)
    try:
        found = evidence.regression.chosen(mask).fit("l2", evidence.weights[mask], held)
        if not found.solved.optimal:
            return None
        actuator = evidence.actuator_of(found)
    except ModelError:
        return None
    return actuator, _errors(evidence, actuator, legs)


def _within(evidence: Evidence, legs: list[_Leg]) -> Mask:
    """Return which rows lie on legs."""
    rows = evidence.regression.rows
    inside = np.zeros(len(rows), dtype=bool)
    for leg in legs:
        time = evidence.comparisons[leg.record].pieces[leg.piece][1].time
        first, last = time[leg.start], time[leg.stop - 1]
        inside |= (rows.record == leg.record) & (rows.time >= first) & (rows.time <= last)
    return inside


def _errors(evidence: Evidence, actuator: Actuator, legs: list[_Leg]) -> Array:
    """Return simulated less measured displacements on legs [m], all samples of the records simulated."""
    errors = []
    for number, item in enumerate(evidence.comparisons):
        own = [leg for leg in legs if leg.record == number]
        for piece, epoch, played in item.played(actuator) if own else ():
            off = played[3] - played[2]
            errors += [
                off[leg.start - epoch.start : leg.stop - epoch.start]
                for leg in own
                if leg.piece == piece and epoch.start <= leg.start < epoch.stop
            ]
    return np.concatenate(errors)


def _along(evidence: Evidence, actuator: Actuator) -> Array:
    """Return the displacement that a model makes of all records that count [m]."""
    return np.concatenate([played[3] for item in evidence.comparisons for *_, played in item.played(actuator)])


def _apart(paths: Iterable[Array], own: Array) -> float:
    """Return the RMS difference of paths from the model's [m], one in memory at a time."""
    squares = [rms(path - own) ** 2 for path in paths]
    return float(np.sqrt(np.mean(squares))) if squares else 0.0


def _scatter(evidence: Evidence, intervals: Intervals, own: Array) -> float:
    """Return the standard deviation of resampled models along the records [m], its RMS value."""
    total, squares, count = np.zeros_like(own), np.zeros_like(own), 0
    for model in intervals.actuators[:_MODELS]:
        off = _along(evidence, model) - own
        total, squares, count = total + off, squares + off**2, count + 1
    return float(np.sqrt(np.mean(np.maximum(squares / count - (total / count) ** 2, 0.0))))


def _beside(evidence: Evidence) -> Actuator | None:
    """Return a structured model of the same records; None if they do not give one."""
    actuator, regression = evidence.actuator, evidence.with_structure(_BESIDE).thinned(_WIDE_ROWS)
    try:
        found = regression.fit_weighted("l2")
        if not found.solved.optimal or evidence.reference not in found.offsets:
            return None
        # On the axes of the plain model.
        first = found.offsets[evidence.reference] - evidence.model.offsets[evidence.reference]
        first += float(actuator.spring.voltage[0])
        return found.to_actuator(regression.grid, first, limits=actuator.limits, delay=actuator.delay)
    except ModelError:
        return None
