"""Parts of a self-contained HTML page: sections, tables, and numbers as text."""

from __future__ import annotations

import base64
import hashlib
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from dehyst._io import GENERATOR
from dehyst._text import escape
from dehyst.report.charts import Chart, ChartData
from dehyst.web import files

Row: TypeAlias = "Sequence[str | tuple[str, str]]"

MINUS = "\N{MINUS SIGN}"
# The policy forbids all requests of the browser, also for a name or a sentence that contains HTML.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


@dataclass(frozen=True, eq=False)
class Charts:
    """A section of charts side by side, or below one another if `wide`, under a heading and a caption.

    `beside`: HTML next to the charts.
    """

    title: str
    caption: str
    charts: Sequence[Chart]
    wide: bool = False
    beside: tuple[str, ...] = ()

    def html(self, data: ChartData) -> str:
        """Return the section, and add its charts to the page's data; empty without charts."""
        if not self.charts:
            return ""
        places = [f'<div data-chart="{data.add(chart)}"></div>' for chart in self.charts]
        body, heading = "\n".join([*places, *self.beside]), f"<h2>{self.title}</h2>\n" if self.title else ""
        return (
            f'{heading}<section>\n<p class="caption">{escape(self.caption)}</p>\n'
            f'<div class="figures{" one" if self.wide else ""}">\n{body}\n</div>\n</section>'
        )


Part: TypeAlias = str | Charts


def document(title: str, parts: Iterable[Part]) -> str:
    """Assemble parts to a self-contained page; a longer page gets a table of contents."""
    data, shown = ChartData(), [part for part in parts if part]
    body = "\n".join(part if isinstance(part, str) else part.html(data) for part in shown)
    policy, script = _POLICY, ""
    if data:
        source = files.script("report.js")
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        # The one script that may run is named by its hash.
        policy = f"{_POLICY}; script-src 'sha256-{digest}'"
        script = (
            f'<script type="application/json" id="chart-data">{data.json()}</script>\n'
            f'<script type="module">{source}</script>\n'
            '<noscript><p class="muted">A script inside this page draws the charts; scripts are switched off.</p>'
            "</noscript>\n"
        )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f'<meta name="generator" content="{GENERATOR}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n'
        f"<title>{escape(title)}</title>\n<style>{files.text('style.css')}{files.text('report.css')}</style>\n</head>\n"
        f"<body>\n<main>\n{body}\n</main>\n{script}</body>\n</html>\n"
    )


def number(value: float) -> str:
    """Return `value` as text with three significant digits, without an exponent if possible; rounding is 0."""
    if not math.isfinite(value):
        return "not known"
    if not round(value, 12):
        return "0"
    size = math.floor(math.log10(abs(value)))
    text = f"{value:.{max(0, 2 - size)}f}" if -4 <= size <= 5 else f"{value:.2e}"
    return text.replace("-", MINUS)


def length_unit(length: float) -> tuple[float, str]:
    """Return the factor from metres to the unit of a written length, and the unit: µm, or nm below 1 µm."""
    return (1e9, "nm") if abs(length) < 1e-6 else (1e6, "µm")


def length(metres: float) -> str:
    """Write a length in µm, or in nm below 1 µm."""
    factor, unit = length_unit(metres)
    return f"{number(metres * factor)} {unit}"


def spelled(text: str) -> str:
    """Write um as µm and hyphens before digits as minus signs; the text is escaped afterwards."""
    return re.sub(r"(?<![\w.\-])-(?=\d)", MINUS, re.sub(r"(?<=\d |V/)um\b", "µm", text))


def words(text: str) -> str:
    """Return a sentence of the library as HTML."""
    return escape(spelled(text))


def bullets(title: str, items: Iterable[str], none: str = "") -> str:
    """Return a list of HTML under a heading; without items, the sentence `none`, or nothing."""
    body = "\n".join(f"<li>{item}</li>" for item in items)
    if not body and not none:
        return ""
    return f"<h2>{title}</h2>\n" + (f"<ul>\n{body}\n</ul>" if body else f'<p class="muted">{none}</p>')


def reproduction(command: str | None) -> str:
    """Return a section with the command line that made a page; empty if it is not known."""
    section = '<section class="command"><h2>How to reproduce</h2>\n<pre>{}</pre></section>'
    return section.format(escape(command)) if command else ""


def table(head: Row, rows: Iterable[Row], texts: int) -> str:
    """Return a table whose first `texts` columns are words; the second text of a cell is small, below the first."""

    def cells(tag: str, row: Row) -> str:
        written = []
        for i, cell in enumerate(row):
            first, second = (cell, "") if isinstance(cell, str) else cell
            small = f"<small>{escape(second)}</small>" if second else ""
            kind = ' class="text"' if i < texts else ""
            written.append(f"<{tag}{kind}>{escape(first)}{small}</{tag}>")
        return f"<tr>{''.join(written)}</tr>"

    body = "\n".join(cells("td", row) for row in rows)
    top = cells("th", head).replace("<th", '<th scope="col"')
    return f'<div class="wide" tabindex="0"><table>\n<thead>{top}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'
