"""Parts of a self-contained HTML page: style, tables, figures, numbers as text, and charts that its script draws."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import math
import re
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np

from dehyst._io import GENERATOR
from dehyst._text import escaped
from dehyst._types import Array
from dehyst.report.plots import inline, length_unit

# Names of colours in page.css, where each has a light and a dark form.
Colour: TypeAlias = Literal["measured", "simulated", "rising", "falling", "without", "ink"]
# Steps of a 16-bit column from its least to its largest value, and the code for a missing value.
_STEPS, _MISSING = 65534, 65535


@dataclass(frozen=True)
class Axis:
    """An axis: its quantity, the unit of its numbers if they have one, and its range if it is not that of the data."""

    quantity: str
    unit: str
    range: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what the script needs."""
        ends = {} if self.range is None else {"range": list(self.range)}
        label = f"{self.quantity} ({self.unit})" if self.unit else self.quantity
        return {"label": label, "unit": self.unit, **ends}


@dataclass(frozen=True, eq=False)
class Series:
    """A curve or a cloud of points: x and y (n,), in the units of the axes; NaN breaks a curve.

    `exact`: whether x needs more than 16 bits, as the time of a long record does. `names`: those of single points.
    """

    name: str
    x: Array
    y: Array
    colour: Colour
    kind: Literal["line", "points"] = "line"
    width: float = 1.4
    opacity: float = 1.0
    exact: bool = False
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart.

    Attributes
    ----------
    title, role : str
        Above it: a record, and what it is.
    label : str
        For readers that do not see it.
    x, y : Axis
    series : tuple of Series
    right : (factor, quantity, unit), optional
        A second axis at the right: numbers of y times the factor.
    shaded : sequence of (from, to)
        Parts of the abscissa.
    band : (low, high), optional
        Part of the ordinate.
    zero : bool
        Whether zero is marked.
    keys : tuple of str
        Words in the legend that belong to no series.
    """

    title: str
    role: str
    label: str
    x: Axis
    y: Axis
    series: tuple[Series, ...]
    right: tuple[float, str, str] | None = None
    shaded: Sequence[tuple[float, float]] = ()
    band: tuple[float, float] | None = None
    zero: bool = False
    keys: tuple[tuple[str, str], ...] = ()


@dataclass(eq=False)
class ChartData:
    """The charts of one page: columns that several charts share are stored once."""

    _columns: list[Mapping[str, Any]] = field(default_factory=list)
    _charts: list[Mapping[str, Any]] = field(default_factory=list)
    _places: dict[tuple[bytes, bool], int] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self._charts)

    def add(self, chart: Chart) -> int:
        """Store a chart, and return its number on the page."""
        stored: dict[str, Any] = {
            "x": chart.x.as_dict(),
            "y": chart.y.as_dict(),
            "series": [self._series(one) for one in chart.series],
        }
        if chart.right is not None:
            factor, quantity, unit = chart.right
            stored["y2"] = {"factor": factor, "label": f"{quantity} ({unit})", "unit": unit}
        if chart.shaded:
            stored["shaded"] = [list(ends) for ends in chart.shaded]
        if chart.band is not None:
            stored["band"] = list(chart.band)
        if chart.zero:
            stored["zero"] = True
        self._charts.append(stored)
        return len(self._charts) - 1

    def json(self) -> str:
        """Return all of it as JSON that can stand inside a page."""
        return in_page({"columns": self._columns, "charts": self._charts})

    def _series(self, one: Series) -> dict[str, Any]:
        stored = {
            "name": one.name,
            "x": self._column(one.x, one.exact),
            "y": self._column(one.y, False),
            "colour": one.colour,
            "kind": one.kind,
            "width": one.width,
            "opacity": one.opacity,
        }
        return stored | ({"names": list(one.names)} if one.names else {})

    def _column(self, values: Array, exact: bool) -> int:
        key = (np.ascontiguousarray(values, dtype=np.float64).tobytes(), exact)
        if key not in self._places:
            self._places[key] = len(self._columns)
            self._columns.append(_stored(np.asarray(values, dtype=np.float64), exact))
        return self._places[key]


def in_page(data: Mapping[str, Any]) -> str:
    """Return data as JSON that can stand inside a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    # Nothing inside may end the element, whatever a name contains.
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _stored(values: Array, exact: bool) -> dict[str, Any]:
    """Return a column as base64: 32-bit floats, or 16-bit steps above its least value."""
    if exact:
        return {"floats": _base64(values.astype("<f4"))}
    good = np.isfinite(values)
    low, high = (float(values[good].min()), float(values[good].max())) if good.any() else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    codes = np.full(values.size, _MISSING, dtype="<u2")
    codes[good] = np.rint((values[good] - low) / step).astype("<u2")
    return {"low": low, "step": step, "steps": _base64(codes)}


