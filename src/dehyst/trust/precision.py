"""Which numbers are known to a stated precision: the records determine them, and their intervals are narrow.

A number is known if the records determine it by itself, regardless of noise, and its interval is narrow. An interval is
narrow if half its width is at most the precision times the estimate, and it excludes zero. An estimate of exactly 0 is
known to be below the upper end of its interval, if this end is at most the precision times the mean number of the part.
An interval due to noise that excludes the estimate is extended to it, and the reason is given.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from dehyst._types import Array, Mask
from dehyst._views.fields import json_values
from dehyst.trust.bootstrap import Intervals
from dehyst.trust.evidence import Evidence
from dehyst.trust.feasible_set import FeasibleSet
from dehyst.trust.identifiability import PartIdentifiability

# Half the width of an interval, as a part of the estimate.
PRECISION = 0.2
# Beside intervals by noise that exclude the estimate.
NOISE_BIAS = (
    "By noise: models identified from resampled records lie to one side of the model that these records were simulated "
    "with. The interval has this bias removed, so it may exclude the estimate; the verdict says so and counts both."
)
# An interval by noise that misses the estimate by less than this part of the estimate is rounding.
_ROUNDING = 1e-9


class NumberVerdict(Enum):
    """Verdict on a number, from its interval."""

    KNOWN = "known"
    BELOW = "known to be small"
    OPEN = "not determined by itself"
    ZERO = "contains zero"
    WIDE = "too wide"


@dataclass(frozen=True, eq=False)
class PartPrecision:
    """The numbers of one part, each with its interval and verdict.

    Attributes
    ----------
    part : str
        Name of one number, such as "stiffness".
    several : str
        The name in the plural.
    unit : str
    estimate : (n,) array
        Numbers of the model [`unit`].
    noise : (2, n) array
        Ends of the intervals due to noise, which may exclude the estimate.
    interval : (2, n) array
        Ends of the intervals from noise and compatible models together; they include the estimate.
    determined : (n,) bool array
        Whether the records determine a number by itself, regardless of noise.
    precision : float
        Largest half width of the interval of a known number, as a part of the estimate.
    """

    part: str
    several: str
    unit: str
    estimate: Array
    noise: Array
    interval: Array
    determined: Mask
    precision: float

    @classmethod
    def of(
        cls,
        names: tuple[str, str, str],
        estimate: Array,
        noise: Array,
        determined: Mask,
        precision: float,
        compatible: Array | None = None,
    ) -> PartPrecision:
        """Judge numbers by their intervals due to noise, and by the bounds of compatible models, if there are any.

        `names`: singular, plural and unit of the numbers.
        """
        lows, highs = ([end, estimate] for end in noise)
        if compatible is not None:
            lows.append(compatible[0])
            highs.append(compatible[1])
        interval = np.array([np.min(lows, axis=0), np.max(highs, axis=0)])
        return cls(*names, estimate, noise, interval, determined, precision)

    @property
    def half(self) -> Array:
        """Half the width of each interval (n,)."""
        return np.asarray(0.5 * (self.interval[1] - self.interval[0]))

    @property
    def verdicts(self) -> tuple[NumberVerdict, ...]:
        """Verdict on each number."""
        mean = float(np.abs(self.estimate).mean()) if self.of_all else 0.0
        return tuple(self._verdict(i, mean) for i in range(self.of_all))

    def _verdict(self, i: int, mean: float) -> NumberVerdict:
        (low, high), estimate = self.interval[:, i], self.estimate[i]
        if not self.determined[i]:
            return NumberVerdict.OPEN
        if estimate == 0 and 0 < max(high, -low) <= self.precision * mean:
            return NumberVerdict.BELOW
        if low <= 0 <= high:
            return NumberVerdict.ZERO
        return NumberVerdict.KNOWN if self.half[i] <= self.precision * abs(estimate) else NumberVerdict.WIDE

    @property
    def known(self) -> int:
        """Number of known numbers, including those known to be small."""
        return sum(verdict in (NumberVerdict.KNOWN, NumberVerdict.BELOW) for verdict in self.verdicts)

    @property
    def of_all(self) -> int:
        """Number of numbers."""
        return int(self.estimate.size)

    @property
    def by_noise(self) -> int:
        """Number of numbers that would be known if only noise counted."""
        alone = PartPrecision.of(
            (self.part, self.several, self.unit), self.estimate, self.noise, self.determined, self.precision
        )
        return alone.known

    @property
    def biased(self) -> tuple[int, ...]:
        """Bias of each estimate due to noise: -1 below its interval, 1 above it, 0 within."""
        slack = _ROUNDING * float(np.abs(self.estimate).max(initial=0.0))
        below, above = self.estimate < self.noise[0] - slack, self.estimate > self.noise[1] + slack
        return tuple((above.astype(int) - below.astype(int)).tolist())

    def words(self, i: int) -> str:
        """Describe number i, as "known, ± 6 %"; with the reason if the interval due to noise excludes the estimate."""
        verdict, reason = self.verdicts[i], self.reason(i)
        if verdict is NumberVerdict.BELOW:
            text = f"known to be below {_shown(max(self.interval[1, i], -self.interval[0, i]), self.unit)}"
        elif verdict in (NumberVerdict.KNOWN, NumberVerdict.WIDE):
            share = f"± {100 * self.half[i] / abs(self.estimate[i]):.2g} %"
            text = f"known, {share}" if verdict is NumberVerdict.KNOWN else share
        else:
            text = "not determined" if verdict is NumberVerdict.OPEN else "contains zero"
        return f"{text}; {reason}" if reason else text

    def reason(self, i: int) -> str:
        """Return why estimate i is outside of its interval due to noise; empty if it is inside."""
        side = self.biased[i]
        return "" if not side or not self.determined[i] else f"noise makes it too {'large' if side > 0 else 'small'}"

    @property
    def counted(self) -> str:
        """Return "7 of 19 stiffnesses"."""
        return f"{self.known} of {self.of_all} {self.part if self.of_all == 1 else self.several}"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            **json_values(self, "part unit known of=of_all estimate interval"),
            "verdicts": [verdict.value for verdict in self.verdicts],
            "words": [self.words(i) for i in range(self.of_all)],
        }


@dataclass(frozen=True, eq=False)
class Precision:
    """Which numbers of a model are known to a stated precision.

    Attributes
    ----------
    parts : tuple of PartPrecision
    precision : float
        Largest half width of the interval of a known number, as a part of the estimate.
    level : float
        Confidence level of the intervals, 0 to 1.
    """

    parts: tuple[PartPrecision, ...]
    precision: float
    level: float

    @property
    def all_known(self) -> bool:
        """Whether every number of every part is known."""
        return all(part.known == part.of_all for part in self.parts)

    @property
    def rule(self) -> str:
        """A sentence that defines "known"."""
        return (
            f"Known within {100 * self.precision:g} %: the records determine the number by itself, half the width of "
            f"its {100 * self.level:g} % interval is at most {100 * self.precision:g} % of the estimate, and the "
            "interval excludes zero. An estimate of 0 is known if the interval's upper end is at most "
            f"{100 * self.precision:g} % of the mean number of its part."
        )

    @property
    def sentence(self) -> str:
        """A sentence with the number of known numbers of each part."""
        counts = _listed(part.counted for part in self.parts)
        few = len(self.parts) == 1 and self.parts[0].known == 1
        return f"{counts} {'is' if few else 'are'} known within {100 * self.precision:g} %."

    @property
    def others(self) -> str:
        """How many numbers are not known for each reason; empty if all are known."""
        verdicts = [verdict for part in self.parts for verdict in part.verdicts]
        reasons = {
            NumberVerdict.OPEN: "not determined by themselves",
            NumberVerdict.ZERO: "with an interval that contains zero",
            NumberVerdict.WIDE: "with a wider interval",
        }
        counts = [f"{verdicts.count(verdict)} {words}" for verdict, words in reasons.items() if verdict in verdicts]
        return f"Not known: {_listed(counts)}." if counts else ""

    @property
    def next(self) -> str:
        """What to do if further turning points do not help; empty if all numbers are known."""
        if self.all_known:
            return ""
        gain = sum(part.by_noise - part.known for part in self.parts)
        if gain:
            count = f"{gain} more {'is' if gain == 1 else 'are'} known"
            return (
                f"By noise alone {count}: the rest of the intervals' width is error of the model class, which more "
                "records of this kind do not reduce."
            )
        return "Record more cycles: four times as many halve an interval by noise; or identify fewer elements."

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "precision level all=all_known sentence others next rule parts")


def _listed(items: Iterable[str]) -> str:
    words: Sequence[str] = tuple(items)
    return " and ".join(words) if len(words) < 3 else f"{', '.join(words[:-1])} and {words[-1]}"


def _shown(value: float, unit: str) -> str:
    """Return a number with its SI unit as text; stiffnesses in volts per micrometre."""
    return f"{value * 1e-6:.3g} V/um" if unit == "V/m" else f"{value:.3g} {unit}"


_STIFFNESS = ("stiffness", "stiffnesses", "V/m")
_SPRING = ("spring segment", "spring segments", "V/m")


def known_numbers(
    evidence: Evidence,
    intervals: Intervals,
    parts: tuple[PartIdentifiability, ...],
    free: FeasibleSet | None,
    precision: float,
) -> Precision:
    """Judge the coefficients of each part, except those that the structure fixes at zero.

    With a feasible set (Maxwell-slip models only), intervals cover noise and compatible models, and the turning points
    decide which stiffnesses are determined. An open direction that moves a spring segment widens the range of this
    segment among compatible models. Without a feasible set, intervals cover noise, and `parts` decide what is
    determined.
    """
    alone = {one.part: one.alone for one in parts}
    actuator, movable = evidence.actuator, evidence.regression.grid.movable
    kappa, noise = actuator.slip.stiffness[movable], intervals.stiffness[:, movable]
    elements = next((alone[name] for name in alone if name.endswith("elements") and name != "smooth elements"), None)
    spring = alone.get("parallel spring")
    if free is not None:
        elements, spring = evidence.identifiability.alone[movable], np.ones(actuator.spring.slopes.size, dtype=bool)
    compatible = (None, None) if free is None else (free.stiffness[:, movable], free.slopes)
    judged = [
        _part(_STIFFNESS, kappa.ravel(), noise.reshape(2, -1), elements, precision, compatible[0]),
        _part(_SPRING, actuator.spring.slopes, intervals.slopes, spring, precision, compatible[1]),
    ]
    if actuator.creep is not None and intervals.creep is not None:
        names = "creep branch", "creep branches", "V/m"
        judged.append(_part(names, actuator.creep.stiffness, intervals.creep, alone.get("creep"), precision))
    if actuator.smooth is not None and intervals.smooth is not None:
        names = "smooth element", "smooth elements", "V/m"
        judged.append(_part(names, actuator.smooth.stiffness, intervals.smooth, alone.get(names[1]), precision))
    if actuator.transformer is not None and intervals.gains is not None:
        names, gains = ("transformer segment", "transformer segments", "V/V"), alone.get("transformer")
        # The slope of the last segment of tau follows from the others because both ends are fixed.
        gains = None if gains is None else np.append(gains, gains.all())
        judged.append(_part(names, actuator.transformer.slopes, intervals.gains, gains, precision))
    # Of the Maxwell-slip class both parts are named, also without an element that slides.
    return Precision(tuple(part for part in judged if part.of_all or free is not None), precision, intervals.level)


def _part(
    names: tuple[str, str, str],
    estimate: Array,
    noise: Array,
    alone: Mask | None,
    precision: float,
    compatible: Array | None = None,
) -> PartPrecision:
    determined = np.zeros(estimate.size, dtype=bool) if alone is None else alone
    return PartPrecision.of(names, estimate, noise, determined, precision, compatible)
