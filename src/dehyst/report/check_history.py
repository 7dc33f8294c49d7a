"""The picture of a history of checks: the error and each kind of change over the checks."""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from dehyst._errors import IdentifyError
from dehyst._io.drafts import write_atomically
from dehyst._io.marks import GENERATOR
from dehyst.identification import CheckHistory
from dehyst.identification.checking.history import ControlChart
from dehyst.report.plots import INK, MEASURED, SIMULATED, svg_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Height of one panel [in], and of what is around all of them.
_PANEL, _AROUND = 1.15, 0.5
# So many labels fit below.
_LABELS = 8
_GREY = "#999999"


def write_check_history(path: str | PathLike[str], history: CheckHistory) -> None:
    """Draw a history to an SVG file: the errors with the goal, then each kind of change with its control limits.

    Points are single checks, lines their exponentially weighted moving averages.

    Parameters
    ----------
    path : path-like
        Replaced if it exists; never left half written.
    history : CheckHistory
        One check at least.

    Raises
    ------
    IdentifyError
        If there is no check.
    MissingExtraError
        If matplotlib is not installed.
    FileFormatError
        If the file cannot be written.
    """
    if not history.checks:
        raise IdentifyError(f"{history.folder}: got no check of this model, need one at least; run dehyst check first")
    charts = history.charts()

    def draw(first: Axes, *others: Axes) -> None:
        _errors(first, history)
        for ax, chart in zip(others, charts, strict=True):
            _chart(ax, chart)
        _dates((others or (first,))[-1], history)

    rows = 1 + len(charts)
    height = _AROUND + _PANEL * rows
    write_atomically(path, svg_file("checks", draw, rows=rows, height=height, creator=GENERATOR))


def _errors(ax: Axes, history: CheckHistory) -> None:
    """Draw the largest error of each check, its average and the goal."""
    numbers, errors = np.arange(1, len(history.checks) + 1), [one.error for one in history.checks]
    goals = [one.goal for one in history.checks]
    ax.plot(numbers, goals, color=_GREY, lw=0.8, ls="--")
    ax.plot(numbers, history.average_error(), color=SIMULATED, lw=1)
    ax.plot(numbers, errors, color=MEASURED, ls="none", marker="o", ms=3)
    ax.set_ylabel("error\n(% of stroke)")
    ax.set_ylim(0, 1.15 * max(*errors, *goals))


def _chart(ax: Axes, chart: ControlChart) -> None:
    """Draw one kind of change in standard deviations: checks, average and its limits, sums beyond theirs as crosses."""
    numbers = chart.places + 1
    ax.axhline(0, color=INK, lw=0.6)
    for sign in (-1, 1):
        ax.plot(numbers, sign * chart.limits, color=_GREY, lw=0.8, ls="--")
    ax.plot(numbers, chart.average, color=SIMULATED, lw=1)
    ax.plot(numbers, chart.scores, color=MEASURED, ls="none", marker="o", ms=3)
    alarms = chart.alarms
    ax.plot(numbers[alarms], chart.scores[alarms], color=SIMULATED, ls="none", marker="o", ms=6.5, mfc="none")
    ax.margins(y=0.12)
    ax.set_ylabel(f"{chart.name}\n(deviations)")


def _dates(ax: Axes, history: CheckHistory) -> None:
    """Write the dates of some checks below."""
    count = len(history.checks)
    shown = np.arange(0, count, -(-count // _LABELS))
    ax.set_xticks(shown + 1, [f"{k + 1}\n{history.checks[k].checked:%m-%d}" for k in shown])
    ax.set_xlabel(f"check and day, {history.checks[0].checked:%Y-%m-%d} to {history.checks[-1].checked:%Y-%m-%d}")