def _base64(codes: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(codes.tobytes()).decode("ascii")


def legend(chart: Chart) -> list[tuple[str, str]]:
    """Return name and colour of each entry of a chart's legend: of series in one colour, the first."""
    colours: dict[str, str] = {}
    for name, colour in [*((one.name, one.colour) for one in chart.series), *chart.keys]:
        if name:
            colours.setdefault(colour, name)
    return [(name, colour) for colour, name in colours.items()]


Row: TypeAlias = "Sequence[str | tuple[str, str]]"

MINUS = "\N{MINUS SIGN}"
_FOLDER = Path(__file__).with_name("page")
_FEWEST_CONTENTS = 4
_IMPORT = re.compile(r"^import .*\n", re.MULTILINE)
# The policy forbids the browser any request, whatever a name or a sentence contains.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def escape(text: str, *, quote: bool = True) -> str:
    """Escape text for HTML: marks and control characters."""
    return html.escape(escaped(text), quote=quote)


@dataclass(frozen=True, eq=False)
class Charts:
    """A section of charts side by side, under a heading and a caption."""

    title: str
    caption: str
    charts: tuple[Chart, ...]
    wide: bool = False

    def html(self, data: ChartData) -> str:
        """Return the section, its charts stored in the page's data."""
        panels = [_chart_panel(chart, data.add(chart)) for chart in self.charts]
        return figure(self.title, self.caption, panels, wide=self.wide)


@dataclass(frozen=True, eq=False)
class Applet:
    """A section that computes by WebAssembly inside the page.

    Attributes
    ----------
    body : str
        HTML, with the heading.
    scripts : tuple of str
        JavaScript modules that become one: their imports of each other are taken out.
    style : str
        CSS.
    name : str
        The id of the element that holds the data.
    data : mapping
        JSON that the scripts read.
    """

    body: str
    scripts: tuple[str, ...]
    style: str
    name: str
    data: Mapping[str, Any]

    @property
    def source(self) -> str:
        """The one module."""
        return _IMPORT.sub("", "\n".join(self.scripts))


def document(title: str, parts: Iterable[str | Charts | Applet]) -> str:
    """Assemble parts to a page that loads nothing from outside; a longer one gets a list of contents."""
    data, shown = ChartData(), [part for part in parts if part]
    body = "\n".join(_html(part, data) for part in shown)
    applets = [part for part in shown if isinstance(part, Applet)]
    scripts = [*([asset("charts.js")] if data else []), *(one.source for one in applets)]
    policy, script = _POLICY, ""
    if scripts:
        # The scripts that may run are named by their hashes.
        allowed = [f"'sha256-{_digest(source)}'" for source in scripts] + ["'wasm-unsafe-eval'"] * bool(applets)
        policy = f"{_POLICY}; script-src {' '.join(allowed)}"
        script = "".join(
            [
                f"{_json_script('chart-data', data.json())}<script>{scripts[0]}</script>\n" if data else "",
                *(
                    f'{_json_script(one.name, in_page(one.data))}<script type="module">{one.source}</script>\n'
                    for one in applets
                ),
                '<noscript><p class="muted">The charts are drawn by a script inside this page; it is switched off.</p>'
                "</noscript>\n",
            ]
        )
    style = "".join([asset("page.css"), *(one.style for one in applets)])
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="generator" content="{GENERATOR}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>{style}</style>\n</head>\n<body>\n<main>\n"
        f"{_with_contents(body)}\n</main>\n{script}</body>\n</html>\n"
    )


def _html(part: str | Charts | Applet, data: ChartData) -> str:
    if isinstance(part, str):
        return part
    return part.html(data) if isinstance(part, Charts) else part.body


def _json_script(name: str, text: str) -> str:
    return f'<script type="application/json" id="{name}">{text}</script>\n'


def _digest(source: str) -> str:
    return base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()


@cache
def asset(name: str) -> str:
    """Return a file of the folder page."""
    return (_FOLDER / name).read_text(encoding="utf-8")


def _with_contents(body: str) -> str:
    """Give each heading an id, and list all of them before the first."""
    titles: list[str] = []

    def numbered(match: re.Match[str]) -> str:
        titles.append(match[1])
        return f'<h2 id="part-{len(titles)}">{match[1]}</h2>'

    body = re.sub(r"<h2>(.*?)</h2>", numbered, body)
    if len(titles) < _FEWEST_CONTENTS:
        return body
    links = "\n".join(f'<a href="#part-{i}">{title}</a>' for i, title in enumerate(titles, 1))
    return body.replace('<h2 id="part-1">', f'<nav aria-label="Contents">\n{links}\n</nav>\n<h2 id="part-1">', 1)


