"""Figures of an identification and of the parts of an actuator, as SVG text; the only door to matplotlib."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import MissingExtraError
from dehyst._io import write_atomically
from dehyst._types import Array
from dehyst.identification import Trace
from dehyst.model import Actuator, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.summary import Slopes, bend, step_response

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Measured and simulated from Okabe and Ito, the branches from Tol: distinct in any colour vision, and in grey.
MEASURED, SIMULATED = "#0072B2", "#D55E00"
RISING, FALLING = "#44AA99", "#332288"
INK, _PALE = "#333333", "#D9D9D9"
_INCHES = 4.8
_DPI = 170
# Of journals: the width of a column and of a page [in], and the least resolution of a line drawing with greys.
COLUMN, PAGE = 3.4, 7.0
_JOURNAL_DPI = 600
# More points than this become one image inside the figure: as vectors they would take 100 bytes each.
_VECTOR_POINTS = 1500
_VECTOR_VERTICES = 20_000
# Beyond this many points the branch drawn last would hide the other.
MOST_BRANCH_POINTS = 20_000
# A line leaves out vertices that do not move by this part of its range, a quarter of a printed pixel.
_CELLS = 2000
# Metadata that would make each SVG file different.
_NO_METADATA = ("Creator", "Date", "Format", "Type")
_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.borderaxespad": 0.3,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 3,
    "ytick.major.size": 3,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ECECEC",
    "grid.linewidth": 0.5,
    "axes.formatter.useoffset": False,
    "agg.path.chunksize": 20_000,
}


@dataclass(frozen=True)
class Drawing:
    """A finished figure: an SVG file, its part for a page, and a PNG file."""

    svg: str
    inline: str
    png: bytes

    def save(self, path: str | PathLike[str]) -> list[Path]:
        """Write path.svg and path.png, each wholly or not at all; raises FileFormatError if that is impossible."""
        target = Path(path)
        written: list[tuple[Path, str | bytes]] = [
            (target.with_name(f"{target.name}.svg"), self.svg),
            (target.with_name(f"{target.name}.png"), self.png),
        ]
        for file, content in written:
            write_atomically(file, content)
        return [file for file, _ in written]


def drawing(
    name: str,
    draw: Callable[..., None],
    *,
    size: tuple[float, float],
    rows: int = 1,
    columns: int = 1,
    share: bool = False,
    heights: tuple[float, ...] | None = None,
) -> Drawing:
    """Draw a figure for print in the house style.

    Raise `MissingExtraError` if matplotlib is not installed.

    Parameters
    ----------
    name : str
        Makes the ids inside the SVG unique on a page.
    draw : callable
        Gets rows x columns axes, row by row.
    size : (float, float)
        Width and height [in]; widths of a journal are `COLUMN` and `PAGE`.
    rows, columns : int
    share : bool
        Whether axes above one another share the abscissa, and those side by side the ordinate.
    heights : tuple of float, optional
        Relative heights of the rows.
    """
    text, picture = io.StringIO(), io.BytesIO()
    with _figure(name, size) as figure:
        grid = None if heights is None else {"height_ratios": heights}
        shared: dict[str, Any] = {"sharex": "col", "sharey": "row"} if share else {}
        axes = figure.subplots(rows, columns, squeeze=False, gridspec_kw=grid, **shared)
        draw(*axes.ravel())
        figure.align_ylabels()
        figure.savefig(text, format="svg", metadata=dict.fromkeys(_NO_METADATA))
        figure.savefig(picture, format="png", dpi=_JOURNAL_DPI, metadata={"Software": None})
    return Drawing(text.getvalue(), _inline(text.getvalue()), picture.getvalue())


def line(ax: Axes, x: Array, y: Array, **style: Any) -> None:
    """Draw a line through many samples with only the vertices that print can show."""
    ax.plot(*thinned(np.arange(x.size, dtype=np.float64), x, y), **style)


def draw_both(ax: Axes, trace: Trace, measured: Array, simulated: Array, *, labels: bool = True) -> None:
    """Draw what was measured and what was simulated over the voltage of a trace, broken where samples are missing."""
    for y, colour, width, alpha, label in (
        (measured, MEASURED, 2.4, 0.45, "measured"),
        (simulated, SIMULATED, 0.8, 1.0, "simulated"),
    ):
        v, shown = thinned(trace.time, trace.voltage, y)
        big = v.size > _VECTOR_VERTICES
        ax.plot(v, shown, color=colour, lw=width, alpha=alpha, label=label if labels else None, rasterized=big)


def draw_slip_elements(upper: Axes, lower: Axes, slip: MaxwellSlip) -> None:
    """Draw stiffness and breakaway voltage of each element over its breakaway elongation; hollow where zero."""
    factor, unit = length_unit(float(slip.breakaway[-1]))
    stems(upper, slip.breakaway * factor, slip.stiffness * 1e-6, "stiffness (V/µm)")
    stems(lower, slip.breakaway * factor, slip.friction, "breakaway voltage (V)")
    lower.set_xlabel(f"breakaway elongation ({unit})")
    lower.set_xlim(0, 1.05 * float(slip.breakaway[-1]) * factor)


def draw_spring(upper: Axes, lower: Axes, spring: Spring) -> None:
    """Draw the voltage of the parallel spring over displacement, its slope beneath with the least one marked."""
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    y, slopes = spring.displacement * factor, spring.slopes * 1e-6
    upper.plot(y, spring.voltage, color=MEASURED, lw=1, marker="o", ms=2.2)
    upper.set_ylabel("spring voltage (V)")
    lower.stairs(slopes, y, baseline=None, color=MEASURED, lw=1)
    least = int(np.argmin(slopes))
    lower.plot(y[least : least + 2], slopes[[least, least]], color=SIMULATED, lw=2.4, label="least slope")
    lower.axhline(0, color=INK, lw=0.6)
    lower.set_ylim(min(0.0, 1.1 * float(slopes.min())), 1.25 * max(float(slopes.max()), 0.0))
    lower.set(xlabel=f"displacement ({unit})", ylabel="slope (V/µm)")
    lower.legend(loc="upper right")


def length_unit(length: float) -> tuple[float, str]:
    """Return the factor from metres, and the name, of the unit in which a length is written: µm, or nm below 1 µm."""
    return (1e9, "nm") if abs(length) < 1e-6 else (1e6, "µm")


def rising(trace: Trace) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return whether each sample lies on a rising branch (n,); a hold belongs to the branch before it."""
    # The simulated displacement moves in the direction of the voltage, and stands still with it.
    sign = np.sign(np.diff(trace.simulated, prepend=trace.simulated[:1]))
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
    up: np.ndarray[Any, np.dtype[np.bool_]] = sign[last] >= 0
    return up


