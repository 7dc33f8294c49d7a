"""Cross-talk: motion due to other voltages that the coupling matrix or the model of one axis does not describe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.coupling.matrix import AxisTraces, PlayColumns, block_means, motion_of
from dehyst.identification.results import Trace

# Parts of the records that are held out in turn, each of some spans.
_FOLDS, _SPANS = 6, 24
# What counts as coupling beyond a matrix: an improvement on held-out time by more than this share of the stroke (RMS),
# and by more than this multiple of its standard error.
_LEAST, _CERTAIN = 4e-4, 3.0
# Below this multiple of its standard error an improvement does not count; in between it is doubtful.
_DOUBTFUL = 1.0
# Least power of a span, of the mean, and of the motion of a column, in its range.
_LEAST_POWER, _STILL = 1e-3, 1e-2
# Of the energy of the columns.
_RIDGE = 1e-4
# Columns of a block that count: those that move most.
_DIRECTIONS = 12
# Rows of the residual of a single axis, and its least share (RMS) of the stroke for a warning of another voltage.
_MOST_ROWS, _LEAST_NEIGHBOUR = 12_000, 0.002


@dataclass(frozen=True, eq=False)
class CrossTalk:
    """Cross-talk: motion due to each voltage on the other axes that the coupling matrix does not describe.

    Attributes
    ----------
    size, floor : (axes, axes) array
        RMS of the residual of axis i that the voltage of axis j predicts on held-out time, and the least value that
        counts, as shares of the stroke of axis i; 0 on the diagonal.
    certainty : (axes, axes) array
        The improvement by the prediction over its scatter between spans of time.
    beyond : (axes, axes) bool array
        Where `size` is over `floor` and the certainty is sufficient: there, coupling is more than a number.
    """

    size: Array
    floor: Array
    certainty: Array
    beyond: Any

    def sentences(self, names: Sequence[str]) -> list[str]:
        """Return what is more than a number of the coupling of axes of these `names`, and what may be."""
        doubtful = (self.size > self.floor) & (self.certainty > _DOUBTFUL) & ~self.beyond
        found = []
        for i, j in np.argwhere(self.beyond | doubtful).tolist():
            moved = (
                f"in addition, the voltage of {names[j]} moves axis {names[i]} by {100 * self.size[i, j]:.2g} % of its "
                f"stroke (RMS), {self.certainty[i, j]:.2g} times the scatter"
            )
            found.append(
                f"coupling of {names[j]} into {names[i]} is more than a number: {moved}; it has hysteresis or a curve "
                "of its own, which no matrix describes"
                if self.beyond[i, j]
                else f"coupling of {names[j]} into {names[i]} may be more than a number: {moved}, of which "
                f"{_CERTAIN:g} would show it. More cycles of axis {names[j]} alone decide: dehyst excite stage"
            )
        return found


def cross_talk(columns: PlayColumns, traces: Sequence[AxisTraces], coupling: Array, strokes: Array) -> CrossTalk:
    """Return how well the voltage of each axis predicts the residuals of the others on held-out time.

    The rule: the plays of the voltage of axis j, bent by ramps, are fitted to axis i in five sixths of the spans of the
    records, together with those of axis i itself and the outputs of all models, so that models and matrix can give way.
    Coupling of j into i is more than a number if the plays of j improve the prediction of the other spans by more than
    three standard errors of the improvement, and by more than 0.04 % of the stroke (RMS).
    """
    residual = np.concatenate([block_means(one.residual(coupling), columns.every) for one in traces])
    rows = np.isfinite(residual).all(axis=1)
    outputs = np.concatenate([block_means(one.outputs, columns.every) for one in traces])[rows]
    spans = columns.groups(_SPANS)[rows]
    moving = [block[rows, :_DIRECTIONS] for block in columns.whitened]
    count = residual.shape[1]
    size, certainty = np.zeros((count, count)), np.zeros((count, count))
    for i in range(count):
        base, target = np.hstack([moving[i], outputs]), residual[rows, i] / strokes[i]
        for j in range(count):
            if i != j:
                size[i, j], certainty[i, j] = held_out_gain(base, moving[j], target, spans)
    floor = np.where(np.eye(count, dtype=bool), 0.0, _LEAST)
    beyond = (size > floor) & (certainty > _CERTAIN)
    return CrossTalk(size, floor, certainty, beyond)


def held_out_gain(base: Array, more: Array, target: Array, spans: NDArray[np.intp]) -> tuple[float, float]:
    """Return by how much (RMS) further columns improve the prediction of spans held out, and how certain that is.

    The certainty is the mean over the spans of the relative improvement, in its standard errors.

    The level of each span is free: it is not a motion due to a voltage. Spans in which the further columns do not move
    are left out; the others are weighted by their residual with all columns.
    """
    base, more = _without_levels(base, spans), _without_levels(more, spans)
    target = _without_levels(target[:, None], spans)[:, 0]
    both = np.hstack([base, more])
    missed = (target - both @ _fitted(both, target, np.ones(len(target)))) ** 2
    # Of each span the mean square; of one without rows the mean of all.
    count = np.bincount(spans, minlength=_SPANS)
    sums = np.bincount(spans, missed, minlength=_SPANS)
    power = np.where(count > 0, sums / np.maximum(count, 1), np.mean(missed))
    weights = (power.mean() / np.maximum(power, _LEAST_POWER * power.mean()))[spans]
    gains, shares, ratios = list[float](), list[float](), list[float]()
    least = _STILL * np.ptp(more, axis=0).max(initial=0.0)
    for fold in range(_FOLDS):
        out = spans % _FOLDS == fold
        if out.all() or not out.any():
            continue
        found = [_fitted(rows[~out], target[~out], weights[~out]) for rows in (base, both)]
        errors = [(target[out] - rows[out] @ fitted) ** 2 for rows, fitted in zip((base, both), found, strict=True)]
        for span in np.unique(spans[out]):
            where = spans[out] == span
            if np.ptp(more[out][where], axis=0).max() > least:
                before, after = (float(error[where].mean()) for error in errors)
                gains.append(before - after)
                ratios.append((before - after) / max(before + after, 1e-300))
                shares.append(float(weights[out][where].mean()))
    if len(gains) < 2:
        return 0.0, 0.0
    mean = float(np.array(shares) @ gains) / sum(shares)
    # Spans of large and of small motion count alike.
    scatter = float(np.std(ratios, ddof=1)) / np.sqrt(len(ratios))
    return float(np.sqrt(max(mean, 0.0))), float(np.mean(ratios)) / max(scatter, 1e-12) if mean > 0 else 0.0


def _without_levels(columns: Array, spans: NDArray[np.intp]) -> Array:
    """Return columns (m, n) less their mean in each span."""
    count = np.maximum(np.bincount(spans, minlength=_SPANS), 1)
    means = np.column_stack([np.bincount(spans, one, minlength=_SPANS) / count for one in columns.T])
    return np.asarray(columns - means[spans])


def _fitted(rows: Array, target: Array, weights: Array) -> Array:
    scales = np.sqrt((weights[:, None] * rows**2).sum(axis=0))
    scaled = rows / np.where(scales > 0, scales, 1.0)
    weighted = scaled * weights[:, None]
    gram = weighted.T @ scaled + _RIDGE * np.eye(rows.shape[1])
    return np.asarray(np.linalg.solve(gram, weighted.T @ target) / np.where(scales > 0, scales, 1.0))


@dataclass(frozen=True)
class Neighbour:
    """Another voltage with which the residual of a record is correlated.

    `column`: its name. `share`: RMS of the predicted residual, as a share of the stroke. `explained`: explained share
    of the residual's power.
    """

    record: str
    column: str
    share: float
    explained: float

    @property
    def sentence(self) -> str:
        """The warning."""
        return (
            f"{self.record}: the residual follows the voltage '{self.column}', by {100 * self.share:.2g} % of the "
            f"stroke (RMS; {100 * self.explained:.0f} % of the residual's power): it moves this axis too. "
            "Identify both together: --columns 'x=THIS_V:THIS_um, y=OTHER_V:OTHER_um'"
        )


def followed(trace: Trace, time: Array, others: Mapping[str, Array], stroke: float) -> list[Neighbour]:
    """Return the voltages that predict the residual of a trace on time that was held out, the largest first.

    Parameters
    ----------
    trace : Trace
    time : (n,) array
        [s] of the samples of the file.
    others : mapping of str to (n,) array
        Its other voltages, in any unit.
    stroke : float
        [m].
    """
    found, trace = [], trace.settled
    rows = np.minimum(np.searchsorted(time, trace.time - 1e-9), len(time) - 1)
    every = max(1, len(rows) // _MOST_ROWS)
    residual = block_means(trace.residual, every) / stroke
    place = np.arange(len(residual)) * _SPANS // max(len(residual), 1)
    own = _moving(block_means(_motion(trace.voltage), every))
    base = np.column_stack([own, block_means(trace.simulated, every)])
    for name, voltage in others.items():
        if np.ptp(voltage) > 0 and np.isfinite(voltage).all():
            motion = _moving(block_means(_motion(voltage)[rows], every))
            size, certainty = held_out_gain(base, motion, residual, place)
            if size > _LEAST_NEIGHBOUR and certainty > _CERTAIN:
                found.append(Neighbour(trace.record, name, size, min(size**2 / float(np.mean(residual**2)), 1.0)))
    return sorted(found, key=lambda one: -one.share)


def _motion(voltage: Array) -> Array:
    low, high = float(voltage.min()), float(voltage.max())
    return motion_of(voltage, low, max(high - low, 1e-12))[0]


def _moving(block: Array) -> Array:
    """Return the directions of a block that move most."""
    return np.asarray(np.linalg.svd(block - block.mean(axis=0), full_matrices=False)[0][:, :_DIRECTIONS])
