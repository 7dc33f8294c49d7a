"""Decision rules: the thresholds by which an identification keeps a part, calls it noise, or refuses.

The page of the documentation is made from this class, by `benchmarks/pages.py`. Tolerances and numbers of steps of
solvers are not decisions and stay with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


def _rule(value: float, unit: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "reason": reason})


@dataclass(frozen=True)
class DecisionRules:
    """Thresholds of decisions; the metadata of each field are its `unit` and its `reason`."""

    longest_lag: float = _rule(0.05, "cycles", "Longest delay that is searched: a larger one has another cause.")
    shortest_lag: float = _rule(
        0.1, "samples", "Shorter delays are not found: straight lines between samples round turns as a delay does."
    )
    delay_gain: float = _rule(0.95, "ratio of errors", "A delay must lower residual and held-out error to this part.")
    lag_gain: float = _rule(0.97, "ratio of errors", "A first-order lag must lower the error of a delay to this part.")
    delay_alike: float = _rule(
        1.1, "ratio of residuals", "With slow creep, delays up to this ratio explain as much as the best one."
    )
    delay_as_good: float = _rule(
        1.03,
        "ratio of held-out errors",
        "Up to this ratio they also predict equally well; the best delay without creep is used.",
    )
    hopeless_delay: float = _rule(
        1.5,
        "ratio of residuals",
        "If ranges grow, a delay with a residual this many times the best one is not simulated.",
    )
    significant_delay: float = _rule(
        0.01, "samples", "A shorter delay or lag has no effect: a search rarely ends at 0."
    )
    amplifier_lag_gain: float = _rule(
        0.9,
        "ratio of errors",
        "With inertia, the amplifier's lag must lower the simulation error: it resembles a delay.",
    )
    delay_gain_at_turns: float = _rule(
        0.5, "ratio of errors", "Loops of one height and rate show a delay only at their turns."
    )
    one_height: float = _rule(0.9, "ratio of heights", "Loops are of one height: lowest leg over the highest.")
    found_delay: float = _rule(0.02, "samples", "A delay that only one of two searches finds must be longer.")

    datum_gain: float = _rule(
        0.8,
        "ratio of residuals",
        "A new sensor zero lowers the residual at once; a smaller gain comes from the model's shape.",
    )
    drift_gain: float = _rule(
        0.97, "ratio of residuals", "A drift is removed if it lowers the RMS residual to this part."
    )
    smallest_gain: float = _rule(
        1e-05, "part of the stroke", "A repair must lower the RMS residual by at least this much."
    )
    fewest_cycles: float = _rule(3, "cycles", "Fewer do not separate a drift from hysteresis.")
    drift_prediction_gain: float = _rule(
        0.95,
        "ratio of held-out errors",
        "A drift must predict held-out time; a remark follows if creep predicts it too.",
    )
    steady_drift_gain: float = _rule(
        0.97, "ratio of residuals", "A linear drift replaces a logarithmic one at this gain."
    )
    creep_at_start_gain: float = _rule(
        0.9, "ratio of residuals", "Creep from before a record is fitted if it lowers the residual to this part."
    )
    carts_alone_gain: float = _rule(
        0.5,
        "ratio of squares",
        "A record may begin with sliders where no history leads to, or strained smooth elements, at this gain.",
    )
    speed_ratio: float = _rule(
        3.0, "ratio of speeds", "Legs alike in height at speeds this far apart distinguish creep from hysteresis."
    )
    least_leg: float = _rule(0.1, "part of the voltage's range", "Smaller legs do not count as legs at two speeds.")
    legs_alike: float = _rule(1.5, "ratio of heights", "Legs are alike up to this ratio of their heights.")
    hold_span: float = _rule(0.005, "part of the voltage's range", "A voltage that stays within it holds.")
    hold_gain: float = _rule(
        0.9, "ratio of errors", "Creep in displacement must lower the drift that is left in held-out holds so far."
    )
    force_gain: float = _rule(
        0.8,
        "ratio of errors",
        "Creep as a force must leave so much less than in displacement: taken wrongly it costs more.",
    )
    slowest_lag: float = _rule(0.05, "cycles", "A response faster than this is a lag, not creep.")
    coarse_voltage: float = _rule(
        0.002, "part of the voltage's range", "Larger steps of the voltage hide holds; no such model is ready."
    )
    creep_at_once: float = _rule(
        0.3, "part of a step", "A larger growth within a twentieth of a cycle is a low-pass, because creep is slow."
    )
    most_creep: float = _rule(
        20.0, "% of the stroke a decade", "Piezoelectric actuators creep by a few percent; more has another cause."
    )
    fewest_decades: float = _rule(0.5, "decades", "A rate from a smaller part of a decade is an extrapolation.")

    slowest_cycle: float = _rule(1000.0, "samples a cycle", "In slower cycles inertia does not show.")
    mass_gain: float = _rule(
        0.95, "ratio of residuals", "One of a few masses must explain more before inertia is searched."
    )
    inertia_gain: float = _rule(0.8, "ratio of residuals", "Inertia can filter noise: it must explain much.")
    excited: float = _rule(
        1e-07,
        "part of the voltage's energy",
        "Less above half the resonance does not excite it: noise would be fitted.",
    )
    resonance_gain: float = _rule(0.97, "ratio of simulation errors", "Another round of tuning must lower the error.")

    part_gain: float = _rule(
        0.97, "ratio of held-out errors", "A part must lower the error to this ratio; a smaller gain may be noise."
    )
    transformer_gain_with_grades: float = _rule(
        0.8,
        "ratio of held-out errors",
        "Graded elements and a transformer have similar effects, which cycles hardly distinguish.",
    )
    prediction_loss: float = _rule(
        1.2,
        "ratio of held-out errors",
        "Creep or inertia stays if the held-out error without it is this many times larger.",
    )
    longer_reach: float = _rule(
        1.25, "half strokes", "Thresholds up to here are tried where loops grow: such elements slide once."
    )
    longer_gain: float = _rule(
        0.6, "ratio of simulation errors", "Longer thresholds must lower the error of whole records to this part."
    )
    growing: float = _rule(
        0.5, "part of the samples", "A record grows if fewer of its samples come after its range was widest."
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

    quiet: float = _rule(0.0003, "part of the range", "Less noise has no effect on elements.")
    loud: float = _rule(0.002, "part of the range", "More noise drags elements back and forth: their loops get narrow.")
    first_element_noise: float = _rule(
        30, "standard deviations", "The stiffness of an element with a smaller threshold is estimated too small."
    )

    check_risk: float = _rule(0.05, "probability", "Noise alone exceeds the floor of a check this often.")
    smallest_pattern: float = _rule(
        0.1, "% of the stroke", "Smaller patterns are below the resolution of a record with 50 samples per cycle."
    )
    smallest_drift: float = _rule(0.0002, "part of the stroke a decade", "A smaller drift is not reported.")
    voltage_margin: float = _rule(0.02, "part of the limits' range", "Held-out voltages may go beyond by this part.")
    usual_error: float = _rule(2, "ratio of errors", "Held-out records missed this many times as far are remarked.")
    end_of_limits: float = _rule(
        0.1,
        "part of the limits' range",
        "The outer part at each end, where samples may be rare or all inner loops turn.",
    )
    least_passage: float = _rule(0.25, "passages", "Fewer samples than this part of one passage through it are rare.")
    line_power: float = _rule(
        0.05, "part of the power", "A line of a residual's spectrum with more power is a vibration."
    )
    line_height: float = _rule(20.0, "ratio of powers", "The line must also exceed its neighbours by this ratio.")
    driven_line: float = _rule(
        0.0001,
        "ratio of powers",
        "A line with more power, relative to the voltage's strongest line, belongs to the voltage.",
    )
    periodic: float = _rule(0.5, "part of the power", "A voltage is periodic if one line holds this part of its power.")
    fewest_periods: float = _rule(6, "cycles", "Harmonics are looked for if a record has as many cycles of that line.")

    useless: float = _rule(5.0, "% of the stroke", "A model with a larger expected error is not usable.")
    most_set_aside: float = _rule(0.1, "part of the samples", "If more was set aside, the model is usable with care.")
    widest_gap: float = _rule(
        2.0, "ratio of errors", "Validation records missed this many times as far: the model is usable with care."
    )
    peak: float = _rule(3.0, "RMS errors", "The largest error of a path is this many RMS errors at least.")
    noise_known: float = _rule(0.1, "part of the noise", "The subtracted noise is known to this accuracy.")
    about_as_good: float = _rule(
        1.3,
        "ratio of held-out errors",
        "Structures up to this ratio of the least held-out error count for the disagreement.",
    )
    failed_fit: float = _rule(0.2, "part of the stroke", "A larger disagreement indicates a failed fit.")


RULES = DecisionRules()