def number(value: float, digits: int = 3) -> str:
    """Write `value` with `digits` significant digits, as plainly as its size allows."""
    if not math.isfinite(value):
        return "not known"
    if value == 0:
        return "0"
    size = math.floor(math.log10(abs(value)))
    text = f"{value:.{max(0, digits - 1 - size)}f}" if -4 <= size <= 5 else f"{value:.{digits - 1}e}"
    return text.replace("-", MINUS)


def length(metres: float) -> str:
    """Write a length in µm, or in nm below 1 µm."""
    factor, unit = length_unit(metres)
    return f"{number(metres * factor)} {unit}"


def panel(
    title: str,
    name: str,
    draw: Callable[..., None],
    *drawn: object,
    role: str = "",
    label: str = "",
    rows: int = 1,
    height: float = 3.3,
) -> str:
    """Set a drawing under its title and role; `name`, `draw` and the others as in `plots.inline`."""
    svg = inline(name, draw, *drawn, rows=rows, height=height)
    image = svg.replace("<svg", f'<svg role="img" aria-label="{f"{label} {escape(title)}".strip()}"', 1)
    return f'<div class="panel"><h3>{escape(title)} <span>{escape(role)}</span></h3>\n{image}</div>'


def _chart_panel(chart: Chart, number: int) -> str:
    keys = "".join(
        f'<span><i style="background:var(--{colour})"></i>{escape(name)}</span>' for name, colour in legend(chart)
    )
    label = escape(f"{chart.label} {chart.title}".strip())
    heading = f"<h3>{escape(chart.title)} <span>{escape(chart.role)}</span></h3>" if chart.title else ""
    return (
        f'<div class="panel">{heading}\n'
        f'<p class="keys">{keys}</p>\n<canvas data-chart="{number}" tabindex="0" role="img" aria-label="{label}">'
        "</canvas>\n<button hidden>Whole range</button>\n<output></output></div>"
    )


def figure(title: str, caption: str, panels: Sequence[str], *, wide: bool = False) -> str:
    """Set panels side by side, or below one another if wide, under a heading and a caption; nothing without panels."""
    if not panels:
        return ""
    body, heading = "\n".join(panels), f"<h2>{title}</h2>\n" if title else ""
    return (
        f"{heading}<figure>\n<figcaption>{escape(caption)}</figcaption>\n"
        f'<div class="panels{" one" if wide else ""}">\n{body}\n</div>\n</figure>'
    )


def spelled(text: str) -> str:
    """Write um as µm and minus signs as such; the text is escaped afterwards."""
    return re.sub(r"(?<![\w.\-])-(?=\d)", MINUS, re.sub(r"(?<=\d |V/)um\b", "µm", text))


def bullets(title: str, items: Iterable[str]) -> str:
    """Set a list under a heading; nothing if there are no items."""
    body = "\n".join(f"<li>{item}</li>" for item in items)
    return f"<h2>{title}</h2>\n<ul>\n{body}\n</ul>" if body else ""


def folded(summary: str, tables: Mapping[str, str]) -> str:
    """Set tables by their headings behind a summary that opens them: one alone, or several side by side."""
    headed = ((f"<h3>{heading}</h3>\n" if heading else "", one) for heading, one in tables.items())
    body = "\n".join(f"<div>{heading}{one}</div>" for heading, one in headed)
    body = body if len(tables) == 1 and "" in tables else f'<div class="panels tables">\n{body}\n</div>'
    return f"<details>\n<summary>{summary}</summary>\n{body}\n</details>" if tables else ""


def reproduction(command: str | None) -> str:
    """Set the command line that made a page; nothing if it is not known."""
    return f"<h2>How to reproduce</h2>\n<pre>{escape(command)}</pre>" if command else ""


def table(head: Row, rows: Iterable[Row], texts: int, best: Container[tuple[int, int]] = ()) -> str:
    """Set a table whose first `texts` columns are words; the second text of a cell is set small beneath the first.

    `best` contains row and column of the cells to mark as such.
    """

    def cells(tag: str, row: Row, number: int = -1) -> str:
        written = []
        for i, cell in enumerate(row):
            first, second = (cell, "") if isinstance(cell, str) else cell
            small = f"<small>{escape(second)}</small>" if second else ""
            kind = ' class="text"' if i < texts else ' class="best"' if (number, i) in best else ""
            written.append(f"<{tag}{kind}>{escape(first)}{small}</{tag}>")
        return f"<tr>{''.join(written)}</tr>"

    body = "\n".join(cells("td", row, number) for number, row in enumerate(rows))
    return f'<div class="wide"><table>\n<thead>{cells("th", head)}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'
