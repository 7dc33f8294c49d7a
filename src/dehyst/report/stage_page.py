"""The report page of a stage: its coupling, each axis, and what is left beside the voltages of the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from dehyst._io import PathLike, write_atomically
from dehyst._types import Array
from dehyst.identification import StageFit
from dehyst.records import Record
from dehyst.report.html import bullets, document, escape, figure, panel, reproduction, spelled, table
from dehyst.report.plots import MEASURED, line

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = 8000


def write_stage_report(path: PathLike, fit: StageFit, records: Sequence[Record], *, command: str | None = None) -> None:
    """Write a report of a stage to one HTML file that loads nothing from outside.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    fit : StageFit
    records : sequence of Record
        Those of the identification, training first.
    command : str, optional
        The command line to show.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    parts = [
        "<h1>Coupled axes</h1>",
        f"<p>{escape(spelled(fit.verdict))}.</p>",
        _coupling(fit),
        _errors(fit),
        *([] if fit.stage is None else _axes(fit, records)),
        bullets("Remarks", [escape(spelled(remark)) for remark in fit.remarks]),
        bullets("Axes", [escape(spelled(f"{a}: {one}")) for a, one in zip(fit.axes, fit.fits, strict=True)]),
        reproduction(command),
    ]
    write_atomically(path, document("Coupled axes", [part for part in parts if part]))


def _coupling(fit: StageFit) -> str:
    rows = []
    for i, axis in enumerate(fit.axes):
        cells = [
            "1" if i == j else f"{fit.coupling[i, j]:+.5f} ± {fit.uncertainty[i, j]:.5f}" for j in range(len(fit.axes))
        ]
        rows.append((axis, *cells))
    shares = ", ".join(f"{axis} {share:.5f}" for axis, share in zip(fit.axes, fit.rank_one_share, strict=True))
    words = (
        f"Displacement of each axis (row) for each metre that an actuator (column) moves, with its standard error. "
        f"Condition {fit.condition:.4g}. Rank-one share of what each voltage moves: {shares}. "
        f"{'Coupling is a matrix' if fit.is_matrix else 'Coupling is NOT a matrix'}."
    )
    left = [
        (
            fit.axes[i],
            fit.axes[j],
            f"{100 * fit.cross_talk.size[i, j]:.3f}",
            f"{fit.cross_talk.certainty[i, j]:.1f}",
            "yes" if fit.cross_talk.beyond[i, j] else "no",
        )
        for i in range(len(fit.axes))
        for j in range(len(fit.axes))
        if i != j
    ]
    head = ("axis", "by the voltage of", "left, % of the stroke (RMS)", "over its scatter", "more than a matrix")
    return (
        f"<h2>Coupling</h2><p>{escape(words)}</p>{table(('axis', *fit.axes), rows, 1)}"
        f"<p>What the voltage of another axis predicts beside the matrix, on time that was held out:</p>"
        f"{table(head, left, 2)}"
    )


def _errors(fit: StageFit) -> str:
    head = ("record", "axis", "role", "samples", "largest, % of the stroke", "RMS, %", "largest, nm")
    rows = [
        (
            e.record,
            e.axis,
            e.role,
            str(e.samples),
            f"{e.largest_percent:.3f}",
            f"{e.rms_percent:.3f}",
            f"{1e9 * e.largest:.1f}",
        )
        for e in fit.errors
    ]
    return f"<h2>Errors of simulating each record</h2>{table(head, rows, 3)}" if rows else ""


def _axes(fit: StageFit, records: Sequence[Record]) -> list[str]:
    parts = []
    for i, axis in enumerate(fit.axes):
        panels = [panel(axis, f"stage-{axis}-loops", _draw_loops, fit, records, i, label="loops")]
        drawn = _draw_residual, fit, records, i
        panels += [
            panel(axis, f"stage-{axis}-{other}", *drawn, j, role=f" beside v{other}", label="residual")
            for j, other in enumerate(fit.axes)
            if j != i
        ]
        words = (
            "Measured displacement over the axis' own voltage, then what the model leaves over the voltage of each "
            "other axis: a shape there is coupling that the matrix does not describe."
        )
        parts.append(figure(f"Axis {axis}", words, panels))
    return parts


def _residuals(fit: StageFit, records: Sequence[Record]) -> list[Array]:
    from dehyst.identification.coupling.matrix import AxisTraces

    return [AxisTraces.of(record, fit.fits, k, fit.coupling).residual(fit.coupling) for k, record in enumerate(records)]


def _draw_loops(ax: Axes, fit: StageFit, records: Sequence[Record], i: int) -> None:
    for record in records:
        rows = _drawn(len(record))
        line(ax, record.voltage[rows, i], record.displacement[rows, i] * 1e6, color=MEASURED, lw=0.6)
    ax.set(xlabel=f"voltage of {fit.axes[i]} (V)", ylabel=f"displacement {fit.axes[i]} (um)")


def _draw_residual(ax: Axes, fit: StageFit, records: Sequence[Record], i: int, j: int) -> None:
    for record, one in zip(records, _residuals(fit, records), strict=True):
        rows = _drawn(len(record))
        line(ax, record.voltage[rows, j], one[rows, i] * 1e9, color=MEASURED, lw=0.5)
    ax.set(xlabel=f"voltage of {fit.axes[j]} (V)", ylabel=f"residual of {fit.axes[i]} (nm)")


def _drawn(size: int) -> Array:
    return np.unique(np.linspace(0, size - 1, min(size, _MOST)).astype(np.intp))
