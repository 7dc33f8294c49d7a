"""The choice of the columns of a record: all problems at once, and options that would solve them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import permutations
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst.records.formats.columns import EXAMPLES, UNITS, Column, ColumnError, Table, listed
from dehyst.records.formats.units import plausible_unit, quantity_of, scale_of

_PARTS = {
    "time": ("time", "zeit", "second", "temps"),
    "voltage": ("volt", "spannung", "drive", "ampl", "monitor", "command", "tension", "ao"),
    "displacement": ("disp", "pos", "weg", "auslenk", "sensor", "gauge", "strain", "stroke", "capac", "ai", "height"),
}
# Columns of a file that are compared with one another.
_MOST = 12
_LETTERS = {"time": "t", "voltage": "uv", "displacement": "yxzdw"}


class ColumnsError(FileFormatError):
    """Columns of a record that are not found, with the options of `read` that may select them.

    `reason`: the message without `options`, which are to be checked by the user.
    """

    def __init__(self, reason: str, options: Mapping[str, str]) -> None:
        given = [f'{name}="{value}"' for name, value in options.items()]
        contained = all(option in reason for option in given)
        stop = "" if reason.endswith(".") else "."
        advice = "" if contained else f"{stop} Try {', '.join(given)}; check units and scales."
        super().__init__(f"{reason}{advice}")
        self.reason, self.options = reason, dict(options)


class Choice(NamedTuple):
    """What selects the columns of a record: names, and scales."""

    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    voltage_scale: str | None = None
    displacement_scale: str | None = None

    def scale(self, quantity: str) -> str | None:
        """Return the scale of a quantity."""
        scales = {"voltage": self.voltage_scale, "displacement": self.displacement_scale}
        return scales.get(quantity)


def chosen(table: Table, choice: Choice, quantities: tuple[str, ...]) -> dict[str, Array]:
    """Return the columns of quantities in SI units.

    Raises
    ------
    ColumnsError
        Some of them cannot be read: all problems, and options that would solve them.
    """
    found: dict[str, Array] = {}
    problems: list[ColumnError] = []
    for quantity in quantities:
        try:
            found[quantity] = table.column(quantity, getattr(choice, quantity), choice.scale(quantity))
        except ColumnError as error:
            problems.append(error)
    if problems:
        raise ColumnsError(_reason(table, problems), _options(table, choice, [*found], problems))
    return found


def _reason(table: Table, problems: list[ColumnError]) -> str:
    if len({error.problem for error in problems}) == 1:
        return f"{table.source}: {problems[0].problem}{problems[0].advice}"
    asked = ", ".join(f'{error.quantity}="NAME"' for error in problems)
    names = ", ".join(f"'{EXAMPLES[error.quantity]}'" for error in problems)
    rate = " Without a time column, give sample_rate= in Hz." if any(e.quantity == "time" for e in problems) else ""
    faults = "; ".join(error.problem + error.hint for error in problems)
    return (
        f"{table.source}: {faults}; the file holds {listed(table.names)}. Select them with {asked}. Names like {names} "
        f"are found by themselves.{rate}"
    )


def _options(table: Table, choice: Choice, found: list[str], problems: list[ColumnError]) -> dict[str, str]:
    """Return options that select columns of a plausible range; none if there is no column for a quantity."""
    wanted = [error.quantity for error in problems]
    taken = {table.find(quantity, getattr(choice, quantity))[0].name for quantity in found}
    free = [column for column in table.columns if not column.fault and column.name not in taken]
    used = {error.quantity: error.column for error in problems if error.column and not error.column.fault}
    used |= _assigned([c for c in free if c not in used.values()], [q for q in wanted if q not in used])
    if any(column.unnamed for column in free) and len(used) == len(wanted):
        return {"columns": ",".join(_entry(column, used) for column in table.columns)}
    if any(_refuses(choice.scale(quantity), quantity, column) for quantity, column in used.items()):
        # No name mends a scale that is wrong.
        return {}
    options: dict[str, str] = {}
    for quantity in wanted:
        if quantity in used:
            options |= _option(quantity, used[quantity], choice.scale(quantity))
    return options


def _assigned(free: list[Column], wanted: list[str]) -> dict[str, Column]:
    """Return the most likely column for each quantity; the first that rises is a time, and no other quantity does."""
    used: dict[str, Column] = {}
    if "time" in wanted and (rising := [column for column in free if _rises(column)]):
        used["time"] = min(rising, key=lambda column: _unlikeliness(column, "time"))
    rest = [column for column in free if column is not used.get("time") and not _rises(column)][:_MOST]
    others = [quantity for quantity in ("voltage", "displacement") if quantity in wanted]
    ways = [dict(zip(others, way, strict=True)) for way in permutations(rest, len(others))]
    best = min(ways, key=lambda way: sum(_unlikeliness(c, q) for q, c in way.items()), default={})
    return used | best


def _unlikeliness(column: Column, quantity: str) -> int:
    """Return how little the name and the unit of a column are those of a quantity."""
    word, unit = column.parts
    stated = quantity_of(unit)
    lower = f"{word} {column.leaf}".lower()
    named = any(part in lower for part in _PARTS[quantity]) or (len(word) == 1 and word.lower() in _LETTERS[quantity])
    other = any(part in lower for kind, parts in _PARTS.items() if kind != quantity for part in parts)
    sensor = quantity == "displacement" and stated == "voltage"
    return (0 if stated == quantity else 1 if not stated or sensor else 4) - 2 * named + other


def _rises(column: Column) -> bool:
    return bool(column.data.size > 1 and np.all(column.data[1:] > column.data[:-1]))


def _option(quantity: str, column: Column, scale: str | None) -> dict[str, str]:
    name, stated = column.name, column.parts[1]
    if stated in UNITS[quantity] or scale is not None:
        monitor = quantity == "voltage" and scale is None and "monitor" in name.lower()
        return {quantity: name} | ({"voltage_scale": "100 V/V"} if monitor else {})
    if quantity == "displacement" and quantity_of(stated) == "voltage":
        return {quantity: name, "displacement_scale": f"10 um/{stated}"}
    if quantity_of(stated):
        return {}
    unit = plausible_unit(quantity, column.data)
    return {quantity: f"{name}:{unit}"} if unit else {}


def _refuses(scale: str | None, quantity: str, column: Column) -> bool:
    """Return whether a scale contradicts the unit that the file states for a column."""
    stated = column.parts[1]
    return scale is not None and bool(stated) and bool(scale_of(quantity, scale).refusal(stated))


def _entry(column: Column, used: Mapping[str, Column]) -> str:
    quantity = next((quantity for quantity, other in used.items() if other.name == column.name), "")
    unit = plausible_unit(quantity, column.data) if quantity else ""
    return f"{quantity}:{unit}" if unit else "-"
