"""Decision rules: the thresholds by which an identification keeps a part, calls it noise, or refuses.

The page of the documentation is made from this class, by `benchmarks/pages.py`. Tolerances and numbers of steps of
solvers are not decisions and stay with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field


def _rule(value: float, unit: str, reason: str) -> float:
    """Return a field with its unit and reason."""
    found: float = field(default=value, metadata={"unit": unit, "reason": reason})
    return found


@dataclass(frozen=True)
class DecisionRules:
    """Thresholds of decisions; the metadata of each field are its `unit` and its `reason`."""

    longest_lag: float = _rule(
        0.05, "cycles", "Longest delay that is searched: a displacement that lags by more has another cause."
    )
    shortest_lag: float = _rule(
        0.1,
        "samples",
        "A shorter delay is none: the straight lines between samples round the turns of the voltage as well.",
    )
    delay_gain: float = _rule(
        0.95, "ratio of errors", "A delay must lower both the residual and the held-out error to this part."
    )
    lag_gain: float = _rule(
        0.97, "ratio of errors", "A lag of first order must lower them to this part of those with a delay in its place."
    )
    delay_alike: float = _rule(
        1.1,
        "ratio of residuals",
        "Slow creep leaves a delay open: up to this ratio a delay explains as much as the best one.",
    )
    delay_as_good: float = _rule(
        1.03,
        "ratio of held-out errors",
        "Up to this ratio it also predicts as well, and the one that explains most without creep is taken.",
    )
    hopeless_delay: float = _rule(
        1.5,
        "ratio of residuals",
        "Where ranges grow, a delay with a residual this many times the best is not simulated.",
    )
    significant_delay: float = _rule(
        0.01, "samples", "A shorter delay or lag has no effect in a record; a search rarely ends at 0."
    )
    amplifier_lag_gain: float = _rule(
        0.9,
        "ratio of errors",
        "With inertia, the lag of an amplifier must lower the simulation error to this part: it looks much "
        "like a delay.",
    )
    delay_gain_at_turns: float = _rule(
        0.5,
        "ratio of errors",
        "Loops of one height and rate show a delay only at their turns: there it must lower the residual to this part.",
    )
    one_height: float = _rule(
        0.9, "ratio of heights", "Loops are of one height if the lowest leg is this part of the highest or more."
    )
    found_delay: float = _rule(0.02, "samples", "A delay that is found by one search alone must be longer.")
    datum_gain: float = _rule(
        0.8, "ratio of residuals", "A sensor that was zeroed anew shows at once; a smaller gain is the model bending."
    )
    drift_gain: float = _rule(
        0.97, "ratio of residuals", "A drift is set aside if it lowers the RMS residual to this part."
    )
    smallest_gain: float = _rule(
        1e-05, "part of the stroke", "A repair that lowers the RMS residual by less is not worth a coefficient."
    )
    fewest_cycles: float = _rule(3, "cycles", "Fewer do not separate a drift from hysteresis.")
    drift_prediction_gain: float = _rule(
        0.95,
        "ratio of held-out errors",
        "A drift must lower the error of held-out time to this part; creep that does the same is remarked.",
    )
    steady_drift_gain: float = _rule(
        0.97,
        "ratio of residuals",
        "A drift in proportion to time replaces one by its logarithm if it lowers the residual to this part.",
    )
    creep_at_start_gain: float = _rule(
        0.9, "ratio of residuals", "A record crept as it began if that lowers the residual to this part."
    )
    carts_alone_gain: float = _rule(
        0.5,
        "ratio of squares",
        "Carts that no history leads to are taken at a record's start if they lower the squares to this part.",
    )
    speed_ratio: float = _rule(
        3.0,
        "ratio of speeds",
        "Legs alike in height distinguish creep from hysteresis if the fastest is this many times as fast as "
        "the slowest.",
    )
    least_leg: float = _rule(0.1, "part of the voltage's range", "Smaller legs do not count as legs at two speeds.")
    legs_alike: float = _rule(
        1.5, "ratio of heights", "Legs are alike up to this ratio: what differs more in height is another loop."
    )
    hold_span: float = _rule(0.005, "part of the voltage's range", "A voltage that stays within it holds.")
    slowest_lag: float = _rule(0.05, "cycles", "What follows sooner than this is a lag, not creep.")
    coarse_voltage: float = _rule(
        0.002,
        "part of the voltage's range",
        "Larger steps of the voltage hide holds, and keep a model from being ready.",
    )
    creep_at_once: float = _rule(
        0.3, "part of a step", "Creep is slow: what grows by more within a twentieth of a cycle is a low-pass."
    )
    most_creep: float = _rule(
        20.0,
        "% of the range a decade",
        "Piezoelectric actuators creep by a few percent a decade: a larger drift has another cause.",
    )
    fewest_decades: float = _rule(0.5, "decades", "A rate from a smaller part of a decade of time is an extrapolation.")
    slowest_cycle: float = _rule(
        1000.0, "samples a cycle", "Inertia is searched only in faster cycles: it does not show in slower ones."
    )
    mass_gain: float = _rule(
        0.95,
        "ratio of residuals",
        "One of a few masses must lower the residual to this part before inertia is searched.",
    )
    inertia_gain: float = _rule(
        0.8, "ratio of residuals", "Inertia must lower the residual to this part: it can filter the sensor's noise."
    )
    excited: float = _rule(
        1e-07,
        "part of the voltage's energy",
        "A voltage with less energy above half the resonance does not excite it: noise would be fitted.",
    )
    resonance_gain: float = _rule(
        0.97, "ratio of simulation errors", "Another round of tuning must lower the simulation error to this part."
    )
    part_gain: float = _rule(
        0.97,
        "ratio of held-out errors",
        "A part must lower the held-out error to this part: a smaller gain may be noise.",
    )
    transformer_gain_with_grades: float = _rule(
        0.8,
        "ratio of held-out errors",
        "A transformer bends what graded elements can bend too; held-out cycles hardly show which of them does.",
    )
    prediction_loss: float = _rule(
        1.2,
        "ratio of held-out errors",
        "Creep or inertia stays only if held-out time is missed this many times as far without it.",
    )
    longer_reach: float = _rule(
        1.25, "half strokes", "Thresholds up to here are tried where loops grow: such elements slide once."
    )
    longer_gain: float = _rule(
        0.6, "ratio of simulation errors", "They must lower the error of the records simulated whole to this part."
    )
    growing: float = _rule(
        0.5,
        "part of the samples",
        "The range of a record grows if a smaller part of its samples comes after it was widest.",
    )
    refinement_gain: float = _rule(
        0.99,
        "ratio of simulation errors",
        "A refinement is kept if it lowers the error of held-out cycles to this part.",
    )
    determined: float = _rule(
        0.1,
        "singular value",
        "Least singular value of a determined direction as a part of the largest, times N squared: determined "
        "ones fall with the square of N.",
    )
    quiet: float = _rule(0.0003, "part of the range", "Less noise has no effect on elements.")
    loud: float = _rule(
        0.002, "part of the range", "More noise narrows the loops of elements: it drags them back and forth."
    )
    first_element_noise: float = _rule(
        30,
        "standard deviations",
        "An element with a smaller threshold is remarked: its stiffness is estimated too small.",
    )
    check_risk: float = _rule(0.05, "probability", "Noise alone exceeds the floor of a check this often.")
    smallest_pattern: float = _rule(
        0.1, "% of the range", "A smaller value does not matter: a record of 50 samples a cycle has this resolution."
    )
    smallest_drift: float = _rule(0.0002, "part of the stroke a decade", "A smaller drift is not reported.")
    voltage_margin: float = _rule(
        0.02, "part of the limits' range", "Held-out voltages may leave those of training by this part."
    )
    usual_error: float = _rule(
        2, "ratio of errors", "Larger errors of held-out records than this many times those of training are remarked."
    )
    end_of_limits: float = _rule(
        0.1,
        "part of the limits' range",
        "The outer part at each end, where samples may be rare and inner loops may all turn.",
    )
    least_passage: float = _rule(
        0.25, "passages", "Fewer samples than this part of one passage through it are remarked."
    )
    line_power: float = _rule(
        0.05, "part of the power", "A line of a residual's spectrum is a vibration if it holds this part of its power."
    )
    line_height: float = _rule(
        20.0, "ratio of powers", "It must also hold this many times the power of its neighbours."
    )
    driven_line: float = _rule(
        0.0001, "ratio of powers", "A line is the voltage's if the voltage has this part of its strongest line there."
    )
    periodic: float = _rule(0.5, "part of the power", "A voltage is periodic if one line holds this part of its power.")
    fewest_periods: float = _rule(6, "cycles", "Harmonics are looked for if a record has as many cycles of that line.")
    useless: float = _rule(5.0, "% of the stroke", "A model with a larger expected error is not usable.")
    most_set_aside: float = _rule(0.1, "part of the samples", "If more was set aside, the model is usable with care.")
    widest_gap: float = _rule(
        2.0,
        "ratio of errors",
        "If validation records are missed by more than this many times training records, the model is usable "
        "with care.",
    )
    peak: float = _rule(3.0, "RMS errors", "The largest error of a path is this many RMS errors at least.")
    noise_known: float = _rule(0.1, "part of the noise", "What is subtracted as noise is known to this part.")
    about_as_good: float = _rule(
        1.3,
        "ratio of held-out errors",
        "Structures up to this ratio of the least error explain the records: their disagreement counts.",
    )
    failed_fit: float = _rule(0.2, "part of the stroke", "A larger disagreement is that of a fit that failed.")


RULES = DecisionRules()
