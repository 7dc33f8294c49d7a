"""Coupled axes (theory section 16): the coupling matrix by one linear least squares, then each axis by itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError, RecordError, of_part
from dehyst._native import slip_elongations
from dehyst._text import digits, escaped
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.identification.expectation import Readiness
from dehyst.identification.fit import Fit
from dehyst.identification.results import RecordErrors
from dehyst.model import Stage, apply, by_axis, inverse, matrix_lines
from dehyst.records import Record

# Radii of the plays of a voltage, as parts of its range; number of segments of the range of each play.
_RADII, _SEGMENTS = np.geomspace(0.01, 0.5, 19), 6
# Largest number of samples of a regression; longer records are thinned evenly.
_MOST_ROWS = 24_000
# Ridge as a part of the energy of a column, for columns that the record hardly moves.
_RIDGE = 1e-8
# Number of time spans that are left out in turn for the standard errors.
_SPANS = 24
# Passes that weight time spans by their residuals; least power of the residual of a span, as a part of the mean power.
_REWEIGHTED, _LEAST_POWER = 4, 1e-3
# Number of cycles of a time span with a free level; largest number of such spans of a record.
_CYCLES, _MOST_LEVELS = 3, 24
# Time constant of a logarithmic drift since the start of a record, as a part of the duration of the record.
_LOGARITHM = 1e-3
# Least share of the motion of a voltage that other voltages do not explain; of a displacement that voltages explain.
SEPARATE, _EXPLAINED = 0.01, 0.05
# Two displacements are equal if they differ by less than this part of the stroke, the rounding of a file.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class StageFit:
    """The result of an identification of a stage.

    Attributes
    ----------
    stage : Stage
    fits : tuple of Fit
        The identification of each axis on its decoupled displacement ``coupling^-1 y``.
    coupling, uncertainty : (axes, axes) array
        The coupling matrix, and the standard error of each entry (0 on the diagonal).
    axes : tuple of str
        Names of the axes.
    """

    stage: Stage
    fits: tuple[Fit, ...]
    coupling: Array
    uncertainty: Array
    axes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<StageFit of axes {', '.join(self.axes)}: {escaped(self.verdict)}>"

    @property
    def model(self) -> Stage:
        """The stage; `Fit.model` is its counterpart for one actuator."""
        return self.stage

    @property
    def errors(self) -> tuple[RecordErrors, ...]:
        """Errors of each record on its decoupled displacement, axis by axis."""
        return tuple(error for fit in self.fits for error in fit.errors)

    @property
    def good(self) -> bool:
        """Whether the model may be used: every axis is usable, and its voltage moves it more than any other voltage."""
        return not self.exchanged and all(fit.good for fit in self.fits)

    @property
    def exchanged(self) -> tuple[str, ...]:
        """Axes that the voltage of another axis moves more than their own voltage."""
        others = np.abs(self.coupling - np.eye(len(self.axes))).max(axis=1, initial=0.0)
        return tuple(axis for axis, most in zip(self.axes, others.tolist(), strict=True) if most > 1)

    @property
    def verdict(self) -> str:
        """One sentence on the expected error of the stage: the promise of its worst axis."""
        if self.exchanged:
            return (
                f"Not usable: the voltage of another axis moves {', '.join(self.exchanged)} more than its own voltage; "
                "check whether the columns of displacements are exchanged"
            )
        # The worst axis has the lowest readiness, and then the largest error.
        levels = list(Readiness)
        axis, worst = max(
            zip(self.axes, self.fits, strict=True),
            key=lambda pair: (
                not pair[1].good,
                levels.index(pair[1].promise.readiness),
                pair[1].promise.largest_percent,
            ),
        )
        ended = "" if worst.outcome.good else f"; {worst.outcome.value.rstrip('.')}"
        return f"{worst.promise.headline} (axis {axis}){ended}"

    def summary(self, full: bool = False) -> str:
        """Return the text that `dehyst identify` prints for several axes; `full`: with `--verbose`."""
        return "\n".join(escaped(line) for line in (self._lines if full else self._brief)())

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        keys = "verdict good axes coupling uncertainty condition=stage.condition"
        return json_values(self, keys) | {"fits": by_axis(self.axes, self.fits)}

    def _brief(self) -> Iterator[str]:
        """Yield the expected error of each axis, or why the stage is not usable."""
        if self.exchanged:
            yield self.verdict
        for axis, fit in zip(self.axes, self.fits, strict=True):
            yield f"Axis {axis}: {fit.summary().splitlines()[0]}"

    def _lines(self) -> Iterator[str]:
        """Yield verdict, coupling, and the summary of each axis."""
        yield from (self.verdict, "")
        yield "Coupling: displacement of each axis (row) for each metre that an actuator (column) moves"
        yield from matrix_lines(self.axes, self.coupling, self.uncertainty)
        yield f"Condition {self.stage.condition:.4g}."
        for axis, fit in zip(self.axes, self.fits, strict=True):
            yield from ("", f"Axis {axis}: {fit.summary(full=True)}")


def identify_axes(
    training: Sequence[Record],
    held_out: Sequence[Record],
    identify: Callable[[list[Record], list[Record], Progress], Fit],
    report: Progress,
) -> StageFit:
    """Identify a stage: its coupling matrix, then each axis alone by `identify`.

    Plays of the voltages give the motion of each actuator. Least squares of all displacements on these motions give the
    coupling matrix. Then each axis is identified from its voltage and ``coupling^-1 y``.

    Raise `RecordError` or `IdentifyError` as `dehyst.identify`, with the name of the axis; or if a voltage or
    displacement of an axis never moves, two displacements are the same, two axes always move together, or records have
    different axes.
    """
    names, every = training[0].axes, [*training, *held_out]
    for other in every:
        if other.axes != names:
            raise RecordError(
                f"record '{other.name}': has the axes {', '.join(other.axes)}, but '{training[0].name}' has "
                f"{', '.join(names)}; give records of the same axes in the same order"
            )
    refuse_still(training)
    _refuse_equal(training)
    report("coupling of the axes")
    with one_thread():
        plays = Plays.of(training)
        _refuse_inseparable(names, plays.separate())
        coupling, uncertainty = plays.coupling()
    table, fits = inverse(coupling), list[Fit]()
    for j, axis in enumerate(names):
        alone, validate = (
            [replace(record.axis(j), displacement=apply(table, record.displacement)[:, j]) for record in some]
            for some in (training, held_out)
        )
        try:
            fits.append(identify(alone, validate, lambda words, axis=axis: report(f"axis {axis}: {words}")))  # type: ignore[misc]
        except (RecordError, IdentifyError) as error:
            raise of_part(error, f"axis {axis}") from error.__cause__
    provenance = {
        "dehyst": __version__,
        "records": [{"name": record.name, **record.meta} for record in training],
        "coupling_uncertainty": uncertainty.tolist(),
    }
    stage = Stage(
        tuple(fit.actuator for fit in fits),
        coupling,
        names,
        provenance=provenance,
        recorded_columns=tuple(training[0].meta.get("axes", ())),
    )
    return StageFit(stage, tuple(fits), coupling, uncertainty, names)


@dataclass(frozen=True, eq=False)
class Plays:
    """Plays of all voltages and displacements of a stage; the samples of all records are concatenated.

    Attributes
    ----------
    axes : tuple of str
    blocks : tuple of (m, K) array
        Curves of the plays of each voltage.
    slow : (m, P) array
        Slow motions of each record that no voltage explains.
    displacement : (m, axes) array
        Displacements [m].
    spans : (m,) array
        Number of the time span of each sample.
    """

    axes: tuple[str, ...]
    blocks: tuple[Array, ...]
    slow: Array
    displacement: Array
    spans: NDArray[np.intp]

    @classmethod
    def of(cls, records: Sequence[Record]) -> Plays:
        """Make the plays of each voltage, scaled by its range in all records."""
        from scipy.linalg import block_diag

        low = np.min([record.voltage.min(axis=0) for record in records], axis=0)
        width = np.max([record.voltage.max(axis=0) for record in records], axis=0) - low
        every = max(1, sum(map(len, records)) // _MOST_ROWS)
        blocks = [[_play_curves(u)[::every] for u in ((record.voltage - low) / width).T] for record in records]
        displacement = [record.displacement[::every] for record in records]
        return cls(
            records[0].axes,
            tuple(map(np.concatenate, zip(*blocks, strict=True))),
            block_diag(*[_slow(record)[::every] for record in records]),
            np.concatenate(displacement),
            np.concatenate([np.arange(len(own)) * _SPANS // len(own) for own in displacement]),
        )

    def coupling(self) -> tuple[Array, Array]:
        """Return the coupling matrix (axes, axes), and the standard error of each entry.

        Each displacement is fitted to the plays of all voltages; the fitted plays of its own voltage are the motion of
        its actuator. Then all displacements are fitted to these motions. Raise `RecordError` if the voltages explain
        less than 5 % of the motion of a displacement.
        """
        explained = 1 - self.unexplained(self.displacement, self.blocks)
        for name, share in zip(self.axes, explained.tolist(), strict=True):
            if share < _EXPLAINED:
                raise RecordError(
                    f"axis {name}: its displacement follows none of the voltages: they explain {digits(100 * share)} % "
                    "of its motion; check its sensor, and the column that is read: --columns"
                )
        rows, first, motions = _scaled([*self.blocks, self.slow]), 0, []
        for block, measured in zip(self.blocks, self.displacement.T, strict=True):
            grams, rights = self._weighted(rows, measured)
            own = slice(first, first := first + block.shape[1])
            motions.append(rows[:, own] @ _solution(grams.sum(axis=0), rights.sum(axis=0))[own])
        rows, count = _scaled([np.column_stack(motions), self.slow]), len(motions)
        sizes = np.linalg.norm(motions, axis=1)
        matrix, uncertainty = np.empty((count, count)), np.empty((count, count))
        for i, measured in enumerate(self.displacement.T):
            grams, rights = self._weighted(rows, measured)
            gram, right = grams.sum(axis=0), rights.sum(axis=0)
            without = zip(gram - grams, right - rights, strict=True)
            found = np.array([_solution(*sums)[:count] / sizes for sums in ((gram, right), *without)])
            found /= found[:, [i]]
            matrix[i], uncertainty[i] = found[0], np.sqrt((len(grams) - 1) * found[1:].var(axis=0))
        return matrix, uncertainty

    def _weighted(self, rows: Array, measured: Array) -> tuple[Array, Array]:
        """Return the weighted products (S, p, p) and (S, p) of each time span.

        Residuals differ between time spans and are largest while an axis moves: the weight of a span is inverse to its
        mean square residual.
        """
        spans = [self.spans == span for span in np.unique(self.spans)]
        grams = np.array([rows[span].T @ rows[span] for span in spans])
        rights = np.array([rows[span].T @ measured[span] for span in spans])
        weights = np.ones(len(spans))
        for _ in range(_REWEIGHTED):
            left = measured - rows @ _solution(np.tensordot(weights, grams, 1), weights @ rights)
            power = np.array([np.mean(left[span] ** 2) for span in spans])
            weights = 1 / np.maximum(power, _LEAST_POWER * power.mean())
            weights /= weights.mean()
        return weights[:, None, None] * grams, weights[:, None] * rights

    def separate(self) -> Array:
        """Return the share (axes,) of the motion of each voltage that no plays of the other voltages explain."""
        shares = []
        for j, block in enumerate(self.blocks):
            others = [other for k, other in enumerate(self.blocks) if k != j]
            shares.append(self.unexplained(block.sum(axis=1, keepdims=True), others)[0])
        return np.array(shares)

    def unexplained(self, motion: Array, blocks: Sequence[Array]) -> Array:
        """Return the share of each motion (m, k), without slow motions, that the columns of `blocks` do not explain."""
        energies = [(_left(rows, motion) ** 2).sum(axis=0) for rows in ([self.slow], [self.slow, *blocks])]
        return np.asarray((energies[1] + 1e-300) / (energies[0] + 1e-300))


def _play_curves(u: Array) -> Array:
    """Return curves (n, C) of plays of a voltage `u` (n,), 0 to 1 in its range; their sums follow any hysteresis.

    Each play, and the voltage itself, is divided into its parts in each segment of the range.
    """
    elongation, _ = slip_elongations(_RADII, np.full(_RADII.size, u[0]), np.ascontiguousarray(u))
    plays = np.column_stack([u, u[:, None] - elongation])
    edges = np.linspace(0.0, 1.0, _SEGMENTS + 1)
    return np.hstack([np.clip(plays, a, b) - a for a, b in pairwise(edges)])


def _scaled(columns: Sequence[Array]) -> Array:
    """Return the columns in one array, each scaled to length 1; a column of zeros is not changed."""
    rows = np.hstack(columns)
    sizes = np.linalg.norm(rows, axis=0)
    return np.asarray(rows / np.where(sizes > 0, sizes, 1.0))


def _solution(gram: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(gram + _RIDGE * np.eye(len(gram)), right))


def _left(columns: Sequence[Array], motion: Array) -> Array:
    """Return the residual of motions (m, k) after a least-squares fit of columns."""
    rows = _scaled(columns)
    return np.asarray(motion - rows @ _solution(rows.T @ rows, rows.T @ motion))


def _slow(record: Record) -> Array:
    """Return slow motions (n, P) that no voltage explains: drifts since the start, and a level for each time span."""
    since = (record.time - record.time[0]) / (record.time[-1] - record.time[0])
    logarithmic = np.log1p(since / _LOGARITHM) / np.log1p(1 / _LOGARITHM)
    cycles = sum(len(record.axis(j).cycles()) for j in range(len(record.axes)))
    count = int(np.clip(cycles / _CYCLES, 1, _MOST_LEVELS))
    levels = (np.arange(len(record)) * count // len(record))[:, None] == np.arange(count)
    return np.column_stack([since - 0.5, logarithmic - 0.5, levels])


def refuse_still(records: Sequence[Record]) -> None:
    """Raise `RecordError` if the voltage of an axis is constant in all records."""
    for j, name in enumerate(records[0].axes):
        if all(np.ptp(record.voltage[:, j]) == 0 for record in records):
            held = records[0].voltage[0, j]
            raise RecordError(
                f"axis {name}: its voltage is constant, {held:.6g} V, need one that moves; move all axes in the "
                "record, one after the other or together: dehyst excite stage"
            )


def _refuse_equal(records: Sequence[Record]) -> None:
    """Raise `RecordError` if the displacements of two axes differ by a constant."""
    names = records[0].axes
    for i, j in combinations(range(len(names)), 2):
        pairs = [record.displacement[:, [i, j]] for record in records]
        if all(np.ptp(pair[:, 0] - pair[:, 1]) <= _ROUNDING * np.ptp(pair, axis=0).max() for pair in pairs):
            raise RecordError(
                f"axes {names[i]} and {names[j]}: their displacements differ by a constant only; check which "
                "column is read as which axis: --columns"
            )


def _refuse_inseparable(names: Sequence[str], shares: Array) -> None:
    """Raise `IdentifyError` if the voltage of an axis never moves by itself."""
    for name, share in zip(names, shares, strict=True):
        if share < SEPARATE:
            others = ", ".join(other for other in names if other != name)
            raise IdentifyError(
                f"axis {name}: its voltage always moves together with the voltage of {others} ({digits(100 * share)} % "
                "of its motion is separate), so that their displacements cannot be distinguished; record the axes one "
                "after the other, or together with different periods: dehyst excite stage"
            )
