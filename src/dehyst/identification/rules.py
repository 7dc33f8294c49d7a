"""Decision rules: the thresholds by which an identification keeps a part, calls it noise, or refuses.

`benchmarks/pages.py` makes a page of the documentation from this class. Tolerances and numbers of steps of solvers are
not decisions and stay in the files of the solvers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dehyst.model import USELESS


def _rule(value: float, unit: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class DecisionRules:
    """Thresholds of decisions; the metadata of each field hold a `unit` and a `reason`."""

    longest_lag: float = _rule(0.05, "cycles", "A longer delay has another cause.")
    shortest_lag: float = _rule(0.1, "samples", "Shorter delays look like the straight lines between samples.")
    moving_gain: float = _rule(
        0.95, "ratio of held-out errors", "A delay, drift or thermal expansion must lower the held-out error to this."
    )
    lag_gain: float = _rule(0.97, "ratio of errors", "A first-order lag must lower the error of a delay to this.")
    zero_gain: float = _rule(
        0.8,
        "ratio of residuals",
        "A new zero of the sensor must lower the residual to this; with a wrong model it does not.",
    )
    apart: float = _rule(
        0.5, "% of the stroke", "A larger error, without a voltage offset, shows a record of another stage."
    )
    fewest_cycles: float = _rule(3, "cycles", "Fewer cycles do not separate a drift from hysteresis.")
    carts_alone_gain: float = _rule(
        0.5,
        "ratio of squares",
        "A start that no history explains, or with strained smooth elements, must lower the sum of squares to this.",
    )
    coarse_voltage: float = _rule(
        0.002, "part of the voltage's range", "Larger steps of the voltage hide holds: the model is at best usable."
    )
    most_creep: float = _rule(
        20.0,
        "% of the stroke per decade",
        "Piezoelectric actuators creep by a few percent; a larger drift has another cause.",
    )
    slowest_cycle: float = _rule(1000.0, "samples a cycle", "Slower cycles do not show inertia.")
    inertia_gain: float = _rule(
        0.7, "ratio of held-out errors", "A resonance can fit noise: it must lower the error to this."
    )
    damped: float = _rule(0.4, "damping", "A motion with more damping is a lag, not a resonance.")
    creep_gain: float = _rule(0.85, "ratio of held-out errors", "With rests, creep must lower the error to this.")
    hidden_creep_gain: float = _rule(
        0.6, "ratio of held-out errors", "Without rests of the voltage, creep can imitate a drift or hysteresis."
    )
    static_gain: float = _rule(
        0.95, "ratio of held-out errors", "A transformer, or smooth elements, must lower the held-out error to this."
    )
    excited: float = _rule(
        1e-07, "part of the voltage's energy", "With less energy above half the resonance, the fit would follow noise."
    )
    determined: float = _rule(
        0.1,
        "singular value",
        "The records determine a direction if its singular value, over the largest and times N squared, is larger.",
    )
    temperatures: float = _rule(2.0, "K", "A smaller range of temperatures does not show their effect.")
    temperature_helps: float = _rule(
        0.9,
        "ratio of held-out errors",
        "Gain and offset by temperature must lower the error at held-out temperatures to this.",
    )
    loud: float = _rule(0.002, "part of the range", "More noise moves the elements and makes their loops narrow.")
    useless: float = _rule(USELESS, "% of the stroke", "A model with a larger expected error is not usable.")
    most_set_aside: float = _rule(0.1, "part of the samples", "If more is left out, the model is usable with care.")


RULES = DecisionRules()