def points(ax: Axes, x: Array, y: Array, colour: str, *, of: int, label: str | None = None) -> None:
    """Draw points, the paler the more there are `of`; many become one image."""
    alpha = min(0.8, max(0.06, 35 / np.sqrt(max(of, 1))))
    style: dict[str, Any] = {"ls": "none", "marker": ".", "ms": 2.4, "mew": 0, "color": colour, "alpha": alpha}
    ax.plot(x, y, label=label, rasterized=of > _VECTOR_POINTS, **style)


def some_samples(size: int) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Pick samples at random but reproducibly: every k-th sample could be in step with the cycles."""
    some = np.ones(size, bool)
    if size > MOST_BRANCH_POINTS:
        some[:] = False
        some[np.random.default_rng(0).choice(size, MOST_BRANCH_POINTS, replace=False)] = True
    return some


def stems(ax: Axes, x: Array, height: Array, label: str) -> None:
    """Draw heights as stems, hollow where they are zero."""
    zero = height <= 0
    ax.vlines(x[~zero], 0, height[~zero], color=MEASURED, lw=1.2)
    ax.plot(x[~zero], height[~zero], ls="none", marker="o", ms=3.4, color=MEASURED)
    if zero.any():  # the layout fails on an empty line that is not clipped
        ax.plot(x[zero], height[zero], ls="none", marker="o", ms=3.4, mfc="white", mec=MEASURED, mew=0.8, clip_on=False)
    ax.set_ylabel(label)
    ax.set_ylim(0, 1.12 * float(height.max()) if height.any() else 1.0)


def thinned(time: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the vertices of a line through samples, fewer where they are dense, broken where samples are missing."""
    steps = np.diff(time)
    cuts = np.flatnonzero(steps > 3 * np.median(steps)) + 1 if steps.size else np.empty(0, np.intp)
    cell = np.column_stack([(z - z.min()) * (_CELLS / (float(np.ptp(z)) or 1.0)) for z in (x, y)]).round()
    keep = np.ones(x.size, bool)
    keep[1:] = np.any(np.diff(cell, axis=0) != 0, axis=1)
    keep[-1:] = keep[cuts] = keep[cuts - 1] = True
    # A NaN interrupts the line.
    where = np.cumsum(keep)[cuts - 1] if cuts.size else cuts
    return np.insert(x[keep], where, np.nan), np.insert(y[keep], where, np.nan)


def inline(name: str, draw: Callable[..., None], *drawn: object, rows: int = 1, height: float = 3.3) -> str:
    """Draw on `rows` axes, one above the other, and return SVG text for a page; `draw` gets the axes, then `drawn`."""
    return _inline(svg_file(name, lambda *axes: draw(*axes, *drawn), rows=rows, height=height))


def svg_file(
    name: str, draw: Callable[..., None], *, rows: int = 1, height: float = 3.3, creator: str | None = None
) -> str:
    """Draw on `rows` axes, one above the other, and return the text of an SVG file, which names its `creator`."""
    text = io.StringIO()
    with _figure(name, (_INCHES, height)) as figure:
        axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
        draw(*axes)
        figure.align_ylabels()
        figure.savefig(text, format="svg", dpi=_DPI, metadata={**dict.fromkeys(_NO_METADATA), "Creator": creator})
    return text.getvalue()


