"""The plan of a path: its voltages, the displacement that they should cause, and the error that it may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst._units import per_metre
from dehyst._views.lines import length, span_of
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.start import StartError

HOMING, WAY, PATH = 0, 1, 2


@dataclass(frozen=True, eq=False, repr=False)
class PathPlan:
    """The voltages for a path: a homing if necessary, the way to the first sample, and the path itself.

    For several axes, arrays of displacements and voltages are (n, axes), and the entries that are marked with * are
    tuples with one value for each axis; `each` has the plan of each axis.

    Attributes
    ----------
    time : (n,) array or None
        Time [s] from the first sample of the homing; None if the path has no time. Rows of a long homing are farther
        apart than rows of the path, by a thousandth of its voltage range at most where it moves; between rows the
        voltage is linear.
    phase : (n,) array
        0 for the homing, 1 for the way to the path, 2 for the path.
    voltage : (n,) array
        Voltage [V], within limits and slew rate.
    displacement : (n,) array
        Wanted displacement of the axis [m, or `units`]; before the path, and for a given voltage, the model's
        displacement.
    expected : (n,) array
        Displacement of the model [m, or `units`]. It starts from the middle of the possible states; in a homing, where
        the true state is unknown, from a state after slow loops between the limits.
    clamped : (n,) bool array
        Samples whose voltage was changed to keep limits and slew rate.
    state : State *
        State of the actuator at the last sample.
    start : PossibleStart *
        The possible states before the homing.
    homing : Homing or None *
        The homing with its certificate; None if there is no homing.
    error : StartError *
        Error along the path due to the unknown start, from simulations of the whole voltage from all possible states.
    promise : Promise or None *
        Promised error of the path [m] from its start, with the error of clamped voltages; None if the model does not
        contain what its records tested.
    failure : str
        A sentence on how far the voltages miss the path and why, if farther than the promise (without one: a thousandth
        of the range of the spring's knots), or if limits clamp all voltages; else, and for a given voltage, "".
    warnings : tuple of str
        Remarks on the homing, on clamped voltages with the failure, on a delay, and on what the records do not test.
    temperature : (n,) array or None
        Temperature [degC] of the actuator; before the path that of the first sample. None if it is not known.
    units : str
        Unit of displacements, as in the compensator, by default "m". `state`, `start`, `homing`, `error` and `promise`
        are always in SI units.
    each : tuple of PathPlan
        The plan of each axis; empty for a single axis.
    """

    time: Array | None
    phase: NDArray[np.int8]
    voltage: Array
    displacement: Array
    expected: Array
    clamped: Mask
    state: Any
    start: Any
    homing: Any
    error: Any
    promise: Any
    failure: str
    warnings: tuple[str, ...]
    temperature: Array | None = None
    units: str = "m"
    each: tuple[PathPlan, ...] = ()

    @classmethod
    def of_axes(cls, names: Sequence[str], plans: Sequence[PathPlan]) -> PathPlan:
        """Return the plan of several axes from the plan of each."""

        def all_of(name: str) -> Any:
            return tuple(getattr(plan, name) for plan in plans)

        entries = ("state", "start", "homing", "error", "promise")
        joined: dict[str, Any] = {name: all_of(name) for name in entries}
        columns = ("voltage", "displacement", "expected", "clamped")
        joined |= {name: np.column_stack(all_of(name)) for name in columns}
        axes = list(zip(names, plans, strict=True))
        warnings = (f"{name}: {words}" for name, plan in axes for words in plan.warnings)
        warm = None if plans[0].temperature is None else np.column_stack(all_of("temperature"))
        return cls(
            plans[0].time,
            plans[0].phase,
            **joined,
            failure="; ".join(f"{name}: {plan.failure}" for name, plan in axes if plan.failure),
            warnings=tuple(warnings),
            temperature=warm,
            units=plans[0].units,
            each=tuple(plans),
        )

    @property
    def first(self) -> int:
        """Number of the first sample of the path."""
        return int(np.count_nonzero(self.phase != PATH))

    @property
    def missed(self) -> Any:
        """Largest distance of `expected` from the path [m, or `units`]; for several axes (axes,)."""
        return np.abs(self.expected - self.displacement)[self.first :].max(axis=0, initial=0.0)

    @property
    def left_open(self) -> StartError | None:
        """The error of a single axis due to the start; None if the start is known."""
        return None if self.homing is None and self.start.known else self.error

    @property
    def seconds(self) -> float | None:
        """Time [s] from the first sample to the first sample of the path; None if the path has no time."""
        return None if self.time is None else float(self.time[self.first] - self.time[0])

    @property
    def certified(self) -> bool:
        """Whether there is no homing, or it is certified, or its error along the path is below the model's error."""
        if self.each:
            return all(plan.certified for plan in self.each)
        return self.homing is None or self.homing.certified or not self.error.matters

    def in_units(self, units: str) -> PathPlan:
        """Return the plan of a single axis with its displacements converted from metres to `units`, such as "um"."""
        counts = per_metre(units)
        return replace(self, displacement=self.displacement * counts, expected=self.expected * counts, units=units)

    def __repr__(self) -> str:
        um, count = 1e6 / per_metre(self.units), int(np.count_nonzero(self.clamped[self.first :]))
        missed = length(float(np.max(self.missed)) / per_metre(self.units))
        facts = [
            counted(len(self.phase) - self.first, "sample"),
            *[f"{counted(self.first, 'sample')} before"] * (self.first > 0),
            span_of(self.voltage, "V"),
            span_of(self.displacement, "um", um),
            f"{count} clamped, missed by up to {missed}" if count else "nothing clamped",
        ]
        return f"<PathPlan: {', '.join(facts)}>"


def shortfall(voltage: Array, clamped: Mask, limits: VoltageLimits, missed: float, *, followed: bool) -> str:
    """Return a sentence on voltages (n,) [V] that miss the path by `missed` [m], or "" if none is needed.

    With clamped voltages, the sentence is a remark if the path is `followed`, else a failure.
    """
    if not clamped.any():
        # If no voltage is clamped, only the lag of a mass or an amplifier can cause an error.
        left_behind = (
            f"the path is missed by up to {missed * 1e6:.4g} um, though nothing was clamped: it does not begin at the "
            "actuator's state, or moves or turns too fast for its sample rate"
        )
        return "" if followed else left_behind
    count = int(np.count_nonzero(clamped))
    at_limit = int(np.count_nonzero(clamped & limits.reached(voltage)))
    words = (
        f"{count} of {voltage.size} voltages ({at_limit} at the limits {limits.words}, {count - at_limit} by the slew "
        f"rate), the first at sample {int(np.argmax(clamped))}; the path is missed by up to {missed * 1e6:.4g} um"
    )
    return f"clamped: {words}, less than what is promised" if followed else f"CLAMPED: {words}"
