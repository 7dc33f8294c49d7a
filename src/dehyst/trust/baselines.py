"""Other models behind the interface of an actuator, and what is usually done without a model.

A straight line, y = y_0 + stroke (v - v_low) / (v_high - v_low), has no hysteresis. A table of two branches of the
major loop has displacement over voltage once for a rising and once for a falling voltage. A wanted displacement that
rises is looked up in the rising branch, one that falls in the falling branch. After a turn of the voltage the
displacement stays until the other branch is reached:

    y <- min(max(y, rising(v)), falling(v))

Inner loops therefore follow the major loop, which is the error of such a table.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import IdentifyError, ModelError
from dehyst._types import Array
from dehyst._validation import demand_result, keep, number, vector
from dehyst.identification import as_list, prepare
from dehyst.model import AbstractModel, Motion, State, branches_of, on_curve
from dehyst.records import Record

_PLACES = 50
# A branch of the major loop covers this part of the longest one; least slope of a branch as a part of the mean slope.
_WIDE, _LEAST_SLOPE = 0.9, 0.05


class AbstractBaseline(AbstractModel):
    """Another model behind the interface of an actuator; `dehyst compare` has one row for each.

    Attributes: `state` is the default start of a motion. `delay` [s] is the lag of the measured displacement behind the
    voltage; `simulate` and `compensate` do not apply it.
    """

    state: Any
    delay: float

    def simulate(self, voltage: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the displacement (n,) [m] that a voltage (n,) [V] causes.

        Raise `ModelError` if the voltage is not a path of finite numbers, the state belongs to another model, a model
        with creep gets no increasing time, or a displacement is too large to be computed.

        `voltage` (n,) [V]. `state`: state before the first sample, from a motion of this model; default: the model's
        own. `time` (n,) [s], increasing; models without creep ignore it.
        """
        v = vector(voltage, "voltage")
        y, after = self._run(v, self._start(state), time, inverse=False)
        demand_result(y, "displacement")
        return Motion(v, y, after)

    def compensate(self, displacement: ArrayLike, *, state: Any = None, time: ArrayLike | None = None) -> Motion:
        """Return the voltage (n,) [V] for a displacement (n,) [m]; arguments as `simulate`.

        Raise `ModelError` as `simulate`, and if no voltage reaches a displacement.
        """
        y = vector(displacement, "displacement")
        v, after = self._run(y, self._start(state), time, inverse=True)
        demand_result(v, "voltage")
        return Motion(v, y, after)

    def _start(self, state: Any) -> Any:
        start = self.state if state is None else state
        if not isinstance(start, type(self.state)):
            kind = type(self.state).__name__
            raise ModelError(f"state: got {type(start).__name__}, need a {kind} that a motion of this model returned")
        return start

    @abstractmethod
    def _run(self, drive: Array, state: Any, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, Any]:
        """Return displacements (n,) [m] for voltages (n,) [V], or with `inverse` the reverse; and the state."""


def widest_record(records: Record | Sequence[Record]) -> Record:
    """Return the record with the widest loops, without what cannot be used.

    Raise `RecordError` if a record cannot be used, and `IdentifyError` if there is none.
    """
    items = [prepare(record) for record in as_list(records)]
    if not items:
        raise IdentifyError("got no records, need at least one loop of voltage and displacement")
    return max(items, key=lambda item: float(np.ptp(item.span()))).record


@final
@dataclass(frozen=True)
class Linear(AbstractBaseline):
    """A straight line; its state is its displacement, which has no effect.

    `slope` [m/V], above 0. `offset`: displacement at 0 V [m]. Raise `ModelError` if the slope is not above 0.
    """

    slope: float
    offset: float = 0.0
    delay: float = 0.0
    state: State = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        number(self.offset, "offset")
        if number(self.slope, "slope") <= 0:
            raise ModelError(f"slope: got {self.slope}, need metres a volt, above 0")
        keep(self, state=State(self.offset, []))

    def _run(self, drive: Array, state: State, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, State]:
        y = drive if inverse else self.offset + self.slope * drive
        after = State(float(y[-1]) if y.size else self.offset, [])
        return (y - self.offset) / self.slope if inverse else y, after

    @classmethod
    def fit(cls, records: Record | Sequence[Record]) -> Linear:
        """Take the slope from the end points of the widest record, and the offset from its mean.

        Raise `RecordError` if a record cannot be used, and `IdentifyError` if there is none.
        """
        record = widest_record(records)
        slope = float(np.ptp(record.displacement) / np.ptp(record.voltage))
        return cls(slope, float((record.displacement - slope * record.voltage).mean()))


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
        alike = len({column.size for column in columns}) == 1 and self.voltage.size > 1
        if not alike or any(np.any(np.diff(column) <= 0) for column in columns) or np.any(self.falling < self.rising):
            need = "two or more places with a rising and a falling displacement each, the falling one not below"
            raise ModelError(f"two branches: need {need}, in increasing order")
        keep(self, state=BranchState(float(self.voltage[0]), float(self.rising[0])))

    @cached_property
    def _columns(self) -> tuple[Array, Array, Array]:
        """Voltage, rising and falling branch extended far on both sides, so that the branches do not cross."""
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
        """Tabulate the means of the longest branches of the widest record, rising and falling, at 51 voltages.

        Raise `RecordError` if a record cannot be used, `IdentifyError` if there is none, or no branch in a direction.
        """
        record = widest_record(records)
        low, high = record.voltage_range
        at = branches_of(record.voltage, high - low)
        height = np.diff(record.voltage[at], axis=1)[:, 0]
        wide = np.abs(height) >= _WIDE * np.abs(height).max(initial=0.0)
        places = np.linspace(low, high, _PLACES + 1)
        slope = float(np.ptp(record.displacement)) / (high - low)
        branches = []
        for direction, name in ((1, "rises"), (-1, "falls")):
            chosen = at[wide & (direction * height > 0)]
            # The first branch may begin anywhere in the hysteresis.
            chosen = chosen[1:] if len(chosen) > 1 and not chosen[0, 0] else chosen
            if not len(chosen):
                missing = f"its voltage never {name} over the whole range"
                raise IdentifyError(f"{record.name}: {missing}; record at least one full cycle")
            samples = np.concatenate([np.arange(first, last + 1) for first, last in chosen.tolist()])
            branches.append(_tabulated(record.voltage[samples], record.displacement[samples], places, slope))
        return cls(places, branches[0], np.maximum(*branches))


def _tabulated(voltage: Array, displacement: Array, places: Array, slope: float) -> Array:
    """Return the displacement [m] of one branch at places (M,) [V], which rises by at least a part of `slope`."""
    from scipy.optimize import isotonic_regression

    part = np.clip(np.searchsorted(places, voltage, side="right") - 1, 0, places.size - 2)
    count = np.bincount(part, minlength=places.size - 1)
    seen = count > 0
    x, y = (np.bincount(part, values, places.size - 1)[seen] / count[seen] for values in (voltage, displacement))
    ramp = _LEAST_SLOPE * slope * places
    if x.size < 2:
        raise IdentifyError("two branches: too few samples between the ends of a branch; sample faster")
    return np.asarray(isotonic_regression(on_curve(x, y, places) - ramp).x + ramp)
