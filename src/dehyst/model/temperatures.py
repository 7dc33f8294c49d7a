"""Temperatures that records tested: their range, what a path outside of it costs, and where to record next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._units import COLDEST, HOTTEST
from dehyst._validation import plain
from dehyst._views.lines import percent
from dehyst.model.dynamics import Thermal
from dehyst.records import Record

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

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
    return min(float(values.min()) for values in known), max(float(values.max()) for values in known)


def tested_temperatures(actuator: Actuator) -> tuple[float, float] | None:
    """Return the lowest and highest temperature [degC] of the records of an `actuator`; None if it is not known."""
    known = actuator.identification
    return None if known is None or known.validity is None else known.validity.temperatures


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
        need = f"{COLDEST:g} to {HOTTEST:g} degC, the lower one first"
        raise ModelError(argument="temperatures", got=f"{low:g} to {high:g}", need=need)
    if tested is None:
        steps = _FEWEST if high - low >= NEAR_KELVINS else 1
        return tuple(np.linspace(low, high, steps).tolist()) if steps > 1 else (0.5 * (low + high),)
    near = _ALIKE if reference is not None else NEAR_KELVINS
    needed = [end for end, off in ((low, tested[0] - low), (high, high - tested[1])) if off > near]
    if needed and reference is None:
        # The records have one temperature, or do not show its effect: a third temperature lies between.
        ends = min(low, tested[0]), max(high, tested[1])
        needed.append(0.5 * (ends[0] + ends[1]))
    return tuple(sorted(set(needed)))


def words_of(temperatures: Iterable[float]) -> str:
    """Return temperatures as text: "10, 35 and 60 degC"."""
    *some, last = [f"{degrees:.3g}" for degrees in temperatures]
    return f"{', '.join(some)}{' and ' if some else ''}{last} degC"


@dataclass(frozen=True, eq=False)
class TemperatureCost:
    """What the temperature of a path adds to its error.

    A kelvin outside of the tested temperatures adds the whole effect of a kelvin. If the temperature is not known, the
    path is computed at the reference, and the effect up to the farthest tested temperature is added.

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

    thermal: Thermal | None
    tested: tuple[float, float] | None
    stroke: float
    temperature: ArrayLike | None = None

    @cached_property
    def kelvins(self) -> Array:
        """Distance [K] from the tested temperatures, one or one per sample; of an unknown one from the reference."""
        if self.tested is None:
            return np.zeros(())
        low, high = self.tested
        if self.temperature is None:
            reference = None if self.thermal is None else self.thermal.reference
            return np.asarray(0.0 if reference is None else max(reference - low, high - reference, 0.0))
        degrees = np.asarray(self.temperature, dtype=np.float64)
        return np.asarray(np.maximum(np.maximum(low - degrees, degrees - high), 0.0))

    @property
    def per_kelvin(self) -> float:
        """Most by which a kelvin changes the displacement [m]."""
        return 0.0 if self.thermal is None else self.thermal.per_kelvin(self.stroke)

    @property
    def along(self) -> Array:
        """The added error [m], one number or one per sample."""
        return np.asarray(self.per_kelvin * self.kelvins)

    @property
    def largest(self) -> float:
        """The largest added error [m]."""
        return float(self.along.max(initial=0.0))

    @property
    def sentence(self) -> str:
        """What is not known or not tested, and its cost; empty if the temperature is tested."""
        tested = "" if self.tested is None else "{:.3g} to {:.3g} degC".format(*self.tested)
        reference = None if self.thermal is None else self.thermal.reference
        if self.temperature is None:
            if reference is None:
                return ""
            within = f", {percent(self.largest, self.stroke)} within the {tested} of the records" if tested else ""
            return (
                f"Without its temperature it is computed at {reference:.3g} degC; each kelvin off adds up to "
                f"{percent(self.per_kelvin, self.stroke)} of the stroke{within}."
            )
        farthest = float(self.kelvins.max(initial=0.0))
        if farthest <= (NEAR_KELVINS if reference is None else _ALIKE):
            return ""
        low, high = float(np.min(self.temperature)), float(np.max(self.temperature))
        used = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        adds = "" if reference is None else f", which adds {percent(self.largest, self.stroke)} of the stroke"
        return (
            f"At {used} degC it was not tested: the records have {tested}, {farthest:.3g} K away{adds}. Record at "
            f"{words_of(temperatures_to_record(self.tested, (low, high), reference))}."
        )


def demand_thermal(*thermals: Thermal | None) -> Thermal:
    """Return the first part that depends on temperature, of one actuator or of several; raise `ModelError` if none."""
    for thermal in thermals:
        if thermal is not None:
            return thermal
    raise ModelError(
        f"{'this actuator does' if len(thermals) == 1 else 'these actuators do'} not depend on temperature",
        argument="temperature",
        hint="leave it out, or identify the model from records at several temperatures",
    )


def temperature_columns(temperature: ArrayLike, samples: int, axes: int) -> Array:
    """Return a temperature [degC] as (samples, axes): of one number, one per sample (samples,), or one per axis too.

    Raise `ModelError` if it has another shape.
    """
    try:
        given = np.asarray(plain(temperature, "temperature"), dtype=np.float64)
        if given.ndim == 2 and given.shape != (samples, axes):
            raise ValueError
        return np.broadcast_to(given[:, None] if given.ndim == 1 else given, (samples, axes))
    except (TypeError, ValueError) as error:
        raise ModelError(
            argument="temperature",
            got=f"{np.shape(temperature) or repr(temperature)} for {samples} samples of {axes} axes",
            need="one number, one per sample, or one per sample and axis",
        ) from error
