"""The order of sessions: numbers by value, in text as well."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

_NUMBER = re.compile(r"[+-]?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?")
_DIGITS = re.compile(r"([0-9]+)")


@dataclass(frozen=True)
class Order:
    """An order of the values of a key: its `name`, and the `key` by which to sort."""

    name: str
    key: Callable[[Any], Any]

    @classmethod
    def of(cls, values: Iterable[Any]) -> Order:
        """Return the order of numbers if all values are, else that of text: 2 is before 10, 2026-02 before 2026-10."""
        if all(_NUMBER.fullmatch(str(value)) for value in values):
            return cls("numbers by value", lambda value: Decimal(str(value)))
        return cls("text, the numbers in it by value", _pieces)


def _pieces(value: Any) -> list[str | int]:
    # Text and digits take turns, so that only like is compared with like.
    return [int(piece) if k % 2 else piece for k, piece in enumerate(_DIGITS.split(str(value)))]
