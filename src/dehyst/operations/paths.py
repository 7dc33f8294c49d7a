"""A path: its zero, its slew rate, its temperature, and whether it can be reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

import dehyst._validation as check
from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import Compensator, PossibleStart
from dehyst.model import Actuator, demand_thermal, temperature_cost
from dehyst.model.states import state_at
from dehyst.operations.axes import AxesModel, Slew
from dehyst.operations.files import Columns
from dehyst.operations.start import Limits
from dehyst.records.formats.columns import Table
from dehyst.trust import Judgement

# Part of the reachable range by which a path may lie outside without a remark.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Zero:
    """The displacement that counts as zero: a name, or micrometres of the sensor."""

    name: str
    um: float = 0.0

    metavar: ClassVar[str] = "bottom|first|mean|UM"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the zero in a text; raise ValueError that says what is needed."""
        if text in ("bottom", "first", "mean"):
            return cls(text)
        try:
            number = float(text)
        except ValueError:
            number = np.nan
        if not np.isfinite(number):
            raise ValueError(f"got {text!r}, need bottom, first, mean, or a displacement in um")
        return cls("", number)

    def __str__(self) -> str:
        """Return the text."""
        return self.name or f"{self.um:.12g}"


class PathSlew(NamedTuple):
    """The largest slew rate [V/s] of a path (None: not limited) and its origin."""

    bound: float | None
    origin: str

    @classmethod
    def chosen(cls, actuator: Actuator, given: Slew | None) -> PathSlew:
        """Return the given slew rate, or the default of a path: the speed of the model's records."""
        if given is not None:
            return cls(given.rate, "none" if given.rate is None else "option")
        return cls(actuator.recorded_slew_rate, "unknown" if actuator.recorded_slew_rate is None else "records")

    def of_path(self, *, timed: bool) -> PathSlew:
        """Return the slew rate of a path; without time there is no default."""
        return self if timed or self.origin != "records" else PathSlew(None, "no time")

    @property
    def words(self) -> str:
        """The slew rate and its origin as text."""
        bound = "" if self.bound is None else f"at most {self.bound:.4g} V/s"
        words = {
            "option": bound,
            "records": f"{bound}, the speed of the model's records and a margin of 5 % (--slew-rate changes it)",
            "none": "not limited",
            "unknown": "not limited: this model does not know the speed of its records; give --slew-rate",
            "no time": "not limited: the path has no time",
        }
        return f"slew rate: {words[self.origin]}"

    def missed_words(self, limits: tuple[float, float], voltage: Array, missed: float) -> str:
        """Return as text why, and by how much [m], a path is missed with its clamped voltages (n,) [V]."""
        at_limit = voltage.min() <= limits[0] or voltage.max() >= limits[1]
        reasons = (at_limit and "cut at the limits", self.bound is not None and "held back by the slew rate")
        return f", {' or '.join(one for one in reasons if one)}: missed by up to {missed * 1e6:.4g} um"

    def fields(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"slew_V_per_s": self.bound, "slew_from": self.origin}

    def remarks(
        self, actuator: Actuator, limits: tuple[float, float], wanted: Array, time: Array | None, **rates: Any
    ) -> list[str]:
        """Return a remark if a path (n,) [m] needs more than this slew rate, or than the speed of the records."""
        recorded = actuator.recorded_slew_rate
        if (recorded is None and self.bound is None) or time is None or len(wanted) < 2:
            return []
        state = state_at(actuator, actuator.state, float(wanted[0]))
        motion = actuator.compensate(wanted, time=time, **rates, state=state, extrapolate=True)
        needed = float(np.abs(np.diff(np.clip(motion.voltage, *limits)) / np.diff(time)).max())
        held = self.bound is not None and needed > self.bound
        words = f"the path needs up to {needed:.4g} V/s"
        if recorded is not None and needed > recorded:
            margin = f"with a margin of 5 % ({recorded:.4g} V/s)"
            words += f", {needed / recorded:.3g} times the speed of the model's records {margin}"
        elif not held:
            return []
        if held and self.origin == "option":
            words += f": held back to the {self.bound:.4g} V/s of --slew-rate"
        elif held:
            words += ": held back; --slew-rate V/S sets another bound, --slew-rate none removes it"
        return [words]


