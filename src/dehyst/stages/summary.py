"""The result of an identification of a stage in words: the lines of `StageFit.summary`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dehyst._types import Array

if TYPE_CHECKING:
    from dehyst.stages.fit import StageFit


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


def matrix_lines(axes: tuple[str, ...], matrix: Array, uncertainty: Array | None = None) -> Iterator[str]:
    """Yield a matrix as a table, each entry with its standard error."""
    width = max(18, *(len(axis) + 2 for axis in axes))
    yield " " * 8 + "".join(f"{axis:>{width}}" for axis in axes)
    for i, axis in enumerate(axes):
        cells = [
            f"{matrix[i, j]:.5f}" if i == j or uncertainty is None else f"{matrix[i, j]:+.5f} ±{uncertainty[i, j]:.5f}"
            for j in range(len(axes))
        ]
        yield f"{axis:<8}" + "".join(f"{cell:>{width}}" for cell in cells)


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
