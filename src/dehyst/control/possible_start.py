"""What is known of an actuator's state before a motion: named, left by earlier voltages, or unknown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._validation import choice, vector
from dehyst.control.homing import shortest_homing
from dehyst.control.possible_states import middle_of, possible_states
from dehyst.model import Actuator, State
from dehyst.waveforms import Sampling

StartName = Literal["top", "bottom", "relaxed", "homed"]
NAMES: tuple[str, ...] = get_args(StartName)


@dataclass(frozen=True, eq=False)
class PossibleStart:
    """The state before a motion, or the states that bound it.

    Attributes
    ----------
    name : str
        "top", "bottom", "relaxed", "homed", "unknown", or the name of what led there.
    states : tuple of State
        One if the state is known; else states that bound all possible ones.
    """

    name: str
    states: tuple[State, ...]

    @property
    def known(self) -> bool:
        """Whether there is one possible state only."""
        return len(self.states) == 1

    @property
    def state(self) -> State:
        """The state, or the middle of the possible ones."""
        return middle_of(self.states)

    @classmethod
    def named(cls, actuator: Actuator, name: StartName) -> PossibleStart:
        """Return the state of a name.

        `actuator`: the model. `name`: turned at the "top" or "bottom" of the identified range; "relaxed" at 0 V; or
        "homed", as after the voltage that ``dehyst excite homing --model`` writes by default. Raise `ModelError` for
        another name, or if the actuator cannot be homed, for it has no limits.
        """
        choice(name, "start", NAMES, error=ModelError)
        knots = actuator.spring.displacement
        if name == "relaxed":
            return cls(name, (actuator.relaxed(),))
        if name == "homed":
            return cls(name, (_homed(actuator),))
        rising = name == "top"
        return cls(name, (actuator.turned(float(knots[-1 if rising else 0]), rising=rising),))

    @classmethod
    def unknown(cls, actuator: Actuator, voltage: float, limits: tuple[float, float] | None = None) -> PossibleStart:
        """Return the states at a `voltage` [V] if nothing is known of what was before.

        They bound all those in which the `actuator` may stand there: two extreme states, or more if states keep no
        order. `limits` [V]: range of all earlier voltages, for an actuator that moves in time; default its
        `voltage_range`. Raise `ModelError` if the voltage is not finite, or the limits are no interval.
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
        """Return the states after a voltage that was played from an unknown state.

        Parameters
        ----------
        actuator : Actuator
        voltage : (n,) array_like
            [V].
        time : (n,) array_like, optional
            [s], if the actuator needs it.
        limits : (float, float), optional
            Range of all voltages before these, as in `unknown`.
        name : str, optional
            Of the start.

        Raises
        ------
        ModelError
            If there is no voltage, it is not finite, or the time does not fit.
        """
        v = vector(voltage, "voltage")
        if not v.size:
            raise ModelError("voltage: got no samples, need those that were played before")
        when = time if actuator.needs_time else None
        before = possible_states(actuator, float(v[0]), limits)
        return cls(
            name, tuple(actuator.simulate(v, time=when, state=state, extrapolate=True).state for state in before)
        )


def _homed(actuator: Actuator) -> State:
    """Return the state after the homing voltage that `dehyst excite homing` writes by default."""
    low, high = actuator.limits or (0.0, 0.0)
    end = min(max(0.0, low), high)
    return shortest_homing(actuator, present=end, stiff_only=True, drive=Sampling()).state
