"""Temperatures that records tested: their range, what a path outside of it costs, and where to record next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._units import COLDEST, HOTTEST
from dehyst.model.dynamics import Thermal
from dehyst.records import Record

# Temperatures [degC] so near to those of the records count as tested by a model that does not depend on temperature.
NEAR_KELVINS = 2.0
# Fewest temperatures that show gain and offset.
_FEWEST = 3
# Printed temperatures closer than this [K] are one.
_ALIKE = 0.5


def temperature_range(records: Iterable[Record]) -> tuple[float, float] | None:
    """Return the lowest and highest temperature [degC] of all records; None if one of them has none."""
    found = [record.temperature for record in records]
    known = [values for values in found if values is not None]
    if not known or len(known) < len(found):
        return None
    return min(float(one.min()) for one in known), max(float(one.max()) for one in known)


def temperatures_to_record(
    tested: tuple[float, float] | None, used: tuple[float, float] | None, reference: float | None = None
) -> tuple[float, ...]:
    """Return the temperatures [degC] to record at, so that the records cover those that are used; empty if they do.

    `tested`: lowest and highest of the records, or None. `used`: lowest and highest in use. `reference`: that of a
    model that depends on temperature; it does not need three temperatures again.
    """
    if used is None:
        return ()
    low, high = used
    if not COLDEST <= low <= high <= HOTTEST:
        need = f"degrees Celsius between {COLDEST:g} and {HOTTEST:g}, the lower one first"
        raise ModelError(argument="temperatures", got=f"{low:g} to {high:g}", need=need)
    if tested is None:
        steps = _FEWEST if high - low >= NEAR_KELVINS else 1
        return tuple(np.linspace(low, high, steps).tolist()) if steps > 1 else (0.5 * (low + high),)
    near = _ALIKE if reference is not None else NEAR_KELVINS
    needed = [end for end, off in ((low, tested[0] - low), (high, high - tested[1])) if off > near]
    if needed and reference is None:
        # What the records have is one temperature, or does not show an effect: a third one lies between.
        ends = min(low, tested[0]), max(high, tested[1])
        needed.append(0.5 * (ends[0] + ends[1]))
    return tuple(sorted(set(needed)))


@dataclass(frozen=True)
class TemperatureCover:
    """Temperatures [degC] that records tested, and those in use.

    `tested`, `used`: lowest and highest, or None. `reference`: that of a model that depends on temperature, or None.
    """

    tested: tuple[float, float] | None = None
    used: tuple[float, float] | None = None
    reference: float | None = None

    @property
    def missing(self) -> tuple[float, ...]:
        """Temperatures to record at [degC]; empty if the records cover those in use."""
        return temperatures_to_record(self.tested, self.used, self.reference)

    @property
    def sentence(self) -> str:
        """What is tested, and what is missing; empty if the records have no temperature and none is asked for."""
        known = "The records have no temperature."
        if self.tested is not None:
            known = "The records have {:.3g} to {:.3g} degrees Celsius.".format(*self.tested)
        if self.used is None:
            return "" if self.tested is None else known
        low, high = self.used
        if not self.missing:
            return f"{known} They cover {low:.3g} to {high:.3g}."
        gaps = [(low, high)]
        if self.tested is not None:
            below, above = (low, min(high, self.tested[0])), (max(low, self.tested[1]), high)
            gaps = [gap for gap in (below, above) if gap[0] < gap[1]] or gaps
        words = " and ".join(f"{first:.3g} to {last:.3g}" for first, last in gaps)
        return f"{known} Not tested: {words}. Record at {words_of(self.missing)} too."

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        lists = {"tested_degC": self.tested, "used_degC": self.used, "record_at_degC": self.missing}
        return {name: None if values is None else list(values) for name, values in lists.items()}


def words_of(temperatures: Iterable[float]) -> str:
    """Return temperatures as text: "10, 35 and 60 degrees Celsius"."""
    *some, last = [f"{one:.3g}" for one in temperatures]
    return f"{', '.join(some)}{' and ' if some else ''}{last} degrees Celsius"


def temperature_cost(
    thermal: Thermal | None,
    tested: tuple[float, float] | None,
    stroke: float,
    temperature: ArrayLike | None,
) -> tuple[Array, str]:
    """Return what the temperature of a path adds to its error [m], and a sentence on it; 0 and "" if it is tested.

    The cost is one number, or one a sample. A kelvin outside of the tested temperatures adds the whole effect of a
    kelvin. If the temperature is not known, the path is computed at the reference; the cost is the effect up to the
    farthest tested temperature.

    Parameters
    ----------
    thermal : Thermal or None
        Part of the model.
    tested : (float, float) or None
        Lowest and highest temperature of its records [degC].
    stroke : float
        [m]
    temperature : float or (n,) array_like, optional
        Temperature of the path [degC]; default: not known.
    """
    each = 0.0 if thermal is None else thermal.per_kelvin(stroke)
    if temperature is None:
        if thermal is None:
            return np.zeros(()), ""
        low, high = tested or (thermal.reference, thermal.reference)
        cost = each * max(thermal.reference - low, high - thermal.reference, 0.0)
        sentence = (
            f"Without its temperature it is computed at {thermal.reference:.3g} degrees Celsius; each kelvin off adds "
            f"up to {100 * each / stroke:.2g} % of the stroke"
        )
        if tested is not None:
            sentence += f", {100 * cost / stroke:.2g} % within the {low:.3g} to {high:.3g} of the records"
        return np.asarray(cost), f"{sentence}."
    degrees = np.asarray(temperature, dtype=np.float64)
    if tested is None or not degrees.size:
        return np.zeros(()), ""
    (low, high), (least, most) = tested, (float(degrees.min()), float(degrees.max()))
    off = np.maximum(np.maximum(low - degrees, degrees - high), 0.0)
    farthest = float(off.max())
    if farthest <= (_ALIKE if thermal is not None else NEAR_KELVINS):
        return np.asarray(each * off), ""
    where = f"{least:.3g}" if least == most else f"{least:.3g} to {most:.3g}"
    sentence = (
        f"At {where} degrees Celsius it was not tested: the records have {low:.3g} to {high:.3g}, {farthest:.2g} K away"
    )
    if thermal is not None:
        sentence += f", which adds {100 * each * farthest / stroke:.2g} % of the stroke"
    needed = temperatures_to_record(tested, (least, most), None if thermal is None else thermal.reference)
    return np.asarray(each * off), f"{sentence}. Record at {words_of(needed)}."


def demand_thermal(thermal: Thermal | None) -> Thermal:
    """Return the part of a model that depends on temperature; raise `ModelError` if it has none."""
    if thermal is None:
        raise ModelError(
            "this actuator does not depend on temperature",
            argument="temperature",
            hint="leave it out, or give the actuator a part Thermal",
        )
    return thermal
