"""Temperatures that records tested: their range, the error of a path outside of it, and temperatures to record next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import plain
from dehyst._views.lines import percent
from dehyst.model.dynamics import Thermal
from dehyst.records import Record

# A model that does not depend on temperature counts as tested up to this distance [K] from the records.
NEAR_KELVINS = 2.0
# Temperatures closer than this [K] count as equal.
_ALIKE = 0.5


def temperature_range(records: Iterable[Record]) -> tuple[float, float] | None:
    """Return the lowest and highest temperature [degC] of all records; None if a record has no temperature."""
    found = [record.temperature for record in records]
    known = [values for values in found if values is not None]
    if not known or len(known) < len(found):
        return None
    return min(float(values.min()) for values in known), max(float(values.max()) for values in known)


def words_of(temperatures: Iterable[float]) -> str:
    """Return temperatures as text: "10, 35 and 60 degC"."""
    *some, last = [f"{degrees:.3g}" for degrees in temperatures]
    return f"{', '.join(some)}{' and ' if some else ''}{last} degC"


@dataclass(frozen=True, eq=False)
class TemperatureCost:
    """The error of a path due to its temperature.

    Each kelvin outside of the tested temperatures adds the whole effect of a kelvin. If the temperature is not known,
    the path is computed at the reference, and the effect up to the farthest tested temperature is added.

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
        """Distance [K] from the tested temperatures, one or one per sample; if unknown, of them from the reference."""
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
        """Largest change of the displacement per kelvin [m/K]."""
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
    def to_record(self) -> tuple[float, ...]:
        """Temperatures [degC] to record at so that the records cover those of the path; empty if they already do."""
        if self.tested is None or self.temperature is None:
            return ()
        low, high = float(np.min(self.temperature)), float(np.max(self.temperature))
        near, (coldest, hottest) = NEAR_KELVINS if self.thermal is None else _ALIKE, self.tested
        needed = {end for end, off in ((low, coldest - low), (high, high - hottest)) if off > near}
        if needed and self.thermal is None:
            # The records do not show an effect of temperature: it needs a third temperature in the middle.
            needed.add(0.5 * (min(low, coldest) + max(high, hottest)))
        return tuple(sorted(needed))

    @property
    def sentence(self) -> str:
        """Sentence about an unknown or untested temperature and its error; empty if the temperature is tested."""
        tested = "" if self.tested is None else "{:.3g} to {:.3g} degC".format(*self.tested)
        reference = None if self.thermal is None else self.thermal.reference
        if self.temperature is None:
            if reference is None:
                return ""
            within = f", {percent(self.largest, self.stroke)} within the {tested} of the records" if tested else ""
            return (
                f"Without a temperature the path is computed at {reference:.3g} degC; each kelvin off adds up to "
                f"{percent(self.per_kelvin, self.stroke)} of the stroke{within}."
            )
        if not (needed := self.to_record):
            return ""
        farthest = float(self.kelvins.max(initial=0.0))
        low, high = float(np.min(self.temperature)), float(np.max(self.temperature))
        used = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        adds = "" if reference is None else f", which adds {percent(self.largest, self.stroke)} of the stroke"
        return (
            f"The model was not tested at {used} degC: the records have {tested}, {farthest:.3g} K away{adds}. "
            f"Record at {words_of(needed)}."
        )


def demand_thermal(*thermals: Thermal | None) -> Thermal:
    """Return the first part that is not None, of one actuator or of several; raise `ModelError` if all are None."""
    for thermal in thermals:
        if thermal is not None:
            return thermal
    raise ModelError(
        f"{'this actuator does' if len(thermals) == 1 else 'these actuators do'} not depend on temperature",
        argument="temperature",
        hint="leave it out, or identify the model from records at several temperatures",
    )


def temperature_columns(temperature: ArrayLike, samples: int, axes: int) -> Array:
    """Return temperatures [degC] (samples, axes) from one number, one per sample, or one per sample and axis.

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
