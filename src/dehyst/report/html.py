"""Parts of a self-contained HTML page: style, tables, figures and numbers as text."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Sequence
from typing import TypeAlias

from dehyst._io.marks import GENERATOR
from dehyst._text import escaped
from dehyst.report.plots import length_unit

Row: TypeAlias = "Sequence[str | tuple[str, str]]"

MINUS = "\N{MINUS SIGN}"
STYLE = """
*{box-sizing:border-box}
body{margin:0 auto;max-width:1100px;padding:1.5rem 1.25rem 4rem;background:#fff;color:#222;line-height:1.5;
 font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif}
h1{font-size:1.7rem;line-height:1.25;margin:.2rem 0 .3rem;font-weight:600;overflow-wrap:anywhere}
h2{font-size:1.15rem;font-weight:600;margin:2.4rem 0 .6rem;padding-top:.6rem;border-top:1px solid #ddd}
h3{font-size:.92rem;font-weight:600;margin:0 0 .2rem;overflow-wrap:anywhere}
h3 span,.muted,td small{color:#666;font-weight:400}
.muted{margin:.3rem 0;font-size:.92rem}
.outcome{margin:1rem 0;padding:.8rem 1rem;border-left:6px solid;font-size:1.08rem}
.outcome strong{display:block;font-size:.85rem;letter-spacing:.04em;text-transform:uppercase}
.green{background:#eaf5ee;border-color:#1d7f46}.green strong{color:#14613a}
.amber{background:#fdf4dd;border-color:#c98a00}.amber strong{color:#7d5600}
.red{background:#fbe9e7;border-color:#b3261e}.red strong{color:#8c1d17}
.wide{overflow-x:auto}
table{border-collapse:collapse;font-size:.92rem;font-variant-numeric:tabular-nums}
th,td{padding:.3rem .9rem .3rem 0;text-align:right;vertical-align:top;border-bottom:1px solid #e5e5e5}
th{font-weight:600;border-bottom-color:#999;vertical-align:bottom}
th:last-child,td:last-child{padding-right:0}
td{white-space:nowrap}td small{display:block;font-size:.85em}
td.text,th.text{text-align:left;white-space:normal;overflow-wrap:anywhere;min-width:6rem}
ul{margin:.3rem 0;padding-left:1.2rem}li{margin:.25rem 0;overflow-wrap:anywhere}
figure{margin:1rem 0 1.6rem}
figcaption{font-size:.92rem;color:#444;margin-bottom:.8rem;max-width:60rem}
.panels{display:grid;grid-template-columns:repeat(auto-fill,minmax(min(100%,25rem),1fr));gap:1.2rem 1.6rem;
 align-items:end}
.tables{align-items:start}
.panel{min-width:0;break-inside:avoid}
svg{display:block;width:100%;height:auto;max-width:40rem}
svg text{font-family:system-ui,-apple-system,"Segoe UI",Roboto,"Helvetica Neue",Arial,sans-serif!important}
summary{cursor:pointer;color:#0a5a8f}
details{margin:.6rem 0}details>div{margin-top:.6rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.25rem 1.2rem;font-size:.92rem;margin:.6rem 0}
dt{color:#666}dd{margin:0;overflow-wrap:anywhere}
pre,code{font-family:ui-monospace,Menlo,Consolas,monospace;font-size:.85rem}
pre{background:#f5f5f5;padding:.7rem .9rem;white-space:pre-wrap;overflow-wrap:anywhere}
@media(max-width:40rem){dl{grid-template-columns:1fr;gap:0}dd{margin-bottom:.5rem}body{padding:1rem 1rem 3rem}}
@media print{body{max-width:none;padding:0;font-size:10pt}h2,figcaption{break-after:avoid;break-inside:avoid}
 .panels{grid-template-columns:1fr 1fr}.outcome{print-color-adjust:exact;-webkit-print-color-adjust:exact}}
"""
# The policy forbids the browser any request, whatever a name or a sentence contains.
POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def escape(text: str, *, quote: bool = True) -> str:
    """Escape text for HTML: marks and control characters."""
    return html.escape(escaped(text), quote=quote)


def document(title: str, parts: Iterable[str]) -> str:
    """Assemble parts to a page that loads nothing from outside."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f'<meta name="generator" content="{GENERATOR}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(part for part in parts if part)
        + "\n</main>\n</body>\n</html>\n"
    )


def number(value: float, digits: int = 3) -> str:
    """Write `value` with so many significant digits, as plainly as its size allows."""
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


def panel(title: tuple[str, str], svg: str, label: str) -> str:
    """Set one drawing under its record and role."""
    name, role = escape(title[0]), escape(title[1])
    image = svg.replace("<svg", f'<svg role="img" aria-label="{f"{label} {name}".strip()}"', 1)
    return f'<div class="panel"><h3>{name} <span>{role}</span></h3>\n{image}</div>'


def figure(title: str, caption: str, panels: Sequence[str]) -> str:
    """Set panels side by side under a heading and a caption; nothing if there are none."""
    if not panels:
        return ""
    body = "\n".join(panels)
    return (
        f"<h2>{title}</h2>\n<figure>\n<figcaption>{escape(caption)}</figcaption>\n"
        f'<div class="panels">\n{body}\n</div>\n</figure>'
    )


def bullets(title: str, items: Iterable[str]) -> str:
    """Set a list under a heading; nothing if there are no items."""
    body = "\n".join(f"<li>{item}</li>" for item in items)
    return f"<h2>{title}</h2>\n<ul>\n{body}\n</ul>" if body else ""


def reproduction(command: str | None) -> str:
    """Set the command line that made a page; nothing if it is not known."""
    return f"<h2>How to reproduce</h2>\n<pre>{escape(command)}</pre>" if command else ""


def table(head: Row, rows: Iterable[Row], texts: int) -> str:
    """Set a table whose first `texts` columns are words; the second text of a cell is set small beneath the first."""

    def cells(tag: str, row: Row) -> str:
        written = []
        for i, cell in enumerate(row):
            first, second = (cell, "") if isinstance(cell, str) else cell
            small = f"<small>{escape(second)}</small>" if second else ""
            kind = ' class="text"' if i < texts else ""
            written.append(f"<{tag}{kind}>{escape(first)}{small}</{tag}>")
        return f"<tr>{''.join(written)}</tr>"

    body = "\n".join(cells("td", row) for row in rows)
    return f'<div class="wide"><table>\n<thead>{cells("th", head)}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'