@dataclass(frozen=True)
class PathTemperature:
    """The temperature of a path [degC]: one number, one a sample (n,), or None if it is not known."""

    values: float | Array | None = None

    @classmethod
    def of(
        cls, known: AxesModel, constant: float | None, columns: Columns, table: Table | None = None, samples: int = 0
    ) -> PathTemperature:
        """Return the given `constant`, or the temperatures in the `table` of a path with a number of `samples`."""
        if known.stage is not None:
            if constant is not None or columns.temperature is not None:
                raise ModelError(argument="temperature", got="it with several axes", need="a model of one axis")
            return cls()
        if constant is not None and columns.temperature is not None:
            raise ModelError(argument="temperature", got="a column and a constant one", hint="leave one out")
        if constant is not None or columns.temperature is not None:
            demand_thermal(known.actuators[0].thermal)
        if constant is None:
            return cls(None if table is None else columns.warmth(table, samples))
        return cls(check.number(constant, "temperature"))

    def used_by(self, actuator: Actuator) -> dict[str, Any]:
        """Return the argument `temperature` of a calculation with an actuator, if that depends on it."""
        return {} if actuator.thermal is None or self.values is None else {"temperature": self.values}

    def at_reference(self, actuator: Actuator, displacement: Array) -> Array:
        """Return the displacement (n,) [m] of a path at the reference temperature of its actuator."""
        if actuator.thermal is None or self.values is None:
            return displacement
        return actuator.thermal.at_reference(displacement, self.values)

    def column(self, actuator: Actuator, samples: int, before: int = 0) -> dict[str, Array]:
        """Return the column of a file of `samples`, of which the first `before` come before the path."""
        if not self.used_by(actuator):
            return {}
        along = np.broadcast_to(np.asarray(self.values, dtype=np.float64), samples - before)
        return {"temperature_C": np.concatenate([np.full(before, along[0]), along])}

    def cost(self, actuator: Actuator) -> tuple[float, str]:
        """Return what this temperature adds to the error of any path [m], and a sentence on it."""
        known = actuator.identification
        tested = None if known is None or known.validity is None else known.validity.temperatures
        stroke = float(np.ptp(actuator.reach))
        cost, sentence = temperature_cost(actuator.thermal, tested, stroke, self.values)
        return float(cost.max(initial=0.0)), sentence


def promise_lines(actuator: Actuator, judged: Judgement, temperature: PathTemperature) -> list[str]:
    """Return lines on the promised error of a path, if it is known, and on what the records do not test."""
    lines, known = judged.lines(actuator.stroke), actuator.identification
    _, sentence = temperature.cost(actuator)
    # A promise of records names the temperature itself.
    return [*lines, sentence] if sentence and (known is None or known.validity is None) else lines


def zero_of_path(
    actuator: Actuator,
    limits: Limits,
    zero: Zero | None,
    start: PossibleStart | None = None,
    present: float | None = None,
) -> float:
    """Return the model's displacement [m] that is the zero of a path."""
    if zero is None or not zero.name:
        return 0.0 if zero is None else zero.um * 1e-6
    compensator = Compensator(actuator, limits)
    low, high = compensator.reach
    if zero.name == "first":
        rest = min(max(present or 0.0, compensator.limits[0]), compensator.limits[1])
        begin = start or PossibleStart.unknown(actuator, rest, compensator.limits)
        return actuator.model.displacement(begin.state, of_mass=False)
    return low if zero.name == "bottom" else 0.5 * (low + high)


def reach_remarks(
    actuator: Actuator, wanted: Array, limits: Limits, zero: Zero | None, *, refuse: bool = True
) -> list[str]:
    """Return a remark on a path (n,) [m] outside of the reachable range, with this range and what to try.

    Raise `ModelError` if it is more than a stroke outside, because then its zero, unit or model is wrong.
    """
    if not wanted.size:
        return []
    compensator = Compensator(actuator, limits)
    low, high = compensator.reach
    least, most = float(wanted.min()), float(wanted.max())
    advice = _zero_advice((least, most), (low, high), zero)
    if refuse and compensator.strays(wanted):
        raise ModelError(
            f"got {1e6 * least:.6g} to {1e6 * most:.6g} um, the model reaches {1e6 * low:.4g} to {1e6 * high:.4g} um, "
            "from the sensor's zero in its records",
            argument="displacement",
            hint=f"check the numbers and their unit{advice and f', or {advice}'}",
        )
    margin = _ROUNDING * (high - low)
    if low - margin <= least and most <= high + margin:
        return []
    another = (
        "choose another --zero, or none" if zero is not None and most - least <= high - low else "choose a smaller path"
    )
    volts = "{:.5g} to {:.5g} V".format(*compensator.limits)
    return [
        f"the path covers {1e6 * least:.6g} to {1e6 * most:.6g} um, the model reaches {1e6 * low:.4g} to "
        f"{1e6 * high:.4g} um with {volts}, from the sensor's zero in its records; {advice or another}"
    ]


def _zero_advice(path: tuple[float, float], reach: tuple[float, float], zero: Zero | None) -> str:
    """Return a hint on the zero that brings a path into the reachable range; empty if there is none."""
    (low, high), (least, most) = reach, path
    if zero is not None or most - least > high - low:
        return ""
    if least >= 0 and most <= high - low:
        return "--zero bottom counts the path from the bottom of this range"
    if max(-least, most) <= 0.5 * (high - low):
        return "--zero mean counts the path from the middle of this range"
    return f"--zero {0.5 * (low + high - least - most) * 1e6:.4g} puts the path into the middle of this range"
