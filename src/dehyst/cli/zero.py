"""The zero of displacements: the option that places it, and paths that lie outside of the reachable range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from dehyst.cli.start import Request
    from dehyst.model import Actuator
    from dehyst.records import Record

_NAMES = ("bottom", "first", "mean")
# Part of the reachable range by which a path may lie outside without a remark.
_ROUNDING = 1e-6


class _ZeroType(click.ParamType):  # type: ignore[type-arg]
    """The name of a place, or a displacement in micrometres."""

    name = "zero"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        return "|".join((*_NAMES, "UM"))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str | float:
        if value in _NAMES:
            return str(value)
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        if not abs(number) < float("inf"):
            self.fail(f"got {value!r}, need {', '.join(_NAMES)}, or a displacement in um", param, ctx)
        return number


def zero_option(words: str) -> Callable[..., Any]:
    """Return the option that places the zero of displacements."""
    return click.option("--zero", type=_ZeroType(), help=f"{words}  [default: the sensor's zero]")


def zeroed(records: list[Record], others: list[Record], zero: str | float | None) -> tuple[list[Record], list[Record]]:
    """Return records with displacements from a zero, which the first of them places for all."""
    if zero is None or not records:
        return records, others
    y = records[0].displacement
    place = (
        zero * 1e-6
        if isinstance(zero, float)
        else {"bottom": y.min(axis=0), "first": y[0], "mean": y.mean(axis=0)}[zero]
    )
    moved = [_moved(record, place) for record in (*records, *others)]
    return moved[: len(records)], moved[len(records) :]


def _moved(record: Record, place: Any) -> Record:
    import numpy as np

    places = ", ".join(f"{one * 1e6:.6g}" for one in np.atleast_1d(place).tolist())
    source = f"{record.meta.get('source', record.name)}, zero at {places} um"
    return replace(record, displacement=record.displacement - place, meta={**record.meta, "source": source})


def zero_of_path(request: Request, zero: str | float | None) -> float:
    """Return the displacement [m] of the model from which a path is counted."""
    from dehyst.control import Compensator, PossibleStart

    if zero is None or isinstance(zero, float):
        return (zero or 0.0) * 1e-6
    compensator = Compensator(request.actuator, request.limits)
    low, high = compensator.reach
    if zero == "first":
        rest = min(max(request.present or 0.0, compensator.limits[0]), compensator.limits[1])
        start = request.start or PossibleStart.unknown(request.actuator, rest, compensator.limits)
        return request.actuator.model.displacement(start.state, of_mass=False)
    return {"bottom": low, "mean": 0.5 * (low + high)}[zero]


def scan_from_zero(options: dict[str, Any], zero: float) -> dict[str, Any]:
    """Return the options of a scan with its displacements [um] counted from a zero [m] of the model."""
    if not zero:
        return options
    moved = {
        name: options[name] + zero * 1e6 for name in ("low", "high", "y_low", "y_high") if options[name] is not None
    }
    try:
        if options["levels"] is not None:
            moved["levels"] = ",".join(repr(float(level) + zero * 1e6) for level in options["levels"].split(","))
    except ValueError:
        # The scan refuses the levels with its own words.
        return options
    return {**options, **moved}


def refuse_astray(
    actuator: Actuator, wanted: Any, limits: tuple[float, float] | None, zero: str | float | None = None
) -> None:
    """Refuse a path more than one stroke outside the reachable range: its zero, unit or model is another one."""
    from dehyst._errors import ModelError
    from dehyst.control import Compensator

    compensator = Compensator(actuator, limits)
    if compensator.strays(wanted):
        low, high = compensator.reach
        advice = _advice(wanted, (low, high), zero)
        raise ModelError(
            f"got {1e6 * wanted.min():.6g} to {1e6 * wanted.max():.6g} um, the model "
            f"reaches {1e6 * low:.4g} to {1e6 * high:.4g} um, from the sensor's zero "
            "in its records",
            argument="displacement",
            hint=f"check the numbers and their unit{('' if advice is None else f', or {advice}')}",
        )


def outside_reach(
    actuator: Actuator, wanted: Any, limits: tuple[float, float] | None, zero: str | float | None = None
) -> list[str]:
    """Return a warning if a path lies outside of the reachable range, with that range and what to try."""
    import numpy as np

    from dehyst.control import Compensator

    if not wanted.size:
        return []
    compensator = Compensator(actuator, limits)
    low, high = compensator.reach
    margin = _ROUNDING * (high - low)
    if low - margin <= wanted.min() and wanted.max() <= high + margin:
        return []
    fits = float(np.ptp(wanted)) <= high - low
    another = "choose another --zero, or none" if zero is not None and fits else "choose a smaller path"
    advice = _advice(wanted, (low, high), zero) or another
    volts = "{:.5g} to {:.5g} V".format(*compensator.limits)
    return [
        f"the path covers {1e6 * wanted.min():.6g} to {1e6 * wanted.max():.6g} um, the model reaches "
        f"{1e6 * low:.4g} to {1e6 * high:.4g} um with {volts}, from the sensor's zero in its records; {advice}"
    ]


def _advice(wanted: Any, reach: tuple[float, float], zero: str | float | None) -> str | None:
    """Return which zero brings a path into the reachable range; None if none does."""
    (low, high), least, most = reach, float(wanted.min()), float(wanted.max())
    if zero is not None or most - least > high - low:
        return None
    if least >= 0 and most <= high - low:
        return "--zero bottom counts the path from the bottom of this range"
    if max(-least, most) <= 0.5 * (high - low):
        return "--zero mean counts the path from the middle of this range"
    place = 0.5 * (low + high - least - most)
    return f"--zero {place * 1e6:.4g} puts the path into the middle of this range"
