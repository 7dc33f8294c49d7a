"""HTML of an object for a notebook: a few lines and tables, every text escaped, no script and no style sheet."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from dehyst._text import escaped

# Readable on the light and the dark background of a notebook.
_COLOURS = {"green": "#1d7f46", "amber": "#c98a00", "red": "#b3261e", "": "#888888"}
_MOST_ROWS = 50


def escape(text: object, *, quote: bool = True) -> str:
    """Escape text for HTML: marks and control characters."""
    return html.escape(escaped(text), quote=quote)


def block(title: str, *parts: str, colour: str = "") -> str:
    """Return parts under a title, with a coloured bar at their side: "green", "amber", "red", or no bar."""
    bar = f"border-left:4px solid {_COLOURS[colour]};padding:.2em 0 .2em .8em;margin:.3em 0"
    body = "\n".join(part for part in parts if part)
    return f'<div style="{bar}"><strong>{escape(title)}</strong>\n{body}</div>'


def line(text: object) -> str:
    """Return a sentence as a paragraph; empty text for an empty sentence."""
    return f'<p style="margin:.3em 0">{escape(text)}</p>' if text else ""


def facts(rows: Iterable[tuple[str, object]]) -> str:
    """Return names and values as a table of two columns."""
    body = "".join(
        f'<tr><td style="text-align:left">{escape(name)}</td><td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f"<table><tbody>{body}</tbody></table>"


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Return a table with a head: the first 50 rows, and the number of further rows."""
    top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows[:_MOST_ROWS])
    more = line(f"and {len(rows) - _MOST_ROWS} more") if len(rows) > _MOST_ROWS else ""
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>{more}"


def folded(title: str, sentences: Sequence[object]) -> str:
    """Return sentences as a list that opens with a click; empty text if there are none."""
    if not sentences:
        return ""
    items = "".join(f"<li>{escape(sentence)}</li>" for sentence in sentences)
    return f"<details><summary>{escape(title)} ({len(sentences)})</summary><ul>{items}</ul></details>"


def preformatted(title: str, lines: Iterable[str]) -> str:
    """Return preformatted lines that open with a click."""
    text = "\n".join(map(escape, lines))
    return f'<details><summary>{escape(title)}</summary><pre style="overflow-x:auto">{text}</pre></details>'
