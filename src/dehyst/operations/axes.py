"""What a model of one axis and one of several have in common: axes over which an operation loops."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar, NamedTuple, Self

from dehyst._errors import ModelError


class Limit(NamedTuple):
    """Voltages allowed [V] for an axis; for all without a name."""

    axis: str
    low: float
    high: float

    metavar: ClassVar[str] = "[AXIS=]LOW HIGH"  # type: ignore[misc]
    count: ClassVar[int] = 2  # type: ignore[misc]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the limits in a text; raise ValueError with what is needed."""
        axis, _, numbers = text.rpartition("=")
        try:
            low, high = map(float, numbers.split())
        except ValueError as error:
            raise ValueError(f"got {text!r}, need two voltages") from error
        return cls(axis, low, high)

    def __str__(self) -> str:
        """Return the text."""
        return f"{self.axis and f'{self.axis}='}{self.low:.12g} {self.high:.12g}"


class Slew(NamedTuple):
    """The largest slew rate [V/s] of an axis, None: not limited; of all without a name."""

    axis: str
    rate: float | None

    metavar: ClassVar[str] = "[AXIS=]V/S|none"  # type: ignore[misc]

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the slew rate in a text; raise ValueError with what is needed."""
        axis, _, number = text.rpartition("=")
        try:
            return cls(axis, None if number == "none" else float(number))
        except ValueError as error:
            raise ValueError(f"got {text!r}, need a number of V/s, or none") from error

    def __str__(self) -> str:
        """Return the text."""
        return f"{self.axis and f'{self.axis}='}{'none' if self.rate is None else f'{self.rate:.12g}'}"


def limits_of(axes: Sequence[str], given: Iterable[Limit]) -> list[tuple[float, float] | None]:
    """Return the limits [V] of each axis: its own, those of all, or None."""
    return [None if one is None else (one.low, one.high) for one in _by_axis(axes, given, "limits")]


def slews_of(axes: Sequence[str], given: Iterable[Slew]) -> list[Slew | None]:
    """Return the slew rate of each axis: its own, that of all, or None if none was given."""
    return _by_axis(axes, given, "slew_rate")


def _by_axis(axes: Sequence[str], given: Iterable[Any], name: str) -> list[Any]:
    found: dict[str, Any] = {}
    for one in given:
        if one.axis and one.axis not in axes:
            known = f"one of {', '.join(axes)}" if any(axes) else "none, as there is one axis"
            raise ModelError(argument=name, got=f"the axis {one.axis}", need=known)
        found[one.axis] = one
    return [found.get(axis, found.get("")) for axis in axes]
