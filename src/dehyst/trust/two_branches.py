"""A table of two branches of the major loop: what is usually done against hysteresis without a model of it.

Displacement over voltage is tabulated once for a rising and once for a falling voltage. A wanted displacement that
rises is looked up in the rising branch, one that falls in the falling branch. After a turn of the voltage the
displacement stays until the other branch is reached:

    y <- min(max(y, rising(v)), falling(v))

Inner loops therefore follow the major loop, which is the error of such a table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import keep, vector
from dehyst.model import on_curve
from dehyst.records import Record, reversals
from dehyst.trust.baselines import AbstractBaseline, widest_record

_PLACES = 50
# A leg of the major loop covers this part of the longest one; least slope of a branch as a part of the mean slope.
_WIDE, _LEAST_SLOPE = 0.9, 0.05


@dataclass(frozen=True)
class BranchState:
    """The memory: present voltage [V] and displacement [m]."""

    voltage: float
    displacement: float


@final
@dataclass(frozen=True, eq=False)
class TwoBranches(AbstractBaseline):
    """Two tabulated branches, linear between places and continued with the mean slope beyond the table.

    `voltage` (M,): places [V], strictly increasing. `rising`, `falling` (M,): displacements [m] of both branches there,
    strictly increasing, the falling branch nowhere below the rising one. `state`: default start of a motion, the lower
    end of the table. Raise `ModelError` if the arrays are no such table.
    """

    voltage: Array
    rising: Array
    falling: Array
    delay: float = 0.0
    state: BranchState = field(init=False, repr=False)

    def __post_init__(self) -> None:
        keep(self, **{name: vector(getattr(self, name), name) for name in ("voltage", "rising", "falling")})
        columns = (self.voltage, self.rising, self.falling)
        if len({column.size for column in columns}) > 1 or self.voltage.size < 2:
            raise ModelError("two branches: need two or more places, and a rising and a falling displacement at each")
        if any(np.any(np.diff(column) <= 0) for column in columns) or np.any(self.falling < self.rising):
            raise ModelError(
                "two branches: need voltages and displacements that increase, and no falling displacement below the "
                "rising one"
            )
        keep(self, state=BranchState(float(self.voltage[0]), float(self.rising[0])))

    @cached_property
    def _columns(self) -> tuple[Array, Array, Array]:
        """Voltage, rising and falling branch with a far place on either side, so that the branches do not cross."""
        span = float(np.ptp(self.voltage))
        slope = (self.falling[-1] - self.rising[0]) / span
        steps = (span, slope * span, slope * span)
        columns = zip((self.voltage, self.rising, self.falling), steps, strict=True)
        voltage, rising, falling = (np.concatenate([[x[0] - step], x, [x[-1] + step]]) for x, step in columns)
        return voltage, rising, falling

    def _run(
        self, drive: Array, state: BranchState, time: ArrayLike | None, *, inverse: bool
    ) -> tuple[Array, BranchState]:
        v, y = state.voltage, state.displacement
        voltage, *branches = self._columns
        out = np.empty(drive.size)
        if inverse:
            both = (on_curve(branch, voltage, drive).tolist() for branch in branches)
            for k, (wanted, rising, falling) in enumerate(zip(drive.tolist(), *both, strict=True)):
                v = rising if wanted > y else falling if wanted < y else v
                y, out[k] = wanted, v
            return out, BranchState(v, y)
        both = (on_curve(voltage, branch, drive).tolist() for branch in branches)
        for k, (rising, falling) in enumerate(zip(*both, strict=True)):
            out[k] = y = min(max(y, rising), falling)
        return out, BranchState(float(drive[-1]) if drive.size else v, y)

    @classmethod
    def fit(cls, records: Record | Sequence[Record]) -> TwoBranches:
        """Tabulate the means of the longest legs of the widest record, rising and falling, at 51 voltages.

        Raise `RecordError` if a record cannot be used, and `IdentifyError` if there is none, or no leg in a direction.
        """
        record = widest_record(records)
        ends = [0, *reversals(record).tolist(), len(record) - 1]
        legs = [slice(a, b + 1) for a, b in pairwise(ends)]
        reach = np.diff(record.voltage[ends])
        wide = np.abs(reach) >= _WIDE * np.abs(reach).max()
        low, high = float(record.voltage.min()), float(record.voltage.max())
        places = np.linspace(low, high, _PLACES + 1)
        slope = float(np.ptp(record.displacement)) / (high - low)
        branches = []
        for direction, name in ((1, "rises"), (-1, "falls")):
            chosen = [leg for leg, there in zip(legs, wide & (direction * reach > 0), strict=True) if there]
            # The first leg may begin anywhere in the hysteresis.
            chosen = chosen[1:] if chosen[1:] and chosen[0].start == 0 else chosen
            if not chosen:
                raise IdentifyError(
                    f"{record.name}: its voltage never {name} over the whole range; record at least one full cycle"
                )
            samples = np.concatenate([np.arange(leg.start, leg.stop) for leg in chosen])
            branches.append(_tabulated(record.voltage[samples], record.displacement[samples], places, slope))
        return cls(places, branches[0], np.maximum(*branches))


def _tabulated(voltage: Array, displacement: Array, places: Array, slope: float) -> Array:
    """Return the displacement [m] of one branch at places (M,) [V], as it increases with at least a part of `slope`."""
    from scipy.optimize import isotonic_regression

    part = np.clip(np.searchsorted(places, voltage, side="right") - 1, 0, places.size - 2)
    count = np.bincount(part, minlength=places.size - 1)
    seen = count > 0
    x, y = (np.bincount(part, values, places.size - 1)[seen] / count[seen] for values in (voltage, displacement))
    ramp = _LEAST_SLOPE * slope * places
    if x.size < 2:
        raise IdentifyError("two branches: too few samples between the ends of a leg; sample faster")
    return np.asarray(isotonic_regression(on_curve(x, y, places) - ramp).x + ramp)
