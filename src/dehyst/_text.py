"""Text of messages: foreign text with control characters escaped, counts, and short lists."""

from __future__ import annotations

import html
import unicodedata
from collections.abc import Iterator, Sequence

# Sentences of a list that are shown without asking for all.
_SHOWN = 3


def escaped(text: object) -> str:
    r"""Return the text with control characters, line ends, marks of direction and lone surrogates as \x1b, \n, \u202e.

    Printable text, in any script, does not change, nor does text that is escaped already.
    """
    string = str(text)
    if string.isprintable():
        return string
    # Spaces other than ' ' count as not printable, but are harmless.
    return "".join(
        c if c.isprintable() or unicodedata.category(c) == "Zs" else c.encode("unicode_escape").decode("ascii")
        for c in string
    )


def escape(text: object, *, quote: bool = True) -> str:
    """Escape text for HTML: marks and control characters."""
    return html.escape(escaped(text), quote=quote)


def to_know(sentences: Sequence[str]) -> Iterator[str]:
    """Yield an empty line, the first three sentences as a list, and the number of further ones."""
    if sentences:
        yield ""
    yield from (f"  - {sentence}" for sentence in sentences[:_SHOWN])
    if len(sentences) > _SHOWN:
        yield f"  - {counted(len(sentences) - _SHOWN, 'more remark')}."


def digits(number: float, count: int = 2) -> str:
    """Write a number with `count` digits, without a power of ten from 0.0001 to a million: "110", not "1.1e+02"."""
    return f"{float(f'{number:.{count}g}'):g}"


def counted(number: int, noun: str) -> str:
    """Write a number and a noun, in the plural unless the number is 1: "1 sample", "2 samples"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
