"""Messages of an identification: what the records leave open, and what was repaired, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._types import Array
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.identification.preprocessing.denoising import significant_delay
from dehyst.identification.preprocessing.preparation import Prepared, counted_samples
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.results import RecordErrors
from dehyst.identification.rules import RULES
from dehyst.model import Outcome
from dehyst.records import turning_points
from dehyst.waveforms import Sampling

# Fewer turns are no protocol.
_FEWEST_TURNS = 4
# A proposed hold in multiples of the least that shows creep.
_AMPLE = 1.05

LONGER_ELEMENTS = (
    "The loops grow. Elements that slide once only, as the range gets wider, lower the error of the records simulated "
    "whole: they are in the model."
)
STEPS = (
    "After steps of the voltage the displacement rings or overshoots. The expected error holds for paths without "
    "steps. If ringing changes the hysteresis state, the error is larger until the next full loop."
)
# `options`: those that were given.
NOT_SEARCHED = (
    "No other parts than slip elements and a spring were tried, as {options} of these were given. Without, "
    "cross-validation selects the parts."
)
# What a step of {percent} that follows at once is.
FALSE_CREEP = (
    "Creep was found and left out: {percent:.0f} % of a step would follow within a twentieth of a cycle, which is a "
    "low-pass filter of the sensor or of the amplifier, not creep."
)
DRIFT_OR_CREEP = (
    "A drift was set aside. Creep predicts held-out parts of the records equally well: the records cannot distinguish "
    "the two. {hold}"
)
# `first` and `ratio`: where the first element slides [um], and over the noise.
NOISE = (
    "The first element slides at {first:.4g} um, {ratio:.3g} times the sensor's noise; below {least} times its "
    "stiffness is estimated too small."
)


def drive_like(limits: tuple[float, float], records: Sequence[Prepared]) -> Sampling:
    """Return the sampling for a voltage to record: within limits [V], at the rate of the records."""
    # A lowest voltage of 1e-15 V, as records leave it, is 0 V.
    low = 0.0 if abs(limits[0]) < RULES.voltage_margin * 1e-3 * (limits[1] - limits[0]) else limits[0]
    cycle = min(cycle_time(item.record) for item in records)
    return Sampling(frequency=1 / cycle, base=low, limits=(low, limits[1]))


def _command(drive: Sampling, kind: str, options: str) -> str:
    """Return the command that writes an excitation up to the highest voltage."""
    highest = f"{drive.limits[1]:g}" if drive.limits is not None else ""
    return drive.command(f"{kind} {highest} {options}")


def _staircase(drive: Sampling, least: float = 0.0) -> str:
    """Return the command for steps that are held for as long as a cycle lasts, or `least` [s], which show creep."""
    return _command(drive, "staircase", f"--hold {max(2 * drive.half, _AMPLE * least):.3g}")


def hold(drive: Sampling) -> str:
    """Return the sentence with the excitation that would show creep."""
    wanted = "A step that is held for as long as a cycle lasts, or loops at two speeds, would show it"
    return f"{wanted}: {_staircase(drive)}"


def of_creep_not_tried(longest: float, needed: float, drive: Sampling) -> str:
    """Return the sentence for records that do not show creep: their longest hold, and the least that would [s]."""
    short = f" The longest hold, {longest:.3g} s, is {needed - longest:.3g} s too short." if longest else ""
    return (
        "Creep was not looked for: the records neither hold still for as long as their cycles last nor have loops of "
        f"one height at two speeds.{short} Add slower loops or a staircase: {_staircase(drive, needed)}"
    )


def of_dropped(part: str, without: float, within: float, stroke: float, drive: Sampling) -> str:
    """Return the sentence for a part that does not predict time that was not trained on."""
    named, wanted = {
        "inertia": ("A resonance", "Faster motion, up to a fifth of the resonance at least, would show it."),
        "creep": ("Creep", hold(drive)),
    }[part]
    return (
        f"{named} was found and left out: it does not predict parts of the records that were not trained on "
        f"(RMS {100 * within / stroke:.2g} % of the stroke with it, {100 * without / stroke:.2g} % without). Drift, "
        f"vibration, the sensor's noise or its filter may look like it. {wanted}"
    )


def of_lag(delay: float, lag: float, moved: float, stroke: float) -> str:
    """Return the sentence for the delay and lag [s] of a model that may be the sensor's.

    In both together the displacement moves by `moved` [m].
    """
    taken = []
    if delay:
        taken.append(
            f"A delay of {1e3 * delay:.3g} ms is left out of the model and is not compensated: the displacement "
            "follows a path that much later if the actuator delays it, and on time if only the sensor does."
        )
    if lag:
        taken.append(
            f"A lag of {1e3 * lag:.3g} ms was taken as the amplifier's, and is compensated: a path is missed by as "
            "much if it is the sensor's filter."
        )
    return (
        f"The displacement lags by {1e3 * (delay + lag):.3g} ms, in which it moves by {100 * moved / stroke:.2g} % of "
        "the stroke (RMS): a delay, or the low-pass filter of the sensor or the amplifier. "
        f"{' '.join(taken)} The expected error allows for it. "
        "Look for its time constant in the sensor's data sheet, or watch a step with a faster sensor, and give it as "
        "sensor_lag. A sensor lag of 0 says that it has none: the model stays, and the expected error is that of an "
        "actuator that lags."
    )


def of_one_ended_loops(voltages: Sequence[Array], drive: Sampling) -> list[str]:
    """Return a remark if all inner loops turn at one end of the voltages [V]: a path may have others."""
    low, high = min(float(v.min()) for v in voltages), max(float(v.max()) for v in voltages)
    near = RULES.end_of_limits * (high - low)
    minima, maxima = [], []
    for v in voltages:
        turns = v[turning_points(v, RULES.voltage_margin * (high - low))]
        rises = np.diff(turns, append=turns[-2:-1]) > 0
        minima += turns[rises].tolist()
        maxima += turns[~rises].tolist()
    at_low, at_high = all(v < low + near for v in minima), all(v > high - near for v in maxima)
    if at_low == at_high or len(minima) + len(maxima) < _FEWEST_TURNS:
        return []
    return [
        f"All inner loops of the records turn at the {'lowest' if at_low else 'highest'} voltage. Loops that turn "
        "elsewhere were not tested; the expected error allows for them. Records that end with random turning points "
        "test them, and promise less: " + _command(drive, "descending-tops", "--steps 5 --random 14")
    ]


def of_turns(probe: Identifiability, drive: Sampling) -> list[str]:
    """Return a remark if the turning points leave some of a few Maxwell-slip elements open."""
    if probe.determined == probe.of:
        return []
    return [
        f"Structures with more parts were not tried: the turning points determine {probe.determined} of {probe.of} "
        "directions of ten slip elements. More parts need nested loops, with other turning points: "
        + _command(drive, "descending-tops", "--steps 10")
    ]


def of_plain(
    identifiability: Identifiability, regression: Regression, coefficients: Coefficients
) -> tuple[Outcome, list[str]]:
    """Return the outcome with Maxwell-slip elements, and remarks about what stays open or lies on its floor."""
    remarks = []
    if identifiability.determined < identifiability.of:
        remarks.append(
            f"The records determine {identifiability.determined} of {identifiability.of} directions of the "
            "stiffnesses; minor loops with other turning points determine more (run dehyst insight for proposals)."
        )
    movable = regression.grid.movable
    still = int(np.count_nonzero(~movable))
    if still > 1 or not movable.any():
        remarks.append(
            f"{still} of {movable.size} elements slide at half of the range or more: they never slide over "
            "all of it, act as part of the spring, and got no stiffness."
        )
    low = np.flatnonzero(coefficients.slopes <= regression.floor * (1 + 1e-6))
    if low.size:
        ends = regression.grid.knots * 1e6
        places = ", ".join(f"{ends[j]:.4g} to {ends[j + 1]:.4g} um" for j in low[:4])
        remarks.append(f"The spring's slope lies on its floor at {places}{' and elsewhere' if low.size > 4 else ''}.")
    if identifiability.determined < identifiability.of:
        return Outcome.UNDETERMINED, remarks
    return (Outcome.FLOOR_ACTIVE if low.size else Outcome.IDENTIFIED), remarks


def of_rare_voltages(records: Sequence[Prepared], limits: tuple[float, float], drive: Sampling) -> list[str]:
    """Return remarks about ends of the limits [V] that the used samples reach for less than a part of one cycle.

    Descending tops pass the end in one cycle only, but in all of it: that is enough.
    """
    low, high = limits
    width = RULES.end_of_limits * (high - low)
    counted = []
    for item in records:
        used = counted_samples([(piece.voltage, epochs(piece, item.noise)) for piece in item.pieces])
        cycles = [cycle.stop - cycle.start - 1 for cycle in item.record.cycles()]
        counted.append((np.concatenate([np.zeros(0), *used]), float(np.median(cycles or [len(item.record)]))))
    total, remarks = sum(v.size for v, _ in counted), []
    for end, inward, words in ((high, -1, ("above", "highest")), (low, 1, ("below", "lowest"))):
        edge = end + inward * width
        counts = [(np.count_nonzero(inward * (edge - v) > 0), cycle) for v, cycle in counted]
        if sum(count / cycle for count, cycle in counts) < RULES.least_passage * RULES.end_of_limits:
            count = sum(count for count, _ in counts)
            remarks.append(
                f"Only {count} of {total} samples that count lie {words[0]} {edge:.4g} V, the {words[1]} voltage is "
                f"{end:.4g} V: the model is little better than extrapolated there. Record loops that go there slowly: "
                + _command(drive, "raised-cosine", "--cycles 2")
            )
    return remarks


def of_held_out(records: Sequence[Prepared], limits: tuple[float, float], errors: Sequence[RecordErrors]) -> list[str]:
    """Return remarks about held-out records that the model cannot be expected to predict."""
    low, high = limits
    margin, remarks = RULES.voltage_margin * (high - low), []
    for item in records:
        lowest, highest = item.record.voltage_range
        if lowest < low - margin or highest > high + margin:
            remarks.append(
                f"{item.name}: its voltages, {lowest:.4g} to {highest:.4g} V, leave those of the training records, "
                f"{low:.4g} to {high:.4g} V: the model is extrapolated there."
            )
    usual = max(error.rms for error in errors if error.role == "training")
    return remarks + [
        f"{error.record}: held out, its RMS error is {error.rms / usual:.2g} times that of training: the training "
        "records lack motions like it, or it is from another stage."
        for error in errors
        if error.role == "validation" and error.rms > RULES.usual_error * usual
    ]


def repaired(
    errors: Sequence[RecordErrors], delay: float, sample: float, *, given: bool, low_pass: float = 0.0
) -> list[str]:
    """Return sentences about the delay [s], for samples `sample` [s] apart, and each record's datum and drift.

    `low_pass` [s]: the part of the delay that is a lag of first order.
    """
    sentences = []
    if significant_delay(delay, sample):
        part = f", {low_pass * 1e3:.4g} ms of it as a low-pass of first order" if low_pass else ""
        sentences.append(
            f"The displacement lags the voltage by {delay * 1e3:.4g} ms ({delay / sample:.3g} samples, "
            f"{'given' if given else 'estimated'}{part}), by a delay or a low-pass of the sensor or the amplifier; "
            "voltages were delayed by it."
        )
    for error in errors:
        if error.datum:
            sentences.append(
                f"{error.record}: fits best with its sensor's zero moved by {error.datum * 1e6:.4g} um; it was moved."
            )
        if abs(error.drift) <= RULES.smallest_drift * error.stroke:
            continue
        total = f"by {error.drifted_percent:.3g} % of the stroke over the samples that count"
        if error.creeps:
            # Only creep has a rate.
            rate = 100 * error.drift / error.stroke
            drift = f"creeps by {rate:.3g} % of the stroke a decade of time since its start"
        elif error.steady:
            drift = f"drifts steadily {total}: the sensor, the temperature, or creep that lasts longer than the record"
        elif error.decades < RULES.fewest_decades:
            drift = f"drifts {total}, too short a time to determine a rate of creep"
        else:
            drift = f"drifts {total}, which is more than creep"
        sentences.append(f"{error.record}: {drift}; set aside.")
    return sentences
