"""Times that do not rise: one cause, and one remedy that loses no sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array
from dehyst.records.loops import sense

# Shorter steps [s] are no measurement, and computations with them overflow.
SHORTEST = 1e-30
# Largest difference of an evenly rounded time from a straight line, in its steps; least samples of a sweep.
_EVEN, _SWEEP = 1.2, 3
# A time starts again within this part of its way so far; largest part of a step by which even times vary.
_AGAIN, _VARIES = 0.1, 0.5
# Most rows that are named.
_SHOWN = 5


def rounding(time: Array) -> float:
    """Return the rounding of the largest of these times [s]."""
    return float(np.spacing(max(-time.min(), time.max())))


def not_rising(time: Array, voltage: Array, displacement: Array) -> str:
    """Return an error with cause and remedy if times (n,) [s] are not each above the one before; or empty.

    `voltage` and `displacement` (n,) tell reversed rows from a wrong sign, and rows that are written twice.
    """
    steps = np.diff(time)
    if not np.any(steps < SHORTEST):
        return ""
    # The first of several axes.
    voltage, displacement = (values.reshape(time.size, -1)[:, 0] for values in (voltage, displacement))
    falls, stands = np.flatnonzero(steps < 0.0), np.flatnonzero(steps == 0.0)
    if not steps.any():
        return f"the time stands still at {time[0]:.9g} s; give a sample rate"
    if falls.size + stands.size == steps.size:
        return _falling(time, voltage, displacement)
    if falls.size:
        return _falls(time, falls)
    if stands.size:
        return _stands(time, stands, np.column_stack([voltage, displacement]))
    i = int(np.argmax(steps < SHORTEST))
    return (
        f"time[{i + 1}] is {steps[i]:.3g} s after time[{i}], which no clock resolves, need {SHORTEST:g} s at least; "
        "check the time's unit, or give a sample rate"
    )


def _rate(time: Array) -> str:
    """Return the sample rate that evenly sampled times (n,) have, as advice."""
    rate = 1 / abs(float(np.polyfit(np.arange(time.size), time, 1)[0]))
    return f"give the sample rate in place of the time, rate={rate:.6g} if the samples are even"


def _falling(time: Array, voltage: Array, displacement: Array) -> str:
    """Return the error for a time that never rises."""
    turn, sign = "turn the rows round, such as array[::-1]", f"{_rate(time)}, or multiply it by -1"
    way = sense(voltage, displacement)
    if way > 0:
        advice = f"the loops run the right way round as the rows are, so the time has the wrong sign: {sign}"
    elif way < 0:
        advice = f"the loops run the wrong way round as the rows are, so these are in reverse order: {turn}"
    else:
        advice = f"either the rows are in reverse order: {turn}; or the time has the wrong sign: {sign}"
    return f"the time falls from row to row, from {time[0]:.9g} s to {time[-1]:.9g} s; {advice}"


def _falls(time: Array, falls: NDArray[np.intp]) -> str:
    """Return the error for a time that falls between some rows."""
    begins = falls + 1
    sizes = np.diff([0, *begins.tolist(), time.size])
    if sizes.min() >= _SWEEP and np.all(np.abs(time[begins] - time[0]) <= _AGAIN * (time[begins - 1] - time[0])):
        rows = ", ".join(map(str, begins[:_SHOWN])) + ", ..." * (begins.size > _SHOWN)
        return (
            f"the time starts again in row{'s' * (begins.size > 1)} {rows} of {time.size}, counted from 0: "
            f"{begins.size + 1} sweeps; read each as a record of its own, and give all of them to identify"
        )
    i = int(falls[0])
    words = f"time[{i + 1}] = {time[i + 1]:.9g} s follows time[{i}] = {time[i]:.9g} s"
    ordered = np.diff(np.sort(time))
    if np.ptp(ordered) < _VARIES * np.median(ordered):
        return f"{words}: the rows are out of order, and sorted by time they are even; sort them"
    if sizes.min() >= _SWEEP:
        return (
            f"{words}: a clock that was set back, or that counts up to a limit only; add what is missing to the times "
            f"from there on, or give the sample rate in its place, rate={1 / float(np.median(np.diff(time))):.6g}"
        )
    return f"{words}, and the time falls in {counted(falls.size, 'place')}; correct these times, or give a sample rate"


def _stands(time: Array, stands: NDArray[np.intp], values: Array) -> str:
    """Return the error for equal times, at rows with these values (n, 2)."""
    i = int(stands[0])
    words = f"{counted(stands.size, 'time')} equal the one before, the first is time[{i + 1}] = {time[i]:.9g} s"
    if (lost := rounding(time)) > 1e-9:
        words += f", as large as these they have a resolution of {lost:.2g} s only:"
        return f"{words} count them from the record's first sample before they are saved, or {_rate(time)}"
    places, distinct = np.arange(time.size), np.diff(np.unique(time))
    if np.array_equal(values[stands], values[stands + 1]) and np.ptp(distinct) < _VARIES * np.median(distinct):
        return f"{words}: rows that are written twice; leave out one of each two"
    line = np.polyval(np.polyfit(places, time, 1), places)
    if np.abs(time - line).max() <= _EVEN * distinct.min():
        return f"{words}: even times that are rounded to {distinct.min():.3g} s; {_rate(time)}"
    return f"{words}: a timer that is coarser than the samples; {_rate(time)}"
