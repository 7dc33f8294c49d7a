"""Text of messages: escapes for text of others, counts, and digits."""

from __future__ import annotations

import html
import unicodedata

# Most digits of a written number.
_MOST = 9


def escaped(text: object) -> str:
    r"""Return the text with escapes (\x1b, \u202e) for control characters, marks of direction and lone surrogates.

    Printable text in any script does not change, and neither does text with escapes.
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


def digits(number: float, count: int = 2, *unlike: float) -> str:
    """Write a number with `count` digits, or more if `unlike` numbers would look equal, without power of ten: "110"."""
    while count < _MOST and f"{number:.{count - 1}e}" in [f"{x:.{count - 1}e}" for x in unlike if x != number]:
        count += 1
    return f"{float(f'{number:.{count}g}'):.{max(count, 6)}g}"


def counted(number: int, noun: str) -> str:
    """Write a number and a noun, in the plural unless the number is 1: "1 sample", "2 samples"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
