"""The quality of a record: reasons why it is unusable, and remarks on suspicious properties."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dehyst._text import counted
from dehyst._types import Array
from dehyst.records import loops
from dehyst.records.cleaning import FEWEST_NEW, cleaned
from dehyst.records.formats.column import QUANTITIES, impossible
from dehyst.records.signals import gaps, new_samples, noise_span, resolution, runs

if TYPE_CHECKING:
    from dehyst.records.record import Record

# Larger numbers [V, m, s] and shorter time steps [s] are not from a measurement, and computations with them overflow.
LARGEST, SHORTEST = 1e30, 1e-30
# Fewest events from which a loop is identified.
_LEAST_EVENTS = 60
# Least and largest displacement for each volt [m/V] of stages, also by the input of an amplifier.
_GAINS = (2e-9, 5e-5)
# A longer cycle [s] raises a question about the unit: the times may be milliseconds.
_SLOWEST = 1000.0
# Least number of samples of a usable record, and of a sweep.
_FEWEST, _SWEEP = 20, 3
# Largest stroke of a bender [m]; a stage has less, and a record of more than that is asked about.
_LARGEST_STROKE = 5e-3
# A time starts again if it returns this near to its first value, as a part of its range.
_AGAIN = 0.1


def fault_of(values: Array, column: str, unit: str) -> str:
    """Return an error for the first value of a `column` that is not finite or whose powers overflow; or empty."""
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad) == len(values):
        return f"{column} holds no finite number; export it again, or select another column"
    if len(bad):
        return (
            f"{column} holds {counted(len(bad), 'value')} not finite, the first is {column}[{bad[0]}] = "
            f"{values[bad[0]]} {unit}; fill them in from their neighbours, or record them anew"
        )
    if max(-values.min(), values.max()) <= LARGEST:
        return ""
    i, need = int(np.argmax(np.abs(values))), f"need at most {LARGEST:g}"
    return f"{column}[{i}] = {values[i]:.6g} {unit} is no {column}, {need}: correct it, or check the column's unit"


def not_rising(time: Array, voltage: Array, displacement: Array) -> str:
    """Return an error with cause and remedy if times (n,) [s] are not each above the one before; or empty."""
    steps = np.diff(time)
    bad = np.flatnonzero(steps < SHORTEST)
    if not bad.size:
        return ""
    if not steps.any():
        return f"the time stands still at {time[0]:.9g} s; give a sample rate, rate=HZ"
    rate = 1 / max(abs(float(np.polyfit(np.arange(time.size), time, 1)[0])), SHORTEST)
    if (steps < 0.0).all():
        # The first of several axes decides.
        v, y = (values.reshape(time.size, -1)[:, 0] for values in (voltage, displacement))
        way = loops.sense(v, y)
        sign = f"the time has the wrong sign: give rate={rate:.6g} in its place if the samples are even"
        turn = "the samples are in reverse order: turn the order of the rows round (in Python: array[::-1])"
        remedy = f"by the sense of the loops, {sign if way > 0 else turn}" if way else f"either {turn}; or {sign}"
        return f"the time falls from sample to sample, from {time[0]:.9g} s to {time[-1]:.9g} s; {remedy}"
    begins = np.flatnonzero(steps < 0.0) + 1
    again = np.abs(time[begins] - time[0]) <= _AGAIN * (time[begins - 1] - time[0])
    if begins.size and np.diff([0, *begins.tolist(), time.size]).min() >= _SWEEP and again.all():
        return (
            f"the time starts again at sample {begins[0]} of {time.size}, counted from 0: {begins.size + 1} sweeps; "
            "read each as a record of its own, and give all of them to identify"
        )
    i = int(bad[0])
    words = f"time[{i + 1}] = {time[i + 1]:.9g} s follows time[{i}] = {time[i]:.9g} s"
    words = f"{words}, and the time does not rise in {counted(bad.size, 'place')}"
    if begins.size:
        rate = 1 / float(np.median(steps[steps > 0]))
        return (
            f"{words}; sort the samples by time if they are mixed up, cut the record in two there if the clock was set "
            f"back, or give the sample rate in place of these times, rate={rate:.6g} if it is even"
        )
    digit = float(np.diff(np.unique(time)).min())
    return (
        f"{words}: times in steps of {digit:.3g} s, coarser than the samples, or samples that are written twice; give "
        f"the sample rate in their place, rate={rate:.4g} if it is even"
    )


def other_unit(record: Record) -> str:
    """Return an error if no piezo actuator has such a time, voltage or stroke, because a unit is wrong; or empty."""
    words = impossible("time", record.sample_time) or impossible("voltage", max(map(abs, record.voltage_range)))
    return words or (impossible("displacement", record.stroke) if record.stroke else "")


def long_stroke(record: Record) -> dict[str, str]:
    """Return the fields of an error if no stage has such a stroke with such voltages: its unit is wrong; or none."""
    (driven, moved), most = _spans(record), _LARGEST_STROKE
    if moved <= most or driven > QUANTITIES["voltage"].range[1] or other_unit(record):
        return {}
    got, hint = (
        f"{1e3 * moved:.4g} mm for {driven:.4g} V",
        "check its unit and scale first: is it in nm, and read as um?",
    )
    return {"argument": "displacement", "got": got, "need": f"at most {1e3 * most:g} mm", "hint": hint}


def _spans(record: Record) -> tuple[float, float]:
    """Return the range of the voltage [V] and of the displacement [m], without the readings of an overload."""
    driven, moved = np.ptp(np.quantile([record.voltage, record.displacement], (0.05, 0.95), axis=1), axis=0).tolist()
    return driven, moved


def guesses(record: Record) -> tuple[str, ...]:
    """Return what to verify of a record: guesses made when it was read, and units in which no stage moves."""
    driven, moved = _spans(record)
    doubts = []
    for quantity, span, unit in (("voltage", driven, "V"), ("displacement", moved, "m")):
        least, most = QUANTITIES[quantity].range
        if 0 < span < least or span > most:
            usual = f"{least:g} to {most:g} {unit}"
            doubts.append(f"The {quantity} has a range of {span:.3g} {unit}, where a stage has {usual}")
    if not doubts and driven and moved and not _GAINS[0] * driven <= moved <= _GAINS[1] * driven:
        doubts = [f"The displacement moves {moved:.3g} m for {driven:.3g} V, where a stage moves 2 nm to 50 um a volt"]
    if (cycle := float(np.ptp(record.time)) / max(len(record.cycles()), 1)) > _SLOWEST:
        doubts.append(f"A cycle takes {cycle:.3g} s")
    return (
        *(f"The {key} is guessed, verify: {words}." for key, words in record.meta.get("guesses", {}).items()),
        *(f"{doubt}; check its unit and scale." for doubt in doubts),
        *record.meta.get("scale", ()),
    )


def problems(record: Record) -> tuple[str, ...]:
    """Return sentences about suspicious but allowed properties, see `Record.problems`."""
    clean = cleaned(record)
    return (
        *guesses(record),
        *_of_samples(record, clean.record),
        *(sentence[0].upper() + sentence[1:] for sentence in clean.sentences),
        *loops.remarks(clean.record),
        *map(str, record.meta.get("remarks", ())),
    )


def _of_samples(whole: Record, record: Record) -> Iterator[str]:
    """Yield remarks on the samples of a record; `whole` also has the samples that were left out."""
    if missing := gaps(whole.time):
        i, length = missing[0]
        yield f"{counted(len(missing), 'gap')} in time, the first of {length:.4g} s after sample {i}."
    cycles = record.cycles()
    points = float(np.median([c.stop - c.start - 1 for c in cycles])) if cycles else np.inf
    if points < 50:
        yield f"Only {points:.0f} samples a cycle; 50 or more show the loop's corners."
    signals = [("voltage", "V"), ("displacement", "m")][: 2 if record.measured is None else 1]
    if record.measured is not None:
        events, samples = record.meta.get("recorded", (np.count_nonzero(record.measured), len(record)))
        yield f"The displacement is known at {counted(int(events), 'event')} of {samples} samples; only these count."
    for column, unit in signals:
        step, part = resolution(getattr(record, column))
        moves = np.diff(getattr(record, column)) != 0.0
        # A drive that rests moves for many samples at a time.
        often = 8 * np.count_nonzero(moves[1:] > moves[:-1]) > np.count_nonzero(moves)
        polled = column == "displacement" and new_samples(record.voltage, record.displacement) is not None
        if part > 0.005 and often and not polled:
            yield f"The {column} moves in steps of {step:.3g} {unit}, {100 * part:.2g} % of its range: quantised."
    temperatures = [channel.column for channel in record.others if channel.role == "temperature"]
    if len(temperatures) > 1:
        yield f"None of the temperatures {' and '.join(temperatures)} is used; leave out all but the actuator's."


def reasons_against(record: Record) -> Iterator[str]:
    """Yield reasons why no hysteresis loop can be identified from a record without glitches and spikes."""
    reasons = list(_reasons(record))
    clean = cleaned(record).record if reasons and len(record) >= _FEWEST else record
    yield from reasons if clean is record else _reasons(clean)


def _reasons(record: Record) -> Iterator[str]:
    """Yield the reasons; later checks may rely on earlier ones."""
    if len(record) < _FEWEST:
        yield f"{len(record)} samples, {_FEWEST} are needed; record for longer"
    low, high = record.voltage_range
    if high - low < max(1e-9, 1e-6 * max(abs(low), abs(high))):
        yield f"the voltage is constant at {low:.6g} V; drive the actuator up and down"
        return
    if record.measured is None and (words := loops.fringes(record.voltage, record.displacement)):
        yield words
    least = max(noise_span(record.displacement), 1e-12 * float(np.abs(record.displacement).max()), loops.LEAST_STROKE)
    if record.stroke <= least:
        yield (
            f"the displacement is constant except for noise: its stroke, {record.stroke:.3g} m, is no more than the "
            f"range of {len(record)} samples of noise of {record.noise:.3g} m; check the sensor and the column"
        )
        return
    if words := other_unit(record):
        yield words
    cycles = record.cycles()
    if not cycles:
        yield "no full cycle of the voltage found, one is needed; drive it up and back down, such as with a sine"
    if record.measured is not None:
        events = int(np.count_nonzero(record.measured))
        few = f"the displacement is known at {events} events, {_LEAST_EVENTS} are needed; drive over more of them"
        yield from [few] if events < _LEAST_EVENTS else []
        return
    new = new_samples(record.voltage, record.displacement)
    if new is not None and np.count_nonzero(new) < FEWEST_NEW * max(len(cycles), 2):
        each = np.count_nonzero(new) / max(len(cycles), 1)
        yield (
            f"the displacement is new only at every {round(1 / float(new.mean()))}th sample, {each:.2g} times a cycle, "
            f"and repeats in between; need {FEWEST_NEW} times: read it faster, or drive slower"
        )
    if words := loops.echo(record):
        yield words
    if loop := loops.butterfly(record.voltage, record.displacement):
        fall, rise, turn = loop
        yield (
            f"the displacement both rises, by {rise * 1e6:.3g} um, and falls, by {fall * 1e6:.3g} um, with rising "
            "voltage: a butterfly loop, of an actuator driven beyond its coercive field, or a sensor that folds over; "
            f"record on one side of {turn:.3g} V"
        )
    if np.corrcoef(record.voltage, record.displacement)[0, 1] < -0.5:
        yield "displacement falls as voltage rises: poled the other way, or the sensor's sign: try displacement=NAME*-1"
    yield from _clipped(record, max(5, round(0.005 * len(record) / max(1, len(cycles)))))
    if words := loops.leading(record, cycles):
        yield words


def _clipped(record: Record, least: int) -> Iterator[str]:
    """Yield an error if the sensor stays at its extreme while the voltage goes on in that direction."""
    needed = (0.02 + 3.0 * resolution(record.displacement)[1]) * float(np.ptp(record.voltage))
    for sign, side in ((1.0, "maximum"), (-1.0, "minimum")):
        up = sign * record.displacement
        for a, b in runs(up >= up.max() - 1e-12 * float(np.ptp(up))):
            v = sign * record.voltage[a:b]
            # A dead zone after a reversal is flat too, but there the voltage only goes back.
            if b - a >= least and v.max() - v[0] > needed:
                yield (
                    f"the sensor is clipped, or the amplifier: the displacement sits at its {side} "
                    f"{record.displacement[a]:.6g} m over samples {a} to {b - 1} while the voltage still moves; lower "
                    "the voltage range or shift the sensor's range"
                )
