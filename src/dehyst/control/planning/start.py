"""The possible states of an actuator before a motion, and the displacement error due to an unknown start."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import choice, vector
from dehyst.control.limits import outside_identified
from dehyst.control.planning.homing import middle_of, possible_states
from dehyst.model import Actuator, State, knots_of, state_within_limits, stroke_of, turned

StartName = Literal["top", "bottom", "relaxed"]
NAMES: tuple[str, ...] = get_args(StartName)
# Errors of a good model, as parts of the stroke: for a model file without an error, and the least one.
_MODEL_ERROR, _LEAST = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class PossibleStart:
    """The state before a motion, or states that bound it.

    Attributes
    ----------
    name : str
        "top", "bottom", "relaxed", "unknown", or the name of what was played before.
    states : tuple of State
        The state if it is known; else states that bound all possible states.
    remarks : tuple of str
        Remarks on the earlier voltages.
    """

    name: str
    states: tuple[State, ...]
    remarks: tuple[str, ...] = ()

    @property
    def known(self) -> bool:
        """Whether there is one possible state only."""
        return len(self.states) == 1

    @property
    def state(self) -> State:
        """The known state, or the middle of the possible states."""
        return self.states[0] if self.known else middle_of(self.states)

    def within(self, actuator: Actuator, limits: tuple[float, float] | None) -> State:
        """Return the state, or the nearest state within the `limits` [V], by default the limits of the `actuator`."""
        allowed = limits or actuator.limits
        return self.state if allowed is None else state_within_limits(actuator, self.state, allowed)

    def standing_at(self, actuator: Actuator, voltage: float) -> PossibleStart:
        """Return the start after a slow motion of the `actuator` to its present `voltage` [V]."""
        there = tuple(state_within_limits(actuator, state, (voltage, voltage)) for state in self.states)
        return replace(self, states=there)

    def error_along(
        self,
        actuator: Actuator,
        voltage: ArrayLike,
        limits: tuple[float, float] | None = None,
        *,
        time: ArrayLike | None = None,
        first: int = 0,
    ) -> StartError:
        """Return the error of a motion due to the start: the `actuator` is simulated from each possible state.

        `voltage`: (n,) [V]. If the history is unknown, the actuator rests at the first voltage, after voltages within
        the `limits` [V]. `time` (n,) [s]: needed with creep, dynamics or a lag. `first`: number of the first sample
        that counts, such as the one after a homing. Raise `ModelError` if the voltage is not finite, or the time or a
        state does not fit.
        """
        v, states = vector(voltage, "voltage"), self.states
        if self.name == "unknown" and v.size:
            states = possible_states(actuator, float(v[0]), limits)
        lowest, highest = np.full(v.size - first, np.inf), np.full(v.size - first, -np.inf)
        for state in states:
            y = actuator.simulate(v, time=time, state=state, extrapolate=True).displacement[first:]
            np.minimum(lowest, y, out=lowest)
            np.maximum(highest, y, out=highest)
        return StartError(lowest, highest, stroke_of(actuator), model_error(actuator))

    @classmethod
    def named(cls, actuator: Actuator, name: StartName) -> PossibleStart:
        """Return the start of an `actuator` by name; raise `ModelError` if it is unknown.

        `name`: turned at the "top" or "bottom" of the model's range, or "relaxed" at 0 V.
        """
        choice(name, "start", NAMES, error=ModelError)
        if name == "relaxed":
            return cls(name, (actuator.relaxed(),))
        rising = name == "top"
        return cls(name, (turned(actuator, knots_of(actuator)[rising], rising=rising),))

    @classmethod
    def unknown(cls, actuator: Actuator, voltage: float, limits: tuple[float, float] | None = None) -> PossibleStart:
        """Return the start at a `voltage` [V] if the history is unknown.

        Its states bound all states in which the `actuator` may rest there: two extreme states, or more if states have
        no order. `limits` [V]: range of all earlier voltages, for an actuator that depends on time; default: its
        limits. Raise `ModelError` if the voltage is not finite, or the limits are no interval.
        """
        return cls("unknown", possible_states(actuator, voltage, limits))

    @classmethod
    def after(
        cls,
        actuator: Actuator,
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        limits: tuple[float, float] | None = None,
        name: str = "history",
    ) -> PossibleStart:
        """Return the start of an `actuator` after a `voltage` (n,) [V] was played from an unknown state.

        `time` (n,) [s]: if the actuator needs it. `limits` [V]: range of all voltages before, as in `unknown`. `name`:
        name of the start. Raise `ModelError` if the voltage is empty, not finite or far outside of the model's range,
        or the time does not fit.
        """
        v = vector(voltage, "voltage")
        outside = outside_identified(actuator, v, limits, name=name)
        if not v.size:
            raise ModelError(argument="voltage", got="no samples", need="the voltages that were played before")
        before = possible_states(actuator, float(v[0]), limits)
        reached = tuple(actuator.simulate(v, time=time, state=state, extrapolate=True).state for state in before)
        return cls(name, reached, outside.warnings)


@dataclass(frozen=True, eq=False)
class StartError:
    """The error due to an unknown start: bounds of the displacement that a voltage causes from all possible states.

    Attributes
    ----------
    lowest, highest : (n,) array
        Bounds of the displacement [m]; with dynamics, bounds of its slow part, about which a mass may ring.
    stroke : float
        Displacement between the voltage limits [m], the reference of percentages.
    model_error : float
        Largest error of the model on its training records [m]; a thousandth of the stroke if this error is
        not known.
    """

    lowest: Array
    highest: Array
    stroke: float
    model_error: float

    def scaled(self, gain: Any, offset: Any) -> StartError:
        """Return the error of a displacement of `offset` plus `gain` times this one, each a number or (n,)."""
        if np.ndim(gain) == 0 and (gain, offset) == (1.0, 0.0):
            return self
        return replace(self, lowest=offset + gain * self.lowest, highest=offset + gain * self.highest)

    @property
    def difference(self) -> Array:
        """Highest minus lowest displacement (n,) [m]."""
        return self.highest - self.lowest

    def left_of(self, expected: Array) -> Array:
        """Return the largest distance (n,) from an `expected` displacement (n,), without its constant part [m]."""
        found = np.zeros_like(expected)
        for end in (self.lowest, self.highest):
            way = end - expected
            way -= way.sum() / max(expected.size, 1)
            np.maximum(found, np.abs(way, out=way), out=found)
        return found

    @property
    def largest(self) -> float:
        """Largest difference [m]."""
        return float(self.difference.max(initial=0.0))

    @property
    def matters(self) -> bool:
        """Whether the difference exceeds the model's error somewhere along the voltage."""
        return self.largest > self.model_error

    def percent(self, length: float) -> float:
        """Return a `length` [m] in % of the stroke."""
        return 100 * length / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "first_difference_percent": self.percent(float(self.difference[0])),
            "largest_difference_percent": self.percent(self.largest),
            "model_error_percent": self.percent(self.model_error),
        }


def model_error(actuator: Actuator) -> float:
    """Return the largest error [m] of the model on its records without noise, or its RMS error on held-out parts.

    A thousandth of the stroke if it is not known.
    """
    known, stroke = actuator.identification, stroke_of(actuator)
    if known.validity is None and known.largest_error is None:
        return _MODEL_ERROR * stroke
    own = known.validity
    return max(known.largest_error or 0.0 if own is None else max(own.largest, own.rms), _LEAST * stroke)
