"""Numbers of things in sentences."""

from __future__ import annotations


def counted(number: int, thing: str) -> str:
    """Write a number and the thing, in the plural unless it is one: "1 sample", "2 samples"."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
