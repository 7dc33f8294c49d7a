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
        0.1, "samples", "Shorter delays are not found: straight lines between samples round turns as a delay does."
    )
    moving_gain: float = _rule(
        0.95,
        "ratio of held-out errors",
        "Delay, drift, thermal expansion must lower the held-out error to this.",
    )
    lag_gain: float = _rule(0.97, "ratio of errors", "A first-order lag must lower the error of a delay to this part.")
    zero_gain: float = _rule(
        0.8,
        "ratio of residuals",
        "A new sensor zero lowers the residual at once; a smaller gain comes from the model's shape.",
    )
    apart: float = _rule(
        0.5,
        "% of the stroke",
        "Without an offset of voltages, a record missed by more is another stage's.",
    )
    fewest_cycles: float = _rule(3, "cycles", "Fewer do not separate a drift from hysteresis.")
    carts_alone_gain: float = _rule(
        0.5,
        "ratio of squares",
        "A record may begin with sliders where no history leads to, or strained smooth elements, at this gain.",
    )
    coarse_voltage: float = _rule(
        0.002, "part of the voltage's range", "Larger steps of the voltage hide holds; no such model is ready."
    )
    most_creep: float = _rule(
        20.0, "% of the stroke a decade", "Piezoelectric actuators creep by a few percent; more has another cause."
    )
    slowest_cycle: float = _rule(1000.0, "samples a cycle", "In slower cycles inertia does not show.")
    inertia_gain: float = _rule(
        0.7, "ratio of held-out errors", "A resonance can filter noise: it must predict held-out time much better."
    )
    damped: float = _rule(0.4, "damping", "More damping is no resonance, but a lag.")
    creep_gain: float = _rule(0.85, "ratio of held-out errors", "Where the voltage rests, creep must predict better.")
    hidden_creep_gain: float = _rule(
        0.6, "ratio of held-out errors", "Where the voltage never rests, creep can follow a drift or the loops' memory."
    )
    static_gain: float = _rule(
        0.95, "ratio of held-out errors", "A transformer, or elements that yield gradually, must predict better."
    )
    excited: float = _rule(
        1e-07,
        "part of the voltage's energy",
        "Less above half the resonance does not excite it: noise would be fitted.",
    )
    determined: float = _rule(
        0.1,
        "singular value",
        "Least singular value of a determined direction, relative to the largest, times N squared.",
    )
    temperatures: float = _rule(2.0, "K", "A smaller range of temperatures does not show their effect.")
    temperature_helps: float = _rule(
        0.9,
        "ratio of held-out errors",
        "Gain and offset by temperature must lower the error at held-out temperatures to this part.",
    )
    loud: float = _rule(0.002, "part of the range", "More noise drags elements back and forth: their loops get narrow.")
    useless: float = _rule(USELESS, "% of the stroke", "A model with a larger expected error is not usable.")
    most_set_aside: float = _rule(0.1, "part of the samples", "If more was left out, the model is usable with care.")


RULES = DecisionRules()
