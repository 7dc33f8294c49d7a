"""The state in which a model starts, and warnings about what a voltage file does not contain."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import click

if TYPE_CHECKING:
    from dehyst.model import Actuator, State

# Voltages farther outside of a model's limits than this part of their range were not covered by its records.
_FAR = 0.1


class Request(NamedTuple):
    """What a command that computes voltages is asked for: of which model, within what, from which state."""

    actuator: Actuator
    limits: tuple[float, float] | None
    slew: float | None
    start: str
    as_json: bool


def start_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option that selects the state in which a model starts."""
    return click.option(
        "--start",
        type=click.Choice(["top", "bottom", "relaxed", "homed"]),
        default="top",
        show_default=True,
        help="State before the first sample: turned at the top or bottom of the identified range, relaxed at 0 V, or "
        "as after 'dehyst excite homing --model' without other options; another --base or --hold ends in another "
        "state.",
    )(command)


def start_within(actuator: Actuator, start: str, limits: tuple[float, float] | None) -> State:
    """Return the state that the option names, or the nearest one within the limits."""
    from dehyst.control.reachable import state_within_limits

    state, allowed = start_state(actuator, start), limits or actuator.limits
    return state if allowed is None else state_within_limits(actuator, state, allowed)


def start_state(actuator: Actuator, start: str) -> State:
    """Return the state that the option names."""
    knots = actuator.spring.displacement
    if start == "relaxed":
        return actuator.relaxed()
    if start == "homed":
        return _homed(actuator)
    return actuator.turned(float(knots[-1])) if start == "top" else actuator.turned(float(knots[0]), rising=False)


def _homed(actuator: Actuator) -> State:
    """Return the state after the homing voltage that `dehyst excite homing` writes by default."""
    from dehyst.control import shortest_homing
    from dehyst.waveforms import Sampling

    low, high = actuator.limits or (0.0, 0.0)
    end = min(max(0.0, low), high)
    return shortest_homing(actuator, present=end, stiff_only=True, drive=Sampling()).state


def start_words(actuator: Actuator, start: str, state: State | None = None) -> str:
    """Describe the state before the first sample, in brackets; by default the one that the option names."""
    voltage = f"{actuator.voltage(start_within(actuator, start, None) if state is None else state):.4g} V"
    words = {"relaxed": f"(from rest, relaxed, at {voltage})", "homed": f"(homed, at {voltage})"}
    return words.get(start, f"(coming from the {start}, {voltage})")


def state_dict(state: State) -> dict[str, Any]:
    """Return a state as JSON values."""
    more = {"creep_m": state.creep, "motion_m_and_m_per_s": state.motion}
    return {
        "displacement_m": state.displacement,
        "carts_m": state.carts.tolist(),
        **{name: values.tolist() for name, values in more.items() if values.size},
    }


def lagging(displacement: Any, actuator: Actuator, time: dict[str, Any]) -> Any:
    """Return the displacement as a sensor shows it, late by the actuator's delay."""
    import numpy as np

    from dehyst._errors import FileFormatError

    if "time_s" not in time:
        raise FileFormatError("--lag needs the time of each sample: a time column, or --sample-rate")
    return np.interp(time["time_s"] - actuator.delay, time["time_s"], displacement)


def file_warnings(actuator: Actuator, first: float, start: str, state: State, slew: float | None) -> list[str]:
    """Warn of what the file does not contain: the ramp to its first voltage, earlier creep and the delay."""
    warnings = []
    present = actuator.voltage(state)
    if abs(first - present) > 0.01 * max(abs(value) for value in (present, *(actuator.limits or ()))):
        within = "slowly" if slew is None else "within the slew rate"
        warnings.append(
            f"the first voltage, {first:.6g} V, is {abs(first - present):.6g} V away from that of the start, "
            f"{present:.6g} V: ramp there {within} before you play the file"
        )
    if actuator.creep is not None and start != "homed":
        longest = float(actuator.creep.time_constants[-1])
        warnings.append(
            f"this model creeps, and --start {start} assumes that the actuator has rested there for much longer than "
            f"{longest:.3g} s; otherwise the displacement will be off: play a homing (dehyst excite homing --model) "
            "and use --start homed"
        )
    return [*warnings, *delay_warnings(actuator)]


def delay_warnings(actuator: Actuator) -> list[str]:
    """Warn of the delay of the stage, if it has one."""
    if not actuator.delay:
        return []
    return [f"the measured displacement lagged by {actuator.delay * 1e3:.4g} ms: expect it that much later"]


def outside_warnings(actuator: Actuator, voltage: Any) -> tuple[int, bool, list[str]]:
    """Count the voltages [V] outside the identified range; return whether one lies far outside, and warnings.

    Far is more than a tenth of the range away: there the model is a straight line without any measurement behind it.
    """
    import numpy as np

    if actuator.limits is None:
        return 0, False, []
    low, high = actuator.limits
    beyond = np.maximum(low - voltage, voltage - high)
    count = int(np.count_nonzero(beyond > 0))
    if not count:
        return 0, False, []
    warning = (
        f"{count} of {voltage.size} voltages lie outside the identified range {low:.6g} to {high:.6g} V: extrapolated"
    )
    far = float(beyond.max()) > _FAR * (high - low)
    if far:
        warning += (
            f", and far: {float(voltage[int(np.argmax(beyond))]):.6g} V lies {float(beyond.max()):.6g} V beyond, "
            f"more than {100 * _FAR:.0f} % of the range. Nothing was measured there: record these voltages and "
            "identify again"
        )
    return count, far, [warning]
