"""Foreign text in messages: control and invisible characters are escaped."""

from __future__ import annotations

import unicodedata


def escaped(text: object) -> str:
    r"""Return the text with control characters, line ends, marks of direction and lone surrogates as \x1b, \n, \u202e.

    Printable text, in any script, does not change, nor does text that is escaped already.
    """
    string = str(text)
    # Spaces other than ' ' count as not printable, but are harmless.
    return string if string.isprintable() else "".join(map(_escape, string))


def _escape(character: str) -> str:
    if character.isprintable() or unicodedata.category(character) == "Zs":
        return character
    return character.encode("unicode_escape").decode("ascii")


def counted(number: int, noun: str) -> str:
    """Write a number and a noun, in the plural unless the number is 1: "1 sample", "2 samples"."""
    return f"{number} {noun}{'' if number == 1 else 's'}"
