"""Temperatures that records tested: their range, the error of a path outside of it, and temperatures to record next."""

from __future__ import annotations

from collections.abc import Iterable

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


def to_record(thermal: Thermal | None, tested: tuple[float, float], temperature: ArrayLike) -> tuple[float, ...]:
    """Return the temperatures [degC] to record at so that the records cover those of a path; empty if they do.

    `tested`: lowest and highest temperature of the records [degC].
    """
    low, high = float(np.min(temperature)), float(np.max(temperature))
    near = NEAR_KELVINS if thermal is None else _ALIKE
    needed = {end for end, off in ((low, tested[0] - low), (high, high - tested[1])) if off > near}
    if needed and thermal is None:
        # The records do not show an effect of temperature: it needs a third temperature in the middle.
        needed.add(0.5 * (min(low, tested[0]) + max(high, tested[1])))
    return tuple(sorted(needed))


def temperature_cost(
    thermal: Thermal | None, tested: tuple[float, float] | None, stroke: float, temperature: ArrayLike | None
) -> tuple[Array, str]:
    """Return the error of a path due to its temperature [m], one or one per sample, and a sentence on it.

    Each kelvin outside of the tested temperatures adds the whole effect of a kelvin. If the temperature is not known,
    the path is computed at the reference, and the effect up to the farthest tested temperature is added. The sentence
    is empty if the temperature is tested.

    `tested`: lowest and highest temperature of the records [degC], if known. `stroke` [m]. `temperature`: of the path,
    one or (n,) [degC]; None: not known.
    """
    reference = None if thermal is None else thermal.reference
    per_kelvin = 0.0 if thermal is None else thermal.per_kelvin(stroke)
    records = "" if tested is None else "{:.3g} to {:.3g} degC".format(*tested)
    low, high = tested or (0.0, 0.0)
    if temperature is None:
        if reference is None:
            return np.zeros(()), ""
        along = np.asarray(per_kelvin * (max(reference - low, high - reference, 0.0) if tested else 0.0))
        within = f", {percent(float(along), stroke)} within the {records} of the records" if tested else ""
        return along, (
            f"Without a temperature the path is computed at {reference:.3g} degC; each kelvin off adds up to "
            f"{percent(per_kelvin, stroke)} of the stroke{within}."
        )
    if tested is None:
        return np.zeros(()), ""
    degrees = np.asarray(temperature, dtype=np.float64)
    kelvins = np.maximum(np.maximum(low - degrees, degrees - high), 0.0)
    along = np.asarray(per_kelvin * kelvins)
    if not (needed := to_record(thermal, tested, degrees)):
        return along, ""
    first, last = f"{degrees.min():.3g}", f"{degrees.max():.3g}"
    used = first if degrees.min() == degrees.max() else f"{first} to {last}"
    adds = "" if reference is None else f", which adds {percent(float(along.max()), stroke)} of the stroke"
    *some, end = [f"{each:.3g}" for each in needed]
    return along, (
        f"The model was not tested at {used} degC: the records have {records}, {kelvins.max():.3g} K away{adds}. "
        f"Record at {', '.join(some)}{' and ' if some else ''}{end} degC."
    )


def demand_thermal(*thermals: Thermal | None) -> Thermal:
    """Return the first part that is not None, of one actuator or of several; raise `ModelError` if all are None."""
    for thermal in thermals:
        if thermal is not None:
            return thermal
    words = f"{'this actuator does' if len(thermals) == 1 else 'these actuators do'} not depend on temperature"
    hint = "leave it out, or identify the model from records at several temperatures"
    raise ModelError(words, argument="temperature", hint=hint)


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
        got = f"{np.shape(temperature) or repr(temperature)} for {samples} samples of {axes} axes"
        need = "one number, one per sample, or one per sample and axis"
        raise ModelError(argument="temperature", got=got, need=need) from error
