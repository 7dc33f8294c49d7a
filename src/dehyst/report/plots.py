"""Figures for print in the house style, and `plot` methods on matplotlib's axes."""

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

from dehyst._errors import MissingExtraError, ModelError, RecordError
from dehyst._io import write_atomically
from dehyst._text import escaped
from dehyst._types import Array
from dehyst._validation import choice
from dehyst.records import Record
from dehyst.report.charts import Chart, Series, vertices
from dehyst.report.pictures import KINDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colours by Okabe and Ito for measured and simulated, by Tol for branches: distinct in any colour vision, and in grey.
MEASURED, SIMULATED, FALLING, INK = "#0072B2", "#D55E00", "#332288", "#333333"
_COLOURS = {
    "measured": MEASURED,
    "simulated": SIMULATED,
    "rising": "#44AA99",
    "falling": FALLING,
    "without": "#8A8A8A",
    "ink": INK,
    "tested": "#CFE6D8",
}
# Width of a journal's column and page [in], and least resolution of a line drawing with greys [dots/in].
COLUMN, PAGE = 3.4, 7.0
_JOURNAL_DPI = 600
# More points than the first number become one image in a figure: a vector takes 100 bytes a point. Most samples.
_VECTOR_POINTS, _MOST = 1500, 20_000
# Points in print for each pixel of a page.
_POINTS = 0.75
# Metadata that would make each SVG file different.
_NO_METADATA = ("Creator", "Date", "Format", "Type")
_STYLE: dict[str, Any] = {
    "svg.fonttype": "none",
    "font.size": 8.5,
    "axes.labelsize": 8.5,
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize", "legend.fontsize"), 8),
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.borderaxespad": 0.3,
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    "axes.linewidth": 0.6,
    **dict.fromkeys(("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("xtick.major.width", "ytick.major.width"), 0.6),
    **dict.fromkeys(("xtick.major.size", "ytick.major.size"), 3),
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#ECECEC",
    "grid.linewidth": 0.5,
    "axes.formatter.useoffset": False,
    "agg.path.chunksize": 20_000,
}


@dataclass(frozen=True)
class Drawing:
    """A finished figure: an SVG file, SVG for a page, and a PNG file."""

    svg: str
    inline: str
    png: bytes

    def save(self, path: str | PathLike[str]) -> list[Path]:
        """Write path.svg and path.png, each completely or not at all; raise FileFormatError if that is impossible."""
        svg, png = (Path(f"{path}{suffix}") for suffix in (".svg", ".png"))
        write_atomically(svg, self.svg)
        write_atomically(png, self.png)
        return [svg, png]


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

    `name` makes the ids inside the SVG unique on a page; `draw` gets rows x columns axes, row by row; `size` is width
    and height [in], of a journal `COLUMN` or `PAGE` wide. With `share`, axes in a column share the abscissa, and axes
    in a row the ordinate; `heights`: relative heights of the rows. Raise `MissingExtraError` if matplotlib is not
    installed.
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
    """Draw a line through many samples with only the vertices that are visible in print."""
    at = vertices(x / (np.ptp(x) or 1.0), y / (np.ptp(y) or 1.0), _MOST)
    ax.plot(x[at], y[at], **style)


@contextmanager
def _figure(name: str, size: tuple[float, float]) -> Iterator[Figure]:
    """Yield an empty figure in the house style, whatever the user's settings are."""
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError.of("matplotlib", "plot", "Drawing") from error
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


def _plain(name: str) -> str:
    """Return a name as plain text for matplotlib: no formula, no hidden label, and not too long."""
    text = escaped(name)
    text = text if len(text) <= 60 else f"{text[:57]}..."
    return f"{' ' if text.startswith('_') else ''}{text}".replace("$", r"\$")


def draw(found: object, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a picture of an object on the given axes, or on those of a new figure; see `Plotted`."""
    kinds = KINDS[type(found).__name__]
    name = next(iter(kinds)) if kind is None else kind
    choice(name, "kind", tuple(kinds), error=RecordError if isinstance(found, Record) else ModelError)
    chart = kinds[name](found)
    axes = _new_axes() if ax is None else ax
    _draw_chart(axes, chart)
    if isinstance(found, Record) and kind == "time":
        _voltage_behind(axes, found)
    if not axes.get_title():
        axes.set_title(_plain(chart.title))
    return axes


def _new_axes() -> Axes:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError.of("matplotlib", "plot", "Drawing") from error
    axes: Axes = pyplot.subplots(layout="constrained", subplot_kw={"axisbelow": True})[1]
    axes.grid(color="#ECECEC", lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _voltage_behind(ax: Axes, found: Record) -> None:
    """Draw the voltage behind the displacement, on a second axis."""
    right: Any = ax.twinx()
    right.plot(found.time, found.voltage, color="#999999", lw=0.9)
    right.set_ylabel("voltage (V)", color="#666666")
    right.grid(visible=False)
    right.spines["right"].set_visible(True)
    ax.yaxis.label.set_color(MEASURED)
    ax.set_zorder(right.get_zorder() + 1)
    ax.patch.set_visible(False)


def _draw_chart(ax: Axes, chart: Chart) -> None:
    """Draw a chart of a page on axes."""
    for ends in chart.shaded:
        ax.axvspan(*ends, color="#DCDCDC", lw=0)
    if chart.band is not None:
        ax.axhspan(*chart.band, color=MEASURED, alpha=0.12, lw=0)
    labels: set[str] = set()
    for series in chart.shown(_MOST).series:
        _draw_series(ax, series, "" if series.name in labels else series.name)
        labels.add(series.name)
    if chart.zero:
        ax.axhline(0, color=INK, lw=0.6)
    ax.set(xlabel=chart.x.label, ylabel=chart.y.label)
    for axis, scale, limits in ((chart.x, ax.set_xscale, ax.set_xlim), (chart.y, ax.set_yscale, ax.set_ylim)):
        if axis.log:
            scale("log")
        if axis.range is not None:
            limits(*axis.range)
    if chart.right is not None:
        factor, quantity, unit = chart.right
        there_and_back: Any = (lambda y: y * factor, lambda y: y / factor)
        right = ax.secondary_yaxis("right", functions=there_and_back)
        right.set_ylabel(f"{quantity} ({unit})")
    if len(labels - {""}) > 1:
        ax.legend(fontsize="small")


def _draw_series(ax: Axes, series: Series, label: str) -> None:
    style: dict[str, Any] = {"color": _COLOURS[series.colour], "alpha": series.opacity, "label": _plain(label) or None}
    if series.kind == "line":
        ax.plot(series.x, series.y, lw=series.width * _POINTS, ls="--" if series.dashed else "-", **style)
    elif series.kind == "points":
        marks: dict[str, Any] = {"marker": "o", "ms": series.width * _POINTS, "mew": 0.0}
        ax.plot(series.x, series.y, ls="none", rasterized=series.x.size > _VECTOR_POINTS, **marks, **style)
    elif series.top is not None:
        ax.fill_between(series.x, series.y, series.top, lw=0, **style)
    elif series.values is not None:
        ax.pcolormesh(series.x, series.y, series.values, cmap="Blues", vmax=series.darkest, lw=0, rasterized=True)
