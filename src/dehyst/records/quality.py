"""The quality of a record: reasons why it is unusable, and remarks on suspicious properties."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array
from dehyst.records.formats.columns import GAIN, HIGHEST_VOLTAGE, STROKES, shortened
from dehyst.records.glitches import glitch_sentences, glitches
from dehyst.records.signals import noise_span, resolution, runs, turning_points, white_noise
from dehyst.records.transients import Transient, transients

if TYPE_CHECKING:
    from dehyst.records.record import Record, Span

# Larger numbers [V, m, s] and shorter time steps [s] are no measurement, and computations with them overflow.
LARGEST, SHORTEST = 1e30, 1e-30
# Strokes [m] below any sensor's resolution, the size of an atomic nucleus, and of no piezo actuator; amplified ones
# reach millimetres.
_LEAST_STROKE, _LONGEST_STROKE = 1e-15, 0.1
# Voltages [V] below this are no actuator's, nor those of an amplifier's monitor.
_LEAST_VOLTAGE = 0.01
# Range of the temperatures of a laboratory [K]: in degC no piezo ceramic works there.
_KELVINS = 250.0, 330.0
# Share of the time step up to which the rounding of large times is not reported.
_ROUNDED = 0.02
# A voltage rests for so many samples at least. What the displacement moves back meanwhile, after it went on: least part
# of the stroke, and of the way on, which hysteresis makes the longer one.
_RESTS, _COMES_BACK, _BACK = 5, 0.02, 0.25
# Most transients that are named.
_SHOWN = 5


def fault_of(values: Array, column: str, unit: str) -> str:
    """Return an error for the first value of a `column` that is not finite or whose powers would overflow; or empty."""
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        return (
            f"{column} holds {counted(len(bad), 'value')} not finite, the first is {column}[{bad[0]}] = "
            f"{values[bad[0]]} {unit}; cut these rows out or fill them in"
        )
    if (largest := max(-values.min(), values.max())) <= LARGEST:
        return ""
    i = int(np.argmax(np.abs(values)))
    return (
        f"{column}[{i}] = {values[i]:.6g} {unit} is no {column}; {largest / LARGEST:.3g} times the largest number that "
        f"is taken ({LARGEST:g}): correct or cut that row, or check the column's unit"
    )


def not_rising(time: Array) -> str:
    """Return an error for the first time [s] that is not above the one before; or empty."""
    steps = np.diff(time)
    bad = np.flatnonzero(steps < SHORTEST)
    if not len(bad):
        return ""
    i = int(bad[0])
    if steps[i] > 0.0:
        return (
            f"time[{i + 1}] is {steps[i]:.3g} s after time[{i}], which no clock resolves, need {SHORTEST:g} s at "
            "least; drop one of the two rows, or check the time's unit"
        )
    advice = "sort the rows, drop repeated ones, or check the time unit's digits"
    if (lost := _rounding(time)) > 1e-9:
        advice = (
            f"times as large as these have a resolution of {lost:.2g} s only: count them from the record's first "
            "sample before they are saved, or give a sample rate"
        )
    return (
        f"time must rise strictly, but time[{i + 1}] = {time[i + 1]:.9g} s follows time[{i}] = {time[i]:.9g} s; "
        f"{advice}"
    )


def _rounding(time: Array) -> float:
    """Return the rounding of the largest of these times [s]."""
    return float(np.spacing(max(-time.min(), time.max())))


def other_unit(record: Record) -> str:
    """Return an error if the stroke is too large for a piezo actuator by orders of magnitude (wrong unit); or empty."""
    if record.stroke <= _LONGEST_STROKE:
        return ""
    return (
        f"got a stroke of {record.stroke:.4g} m, need at most {_LONGEST_STROKE:g} m: is the displacement in "
        'micrometres? Correct the unit of its column, or try Record.from_arrays with units "um"; a rig reads metres'
    )


def guesses(record: Record) -> tuple[str, ...]:
    """Return a sentence about each guess made when a record was read."""
    guessed = record.meta.get("guesses")
    guessed = guessed if isinstance(guessed, dict) else {}
    return tuple(f"The {quantity} is guessed, verify: {words}." for quantity, words in guessed.items())


def problems(record: Record) -> tuple[str, ...]:
    """Return sentences about suspicious but allowed properties, see `Record.problems`."""
    remarks = record.meta.get("remarks", ())
    noted = map(str, remarks) if isinstance(remarks, list | tuple) else ()
    return (*guesses(record), *_of_times(record), *_of_samples(record), *_of_units(record), *noted)


def _of_times(record: Record) -> Iterator[str]:
    usual, steps = record.sample_time, np.diff(record.time)
    if gaps := record.gaps():
        i, length = gaps[0]
        yield f"{counted(len(gaps), 'gap')} in time, the first of {length:.4g} s after sample {i}."
    if (lost := _rounding(record.time)) > _ROUNDED * usual:
        yield (
            f"Times this large have a resolution of {lost:.2g} s only, {100 * lost / usual:.2g} % of the time step; "
            "count them from the record's first sample before they are saved."
        )
    jitter = float(np.std(steps[steps <= 1.5 * usual])) / usual
    if jitter > 0.01:
        yield f"Sampling is uneven: the time step varies by {100 * jitter:.3g} %; resample the record."


def _of_samples(record: Record) -> Iterator[str]:
    cycles = record.cycles()
    points = float(np.median([c.stop - c.start - 1 for c in cycles])) if cycles else np.inf
    if points < 50:
        yield f"Only {points:.0f} samples a cycle; 50 or more show the loop's corners."
    for column, unit in (("voltage", "V"), ("displacement", "m")):
        step, part = resolution(getattr(record, column))
        if part > 0.005:
            yield f"The {column} moves in steps of {step:.3g} {unit}, {100 * part:.2g} % of its range: quantised."
    found = transients(record)
    spikes = _spikes(record, found)
    if len(spikes):
        yield (
            f"The displacement jumps away and back at {counted(len(spikes), 'sample')}, the first at "
            f"{record.time[spikes[0]]:.6g} s: remove such spikes, they distort range and fit."
        )
    yield from (f"The displacement does not settle at once: {one.words}." for one in found[:_SHOWN])
    yield from _cut_voltage(record, found)
    for remark in glitch_sentences(glitches(record.time, record.voltage, record.displacement)):
        yield remark[0].upper() + remark[1:]


def _cut_voltage(record: Record, found: tuple[Transient, ...]) -> Iterator[str]:
    """Yield that the voltage rests at its extreme while the displacement goes on and comes back, outside of transients.

    In a hold the displacement creeps on and does not turn. A mass may make it turn: this is no reason to refuse.
    """
    least = max(_COMES_BACK * record.stroke, noise_span(record.displacement))
    for sign, side in ((1.0, "maximum"), (-1.0, "minimum")):
        v, y = sign * record.voltage, sign * record.displacement
        at = runs(v >= v.max() - 1e-12 * float(np.ptp(v)))
        cut = [
            (a, b)
            for a, b in at
            if _RESTS <= b - a < v.size
            and not any(one.start < b and a < one.stop for one in found)
            and (fall := float(y[a:b].max() - y[b - 1])) > least
            and fall > _BACK * float(y[a:b].max() - y[a])
        ]
        if cut:
            a, b = cut[0]
            yield (
                f"The voltage looks cut off at its {side}, {sign * v[a]:.6g} V, in {counted(len(cut), 'place')}, first "
                f"over samples {a} to {b - 1}: the displacement goes on and comes back there. Record the voltage that "
                "the actuator gets, or a range that the monitor shows whole."
            )


def _spikes(record: Record, found: tuple[Transient, ...]) -> NDArray[np.intp]:
    """Find samples far from both neighbours, which are near one another, outside of transients."""
    y = record.displacement
    steps = np.abs(np.diff(y))
    away = np.minimum(steps[:-1], steps[1:])
    for one in found:
        away[one.start : one.stop] = 0.0
    usual = max(20 * record.noise, 10 * float(np.quantile(steps, 0.9)))
    return np.flatnonzero((away > usual) & (np.abs(y[2:] - y[:-2]) < 0.3 * away)) + 1


def _of_units(record: Record) -> Iterator[str]:
    highest = max(map(abs, record.voltage_range))
    if not STROKES[0] <= record.stroke <= STROKES[1]:
        stroke = f"{record.stroke * 1e6:.4g} um"
        yield f"The stroke is {stroke}, unusual for a piezo actuator; check the displacement's unit."
    if highest > HIGHEST_VOLTAGE:
        yield f"The voltage reaches {highest:.4g} V, unusual for a piezo actuator; check the voltage's unit and scale."
    temperatures = [one.column for one in record.others if one.role == "temperature"]
    if len(temperatures) > 1:
        yield f"Of the temperatures {' and '.join(temperatures)} none is used; leave all out but the actuator's."
    for one in record.others:
        low, high = float(one.values.min()), float(one.values.max())
        if one.role == "temperature" and _KELVINS[0] <= low and high <= _KELVINS[1]:
            yield (
                f"{one.column} is {low:.4g} to {high:.4g} degC, which are the kelvins of a laboratory; if "
                f"they are, name the column {one.name}_K."
            )
    if 0 < highest < _LEAST_VOLTAGE:
        yield f"The voltage stays below {highest:.3g} V, unusual for a piezo actuator; check its unit and scale."
    columns = record.meta.get("columns")
    monitor = str(columns.get("voltage", "")) if isinstance(columns, dict) else ""
    if "monitor" in monitor.lower() and not record.meta.get("scales", {}).get("voltage"):
        yield (
            f"The voltage is column '{shortened(monitor)}': if that is a monitor, which divides the voltage of the "
            f"actuator, give its gain for {GAIN} in voltage=NAME*{GAIN}."
        )


def reasons_against(record: Record, min_samples: int, min_cycles: int) -> Iterator[str]:
    """Yield reasons why no hysteresis loop can be identified from a record; later checks may rely on earlier ones."""
    if len(record) < min_samples:
        yield f"{len(record)} samples, {min_samples} are needed; record for longer"
    low, high = record.voltage_range
    if high - low < max(1e-9, 1e-6 * max(abs(low), abs(high))):
        yield f"the voltage is constant at {low:.6g} V; drive the actuator up and down"
    least = max(noise_span(record.displacement), 1e-12 * max(map(abs, record.displacement_range)), _LEAST_STROKE)
    if record.stroke <= least:
        yield (
            f"the displacement is constant but for noise: its stroke, {record.stroke:.3g} m, is no more than the range "
            f"of {len(record)} samples of noise of {record.noise:.3g} m; check the sensor and the column"
        )
    if words := other_unit(record):
        yield words
    cycles = record.cycles()
    if len(cycles) < min_cycles:
        yield (
            f"{counted(len(cycles), 'full cycle')} of the voltage found, {min_cycles} needed; drive it up and back "
            "down, for instance with a sine over the whole range"
        )
    if loop := butterfly_of(record.voltage, record.displacement):
        yield (
            f"the displacement both rises, by {loop.rise * 1e6:.3g} um, and falls, by {loop.fall * 1e6:.3g} um, with "
            "rising voltage: a butterfly loop, of an actuator driven beyond its coercive field, or a sensor that folds "
            f"over; record between {loop.low:.3g} and {loop.high:.3g} V"
        )
    if np.corrcoef(record.voltage, record.displacement)[0, 1] < -0.5:
        yield (
            "displacement falls when voltage rises: the actuator is poled the other way, or the sensor's sign is "
            "inverted; if it is the sensor, read the columns with displacement=NAME*-1"
        )
    yield from _clipped(record, max(5, round(0.005 * len(record) / max(1, len(cycles)))))
    yield from _leading(record, cycles)


def _clipped(record: Record, least: int) -> Iterator[str]:
    """Yield that the sensor stays at its extreme while the voltage goes on in that direction."""
    needed = (0.02 + 3.0 * resolution(record.displacement)[1]) * float(np.ptp(record.voltage))
    for sign, side in ((1.0, "maximum"), (-1.0, "minimum")):
        y, v = sign * record.displacement, sign * record.voltage
        for a, b in runs(y >= y.max() - 1e-12 * record.stroke):
            # A dead zone after a reversal is flat too, but there the voltage only goes back.
            if b - a >= least and v[a:b].max() - v[a] > needed:
                yield (
                    f"the sensor is clipped, or the amplifier: the displacement sits at its {side} {sign * y[a]:.6g} m "
                    f"over samples {a} to {b - 1} while the voltage still moves; lower the voltage range or shift the "
                    "sensor's range"
                )


def _leading(record: Record, cycles: list[Span]) -> Iterator[str]:
    """Yield that the loops run clockwise in the (voltage, displacement) plane by more than noise can explain."""
    area = box = var_y = var_v = 0.0
    for cycle in cycles:
        v, y = record.voltage[cycle], record.displacement[cycle]
        dv, dy = np.diff(np.append(v, v[0])), np.diff(np.append(y, y[0]))
        # Rising below falling is counter-clockwise: the actuator lags, and this sum is positive.
        area -= float(np.dot(y - y.mean() + 0.5 * dy, dv))
        box += float(np.ptp(v) * np.ptp(y))
        var_y, var_v = var_y + float(dv @ dv), var_v + float(dy @ dy)
    doubt = sqrt(record.noise**2 * var_y + white_noise(record.voltage) ** 2 * var_v)
    if area < -(0.005 * box + 5.0 * doubt):
        yield (
            f"the displacement leads the voltage (loop area {100 * area / box:.2g} % of its box): the columns look "
            "swapped (or the displacement's sign is inverted); check which column is which"
        )


# Least share of the voltage range that a leg covers to count, and bins of the voltage.
_WHOLE, _BINS = 0.9, 32
# Least fall or rise that counts: share of the stroke, and multiple of the noise of a bin's mean.
_LEAST, _LOUD = 0.1, 8.0


class Butterfly(NamedTuple):
    """A loop whose displacement both falls and rises with rising voltage, as of a switching ferroelectric.

    Fall and rise of the displacement with rising voltage [m], and the voltages between which it rises [V].
    """

    fall: float
    rise: float
    low: float
    high: float


def butterfly_of(voltage: Array, displacement: Array) -> Butterfly | None:
    """Find a fall and a rise on the line midway between the rising and the falling legs; return None without both.

    On that line hysteresis, a delay, creep and a drift from leg to leg take opposite signs and cancel.
    """
    span = float(np.ptp(voltage))
    turns = turning_points(voltage, _WHOLE * span)
    legs = [slice(begin, end + 1) for begin, end in pairwise([0, *turns.tolist(), len(voltage) - 1])]
    rises = [float(voltage[leg.stop - 1] - voltage[leg.start]) for leg in legs]
    edges = np.linspace(voltage.min(), voltage.max(), _BINS + 1)
    means = []
    for sign in (1, -1):
        # The mean displacement [m] in each bin of the voltage, and its number of samples.
        own = [leg for leg, rise in zip(legs, rises, strict=True) if sign * rise >= _WHOLE * span]
        v, y = (np.concatenate([np.zeros(0), *(values[leg] for leg in own)]) for values in (voltage, displacement))
        bins = np.clip(np.searchsorted(edges, v) - 1, 0, _BINS - 1)
        counts, sums = np.bincount(bins, minlength=_BINS), np.bincount(bins, y, _BINS)
        means.append((np.divide(sums, counts, out=np.zeros(_BINS), where=counts > 0), counts))
    (up, up_counts), (down, down_counts) = means
    filled = (up_counts > 0) & (down_counts > 0)
    if np.count_nonzero(filled) < _BINS // 2:
        return None
    up, down, places = up[filled], down[filled], (0.5 * (edges[1:] + edges[:-1]))[filled]
    middle = 0.5 * (up + down)
    noise = white_noise(displacement) / sqrt(min(up_counts[filled].min(), down_counts[filled].min()))
    least = max(_LEAST * float(np.ptp(displacement)), _LOUD * noise)
    fall = float(np.max(np.maximum.accumulate(middle) - middle))
    climbed = middle - np.minimum.accumulate(middle)
    if min(fall, float(climbed.max())) < least:
        return None
    top = int(np.argmax(climbed))
    bottom = int(np.argmin(middle[: top + 1]))
    # Before the rise the falling legs turn last, after it the rising ones do.
    low = float(places[int(np.argmin(down[: top + 1]))]) if bottom else float(voltage.min())
    last = places.size - 1
    high = float(places[bottom + int(np.argmax(up[bottom:]))]) if top < last else float(voltage.max())
    return Butterfly(fall, float(climbed.max()), low, high)
