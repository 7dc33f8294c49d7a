"""Temperatures of records: whether they show how the displacement depends on them, and what was found, in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.identification.rules import RULES
from dehyst.model import Thermal
from dehyst.records import Record

# Parts of the range of temperatures, of which records must have some.
_PLACES, _FEWEST = 8, 3


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of records.

    `low`, `high`: lowest and highest [degC]. `reference`: their mean [degC]. `within`: whether a record's temperature
    changes by so much that it shows an offset, whatever the sensor's zero.
    """

    low: float
    high: float
    reference: float
    within: bool

    def sentence(self, thermal: Thermal, lowest: float, errors: Array, better: float) -> str:
        """Return what was found.

        `lowest`: displacement at the lowest voltage [m]. `errors`: standard errors of gain [1/K] and offset there
        [m/K]. `better`: error of held-out time, relative to the error without the effect.
        """
        offset, (of_gain, *of_offset) = thermal.offset + thermal.gain * lowest, errors.tolist()
        found = [f"the stroke changes by {100 * thermal.gain:+.3g} ± {100 * of_gain:.2g} %/K"]
        zero = f" Whether it also shifts as a whole is not known: no record changes by {RULES.temperatures:g} K."
        if of_offset:
            change = f"{1e9 * offset:+.3g} ± {1e9 * of_offset[0]:.2g} nm/K"
            found.append(f"the displacement at the lowest voltage changes by {change}")
            zero = ""
        return (
            f"From {self.low:.3g} to {self.high:.3g} degC {' and '.join(found)}. Held-out time is missed by "
            f"{100 * better:.0f} % of the error without that.{zero}"
        )


def temperatures_of(records: Sequence[Record]) -> tuple[Temperatures | None, str]:
    """Return the temperatures of `records` of one axis, and why they do not show an effect.

    None without a change by `DecisionRules.temperatures`. All records need a temperature; the reason is empty if there
    is nothing to show.
    """
    known = [record.temperature for record in records if record.temperature is not None]
    if not known:
        return None, ""
    every = np.concatenate(known)
    low, high = float(every.min()), float(every.max())
    if high - low < RULES.temperatures:
        return None, ""
    words = f"the temperature changes from {low:.3g} to {high:.3g} degC, which the model leaves out"
    if len(known) < len(records):
        missing = next(record.name for record in records if record.temperature is None)
        return None, f"{words}: {missing} has none"
    if np.count_nonzero(np.histogram(every, _PLACES)[0]) < _FEWEST:
        return None, f"{words}: record {_FEWEST} temperatures or more"
    within = max(float(np.ptp(np.quantile(one, [0.05, 0.95]))) for one in known)
    return Temperatures(low, high, float(every.mean()), within >= RULES.temperatures), ""
