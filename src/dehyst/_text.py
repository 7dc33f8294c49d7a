"""Text of others in a line of ours: what a terminal or a page would obey, or not show, is written as an escape."""

from __future__ import annotations

import unicodedata


def escaped(text: object) -> str:
    r"""Return the text with control characters, line ends, marks of direction and lone surrogates as \x1b, \n, \u202e.

    Printable text, in any script, stays as it is; so does what was escaped before.
    """
    said = str(text)
    # Spaces other than ' ' count as not printable, and do no harm.
    return said if said.isprintable() else "".join(map(_escape, said))


def _escape(one: str) -> str:
    if one.isprintable() or unicodedata.category(one) == "Zs":
        return one
    return one.encode("unicode_escape").decode("ascii")


def counted(number: int, thing: str) -> str:
    """Write a number and the thing, in the plural unless it is one: "1 sample", "2 samples"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
