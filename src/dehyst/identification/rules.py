"""Decision rules: the thresholds by which an identification keeps a part, calls it noise, or refuses.

The page of the documentation is made from this class, by `benchmarks/pages.py`. Tolerances and numbers of steps of
solvers are not decisions and stay with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from dehyst.model import USELESS


def _rule(value: float, unit: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class DecisionRules:
    """Thresholds of decisions; the metadata of each field are its `unit` and its `reason`."""

    longest_lag: float = _rule(0.05, "cycles", "Longest delay that is searched: a larger one has another cause.")
    shortest_lag: float = _rule(
        0.1, "samples", "Shorter delays cannot be found: straight lines between samples also round the turns."
    )
    moving_gain: float = _rule(
        0.95, "ratio of held-out errors", "A delay, drift or thermal expansion must lower the held-out error to this."
    )
    lag_gain: float = _rule(0.97, "ratio of errors", "A first-order lag must lower the error of a delay to this.")
    zero_gain: float = _rule(
        0.8,
        "ratio of residuals",
        "A new zero of the sensor lowers the residual to this; an error of the model lowers it less.",
    )
    apart: float = _rule(
        0.5, "% of the stroke", "A larger error, without an offset of the voltage, shows a record of another stage."
    )
    fewest_cycles: float = _rule(3, "cycles", "Fewer cycles do not separate a drift from hysteresis.")
    carts_alone_gain: float = _rule(
        0.5,
        "ratio of squares",
        "A start that no history explains, or with strained smooth elements, must lower the squares to this.",
    )
    coarse_voltage: float = _rule(
        0.002, "part of the voltage's range", "Larger steps of the voltage hide holds: the verdict is at best usable."
    )
    most_creep: float = _rule(
        20.0,
        "% of the stroke a decade",
        "Piezoelectric actuators creep by a few percent; a larger creep has another cause.",
    )
    slowest_cycle: float = _rule(1000.0, "samples a cycle", "Slower cycles do not show inertia.")
    inertia_gain: float = _rule(
        0.7, "ratio of held-out errors", "A resonance can fit noise: it must predict held-out time much better."
    )
    damped: float = _rule(0.4, "damping", "A motion with more damping is a lag, not a resonance.")
    creep_gain: float = _rule(0.85, "ratio of held-out errors", "If the voltage rests, creep must predict better.")
    hidden_creep_gain: float = _rule(
        0.6, "ratio of held-out errors", "If the voltage never rests, creep can imitate a drift or the loops' memory."
    )
    static_gain: float = _rule(
        0.95, "ratio of held-out errors", "A transformer, or elements that yield gradually, must predict better."
    )
    excited: float = _rule(
        1e-07, "part of the voltage's energy", "With less energy above half the resonance, the fit would follow noise."
    )
    determined: float = _rule(
        0.1,
        "singular value",
        "The records determine a direction with a larger value (relative to the largest, times N squared).",
    )
    temperatures: float = _rule(2.0, "K", "A smaller range of temperatures does not show their effect.")
    temperature_helps: float = _rule(
        0.9,
        "ratio of held-out errors",
        "Gain and offset by temperature must lower the error at held-out temperatures to this.",
    )
    loud: float = _rule(0.002, "part of the range", "More noise moves the elements: their loops become narrow.")
    useless: float = _rule(USELESS, "% of the stroke", "A model with a larger expected error is not usable.")
    most_set_aside: float = _rule(0.1, "part of the samples", "If more is left out, the verdict is usable with care.")


RULES = DecisionRules()
