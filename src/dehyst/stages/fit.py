"""The result of an identification of a stage, and its summary."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._text import escaped
from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.identification import Fit, Readiness
from dehyst.stages.stage import Stage, by_axis, matrix_lines

_KEYS = (
    "verdict good axes coupling uncertainty condition rank_one_share is_matrix own_motion passes errors remarks "
    "residual_coupling_certainty=cross_talk.certainty"
)
# Coupling beyond a matrix, as a share of the stroke (RMS), with which a stage may still be used.
_SMALL = 0.003


@dataclass(frozen=True)
class AxisError:
    """How far the model of a stage misses one axis of a record.

    Attributes
    ----------
    record, role, axis : str
        `role` is training or validation.
    rms, largest : float
        [m].
    stroke : float
        Range of the axis in the training records [m], the reference of percentages.
    samples, left_out : int
        Samples that are compared, and others.
    """

    record: str
    role: str
    axis: str
    rms: float
    largest: float
    stroke: float
    samples: int
    left_out: int

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return 100 * self.rms / self.stroke

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return 100 * self.largest / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        lengths = {"rms_nm": 1e9 * self.rms, "largest_nm": 1e9 * self.largest, "stroke_um": 1e6 * self.stroke}
        return json_values(self, "record role axis rms_percent largest_percent samples left_out") | lengths


@dataclass(frozen=True, eq=False)
class CrossTalk:
    """What each voltage moves on the other axes beside the coupling matrix.

    Attributes
    ----------
    size, floor : (axes, axes) array
        RMS of what the voltage of axis j predicts of the residual of axis i, on time it was not fitted to, and what
        counts as nothing, as shares of the stroke of axis i; 0 on the diagonal.
    certainty : (axes, axes) array
        The improvement by the prediction over its scatter between spans of time.
    beyond : (axes, axes) bool array
        Where `size` is over `floor` and the certainty is sufficient: coupling is no number there.
    """

    size: Array
    floor: Array
    certainty: Array
    beyond: Any


@dataclass(frozen=True, eq=False)
class StageFit:
    """The result of an identification of a stage.

    Attributes
    ----------
    stage : Stage or None
        None only if an axis could not be identified.
    fits : tuple of Fit
        The identification of each axis on its decoupled displacement ``coupling^-1 y``.
    coupling, uncertainty : (axes, axes) array
        The coupling matrix, and the standard error of each entry (0 on the diagonal).
    rank_one_share : (axes,) array
        Of the energy of all displacements by each voltage, the share that is one shape times a column of the matrix.
    cross_talk : CrossTalk
        What is left of each axis that follows the voltage of another one.
    errors : tuple of AxisError
        Of simulating each record, training first, a row an axis.
    own_motion : (axes,) array
        Share of the motion of each voltage that no other voltage explains.
    passes : int
        How often matrix and axes were identified in turn.
    remarks : tuple of str
        Sentences: limits of the result.
    axes : tuple of str
        Names of the axes.
    """

    stage: Stage | None
    fits: tuple[Fit, ...]
    coupling: Array
    uncertainty: Array
    rank_one_share: Array
    cross_talk: CrossTalk
    errors: tuple[AxisError, ...]
    own_motion: Array
    passes: int
    remarks: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<StageFit of axes {', '.join(self.axes)}: {escaped(self.verdict)}>"

    @property
    def condition(self) -> float:
        """Condition number of the coupling matrix."""
        return float(np.linalg.cond(self.coupling))

    @property
    def is_matrix(self) -> bool:
        """Whether coupling is a matrix, as far as the records show."""
        return not bool(np.any(self.cross_talk.beyond))

    @property
    def good(self) -> bool:
        """Whether the model may be used: every axis is usable, and what no matrix describes of the coupling is small.

        Small is at most 0.3 % of the stroke (RMS). What the voltage of another axis moves more is no axis of its own.
        """
        if self.exchanged:
            return False
        small = bool(np.all(self.cross_talk.size[self.cross_talk.beyond] <= _SMALL))
        return self.stage is not None and all(fit.good for fit in self.fits) and small

    @property
    def exchanged(self) -> tuple[str, ...]:
        """Axes whose displacement the voltage of another axis moves more than their own."""
        beside = np.abs(self.coupling - np.eye(len(self.axes))).max(axis=1, initial=0.0)
        return tuple(axis for axis, most in zip(self.axes, beside.tolist(), strict=True) if most > 1)

    @property
    def verdict(self) -> str:
        """One sentence on what to expect of the stage."""
        if self.exchanged:
            return (
                f"Not usable: the voltage of another axis moves {', '.join(self.exchanged)} more than its own does; "
                "are the columns of displacements exchanged?"
            )
        if self.stage is None:
            bad = [axis for axis, fit in zip(self.axes, self.fits, strict=True) if fit.actuator is None]
            return f"Not usable: no model of axis {', '.join(bad)}"
        held = [error for error in self.errors if error.role == "validation"]
        judged, source = (held, "held-out") if held else (self.errors, "training")
        largest = max(judged, key=lambda error: error.largest_percent)
        rms = max(error.rms_percent for error in judged)
        missed = (
            f"the {source} records are missed by {largest.largest_percent:.2g} % of the stroke at most "
            f"(axis {largest.axis}), {rms:.2g} % RMS"
        )
        if not self.is_matrix:
            return f"{'Usable, with care' if self.good else 'Not usable'}: coupling is more than a matrix; {missed}"
        words = {Readiness.NOT_USABLE: "Not usable", Readiness.READY: "Ready for use"}
        levels = [fit.expectation.readiness for fit in self.fits if fit.expectation is not None]
        worst = Readiness.NOT_USABLE if Readiness.NOT_USABLE in levels or not self.good else None
        if worst is None and levels and all(level is Readiness.READY for level in levels):
            worst = Readiness.READY
        head = "Usable, with care" if worst is None else words[worst]
        return f"{head}: {missed}"

    def summary(self) -> str:
        """Return what `dehyst identify --axes` prints, in lines."""
        return "\n".join(escaped(line) for line in lines(self))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        return json_values(self, _KEYS) | {
            "residual_coupling_percent": (100 * self.cross_talk.size).tolist(),
            "residual_coupling_floor_percent": (100 * self.cross_talk.floor).tolist(),
            "fits": by_axis(self.axes, self.fits),
        }


def lines(fit: StageFit) -> Iterator[str]:
    """Yield verdict, coupling, errors, what is left of the coupling, the verdict of each axis, and remarks."""
    yield fit.verdict
    yield ""
    yield "Coupling: displacement of each axis (row) for each metre that an actuator (column) moves"
    yield from matrix_lines(fit.axes, fit.coupling, fit.uncertainty)
    yield f"Condition {fit.condition:.4g}; identified in turn with the axes, {fit.passes} times."
    shares = ", ".join(f"{axis} {share:.5f}" for axis, share in zip(fit.axes, fit.rank_one_share, strict=True))
    yield f"Rank-one share of what each voltage moves: {shares}."
    yield from talk_lines(fit)
    if fit.errors:
        width = max(len(f"{error.record} ({error.axis})") for error in fit.errors)
        yield ""
        yield f"{'record (axis)':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}  {'largest':>9}  {'RMS':>9}"
        for error in fit.errors:
            yield (
                f"{f'{error.record} ({error.axis})':<{width}}  {error.role:<10} {error.samples:>8} {error.left_out:>8}"
                f"  {error.largest_percent:>7.3f} %  {error.rms_percent:>7.3f} %"
            )
    for axis, one in zip(fit.axes, fit.fits, strict=True):
        yield ""
        yield f"Axis {axis}: {one}"
    if fit.remarks:
        yield ""
        yield "Remarks:"
        yield from (f"  - {remark}" for remark in fit.remarks)


def talk_lines(fit: StageFit) -> Iterator[str]:
    """Yield what is left of the coupling, and whether it is a matrix."""
    talk, axes = fit.cross_talk, fit.axes
    if fit.stage is None or len(axes) < 2:
        return
    i, j = np.unravel_index(int(np.argmax(talk.size)), talk.size.shape)
    largest = f"at most {100 * talk.size[i, j]:.2g} % of the stroke (RMS, {axes[j]} into {axes[i]})"
    floor = f"{100 * float(talk.floor.max()):.2g} %"
    if not talk.size.any():
        yield f"Coupling is a matrix: beside it no voltage moves another axis; {floor} of the stroke (RMS) would count."
    elif fit.is_matrix:
        yield f"Coupling is a matrix: beside it a voltage moves another axis by {largest}; {floor} would count."
    else:
        yield f"Coupling is NOT a matrix: beside it a voltage moves another axis by {largest}; {floor} counts."