@contextmanager
def _figure(name: str, size: tuple[float, float]) -> Iterator[Figure]:
    """Yield an empty figure in the house style, whatever the user's settings are."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError.of("matplotlib", "report", "Drawing") from error
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        style: Any = {**_STYLE, "svg.hashsalt": name}
        matplotlib.rcParams.update(style)
        yield Figure(figsize=size, layout="constrained")


def _inline(svg: str) -> str:
    """Remove from an SVG file what a page cannot contain many times: prolog, size, and ids without a reference."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    head, rest = body.split(">", 1)
    head = re.sub(r'\s(width|height|version)="[^"]*"', "", head)
    return f"{head}>{rest}".strip()


def draw_transformer(upper: Axes, lower: Axes, tau: Transformer) -> None:
    """Draw tau(v) minus the straight line between its ends, its slope beneath."""
    upper.plot(tau.voltage, bend(tau), color=MEASURED, lw=1, marker="o", ms=2.6)
    upper.axhline(0, color=INK, lw=0.6)
    upper.set_ylabel("tau(v) less a straight line (V)")
    lower.stairs(tau.slopes, tau.voltage, baseline=None, color=MEASURED, lw=1)
    lower.axhline(1, color=INK, lw=0.6)
    lower.set_ylim(bottom=0)
    lower.set(xlabel="voltage (V)", ylabel="slope of tau (V/V)")


def draw_creep(ax: Axes, actuator: Actuator) -> None:
    """Draw the displacement after a sudden rise through all voltages, with the time constants marked."""
    time, share = step_response(actuator)
    branches = actuator.creep
    ax.plot(time, 100 * share, color=MEASURED, lw=1.2)
    ax.set(xscale="log", xlabel="time since the rise (s)", ylabel="further displacement (% of the rise)")
    ax.set_ylim(bottom=0, top=max(1.25 * 100 * float(share.max()), 1e-9))
    if branches is not None:
        for k, constant in enumerate(branches.time_constants[branches.stiffness > 0]):
            ax.axvline(constant, color=SIMULATED, lw=0.6, ls=":", label=None if k else "time constants")
    ax.set_xlim(time[0], time[-1])
    ax.legend(loc="upper left")


def draw_graded(ax: Axes, slip: GradedSlip) -> None:
    """Draw stiffness times breakaway elongation of each element over the position of its cart; darker is more."""
    factor, unit = length_unit(float(np.ptp(slip.knots)))
    edges = np.concatenate([[0.0], slip.breakaway]) * factor
    held = slip.stiffness * slip.breakaway[:, None]
    shades = ax.pcolormesh(slip.knots * factor, edges, held, cmap="Blues", lw=0, rasterized=True)
    ax.set(xlabel=f"position of the cart ({unit})", ylabel=f"breakaway elongation ({unit})")
    ax.grid(visible=False)
    bar: Any = ax.figure.colorbar(shades, ax=ax, pad=0.02)
    bar.set_label("stiffness times breakaway elongation (V)")
    bar.outline.set_linewidth(0.6)


def draw_slopes(ax: Axes, slip: GradedSlip | MaxwellSlip, spring: Spring) -> None:
    """Draw the slope of slow motion: just after a turn, and when every element slides."""
    steepness = Slopes.of(slip, spring)
    factor, unit = length_unit(float(np.ptp(steepness.displacement)))
    # Those of plain elements are equal.
    dashes = "--" if np.array_equal(steepness.rising, steepness.falling) else "-"
    for values, colour, label, style in (
        (steepness.turned, INK, "just after a turn", "-"),
        (steepness.rising, RISING, "rising", "-"),
        (steepness.falling, FALLING, "falling", dashes),
    ):
        ax.plot(steepness.displacement * factor, values * 1e-6, color=colour, lw=1, ls=style, label=label)
    ax.set(xlabel=f"displacement ({unit})", ylabel="slope of the voltage (V/µm)")
    ax.set_ylim(0, 1.3 * float(steepness.turned.max()) * 1e-6)
    ax.legend(loc="upper left", ncols=3)


def draw_smooth(ax: Axes, elements: SmoothSlip) -> None:
    """Draw the largest voltage that each smooth element holds, over its length."""
    factor, unit = length_unit(float(elements.length.max()))
    held, length = elements.stiffness * elements.length, elements.length * factor
    dahl = elements.closing > 0.75
    for kind, colour, aside, label in (
        (~dahl, MEASURED, -1, "back on a straight line"),
        (dahl, SIMULATED, 1, "back on a curve (Dahl)"),
    ):
        if kind.any():
            x = length[kind] + 0.008 * aside * length.max()
            ax.vlines(x, 0, held[kind], color=colour, lw=1.2)
            ax.plot(x, held[kind], ls="none", marker="o", ms=4, color=colour, label=label)
    ax.set(xlabel=f"length ({unit})", ylabel="holds at most (V)")
    ax.set_xlim(0, 1.08 * float(length.max()))
    ax.set_ylim(0, 1.3 * float(held.max()) if held.any() else 1.0)
    ax.legend(loc="upper left")
