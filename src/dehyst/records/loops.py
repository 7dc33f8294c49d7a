"""What loops show of the origin of a record: an echo, swapped columns, a shifted clock, fringes, a servo, slip."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import counted
from dehyst._types import Array
from dehyst.records.signals import noise_span, turning_points, turns_of, white_noise

if TYPE_CHECKING:
    from dehyst.records.record import Record, Span

# Number of points at which branches are compared; largest difference of equal voltages, in ranges.
_POINTS, _EQUAL = 32, 0.02
# Least area of a loop in the wrong direction: as a part of its bounding box, and in standard deviations of the noise.
_AREA, _DEVIATIONS = 0.005, 5.0
# A jump between sorted branches: least part of the range, least number of usual steps; part of other steps against it.
_JUMP, _STEPS, _OTHERS = 0.3, 10.0, 0.95
# Two branches are similar if they differ by at most this part of the difference of other branches.
_ALIKE = 0.4
# A shift in time: most samples, least improvement, least fall of the improvement beyond it, relative to its rise.
_LATE, _GAINED, _SHARP = 64, 5e-4, 0.7
# A stroke [m] below the resolution of any sensor: the size of an atomic nucleus.
LEAST_STROKE = 1e-15
# Fringes: least number in a stroke; least size, as a part of the range; part of a branch in which they are counted;
# kurtosis of noise; correlation of a displacement that follows the voltage.
_FRINGES, _FRINGE, _INSIDE, _KURTOSIS, _FOLLOWS = 2.2, 0.3, 0.9, 1.65, 0.5
# No hysteresis: largest residual, as a part of the stroke, and of the width that a lag gives a loop; part of a branch
# that is left out after its turn; least difference of branch sizes, as a part of the largest.
_STRAIGHT, _ROUND, _TURNS, _VARIES = 5e-4, 0.04, 0.3, 0.2
# A plateau: least part of the voltage range; least slope before it; largest deviation in strokes, and slope, on it.
_PLATEAU, _SLOPE, _FLAT, _CREEPS = 0.04, 0.3, 5e-4, 0.03
# Slipping: least drift in strokes, least factor by which travel explains it better than time, fewest returns.
_SLIPS, _BETTER, _RETURNS = 0.01, 3.0, 4
# Least part of the voltage range that a branch of a butterfly loop covers; number of bins of the voltage.
_WHOLE, _BINS = 0.9, 32
# Least fall or rise of a butterfly: as a part of the stroke, and as a multiple of the noise of a bin's mean.
_LEAST, _LOUD = 0.1, 8.0
# An echo of the command: errors of rounding, also to six digits, and largest digit that may hide a sensor, in strokes;
# largest distance from multiples of a digit; number of samples tested first.
_ROUNDING, _SIX_DIGITS, _DIGIT, _ON_GRID, _STRETCH = 1e-6, 5e-6, 5e-3, 0.1, 4096


def sense(voltage: Array, displacement: Array, cycles: list[Span] | None = None) -> int:
    """Return 1 if the displacement lags in the loops, -1 if it leads by more than noise explains, 0 if unclear."""
    if cycles is None:
        cycles = [slice(int(a), int(b) + 1) for a, b in pairwise(turns_of(voltage)[::2])]
    area = box = of_y = of_v = 0.0
    for cycle in cycles:
        v, y = voltage[cycle], displacement[cycle]
        dv, dy = np.diff(np.append(v, v[0])), np.diff(np.append(y, y[0]))
        # If the actuator lags, the rising branch is below the falling one, and this sum is positive.
        area -= float(np.einsum("i,i", y - y.mean() + 0.5 * dy, dv))
        box += float(np.ptp(v) * np.ptp(y))
        of_y, of_v = of_y + float(np.einsum("i,i", dv, dv)), of_v + float(np.einsum("i,i", dy, dy))
    doubt = sqrt(white_noise(displacement) ** 2 * of_y + white_noise(voltage) ** 2 * of_v)
    return int(np.sign(area)) if abs(area) > _AREA * box + _DEVIATIONS * doubt else 0


def leading(record: Record, cycles: list[Span]) -> str:
    """Return why the loops run clockwise in the (voltage, displacement) plane; empty if they do not."""
    v, y = record.voltage, record.displacement
    leads = sense(v, y, cycles) < 0
    if (words := _sorted_branches(v, y, record.noise, leads=leads)) is not None or not leads:
        return words or ""
    early = early_turns(record)
    if early and sense(v[early:], y[:-early]) >= 0:
        return _shift(record, early)
    return (
        "the displacement leads the voltage in the loops: either the columns look swapped, check which is which; or "
        "the samples look reversed in time, turn the order of the rows round (in Python: array[::-1])"
    )


def _sorted_branches(v: Array, y: Array, noise: float, *, leads: bool) -> str | None:
    """Return the error of a voltage that jumps between sorted branches; None if it does not, empty for a sawtooth."""
    steps, stroke = np.diff(v), float(np.ptp(y))
    far = np.abs(steps) > max(_JUMP * float(np.ptp(v)), _STEPS * float(np.median(np.abs(steps))))
    ways, others, jumps = np.sign(steps[far]), np.sign(steps[~far]), np.flatnonzero(far)
    # All jumps go one way, against the way of all other steps.
    one_way = jumps.size and others.any() and abs(ways.sum()) == ways.size
    if not one_way or np.count_nonzero(others == -ways[0]) < _OTHERS * np.count_nonzero(others):
        return None
    parts = [slice(a, b) for a, b in pairwise([0, *(jumps + 1).tolist(), v.size]) if b - a > 1]
    grid = np.linspace(max(v[p].min() for p in parts), min(v[p].max() for p in parts), _POINTS)
    orders = [part.start + np.argsort(v[part]) for part in parts]
    curves = np.array([np.interp(grid, v[order], y[order]) for order in orders])
    unlike, alike = (np.abs(curves[k:] - curves[:-k]).mean(axis=1) for k in (1, 2))
    if alike.size:
        leads = np.median(unlike) > max(_AREA * stroke + noise, np.median(alike) / _ALIKE)
    if not leads:
        return ""
    return (
        f"the voltage jumps back by up to {np.abs(steps[far]).max():.4g} V in one sample, in "
        f"{counted(jumps.size, 'place')}, first after sample {jumps[0]}: branches that are sorted by voltage; put the "
        "samples back into the order in which they were measured, every second branch in reverse"
    )


def early_turns(record: Record) -> int:
    """Return by how many samples the displacement turns before the voltage does; 0 if it does not."""
    steps_v, steps_y = np.diff(record.voltage), np.diff(record.displacement)
    turns = turns_of(record.voltage)
    most = min(_LATE, int(np.median(np.diff(turns))) // 3) if turns.size > 1 else 0
    if not most:
        return 0
    # Both signals move the same way except between their turns: the sum of products is largest if the turns coincide.
    part = steps_y[: steps_y.size - most]
    # A product by a library with threads would be slower.
    alike = np.array([np.einsum("i,i", part, steps_v[late : late + part.size]) for late in range(most + 1)])
    best = int(np.argmax(alike))
    gained = float(alike[best] - alike[0])
    moved = steps_v[best : best + part.size] - steps_v[: part.size]
    of_y, of_v = record.noise * float(np.linalg.norm(moved)), white_noise(record.voltage) * float(np.linalg.norm(part))
    clear = gained > 1.4 * _DEVIATIONS * (of_y + of_v) + _GAINED * alike[best]
    # At the turns of a sine, a phase lead and a shift of few samples look alike.
    sharp = 0 < best < most and best * (alike[best] - alike[best + 1]) > _SHARP * gained
    return best if clear and sharp else 0


def _shift(record: Record, early: int) -> str:
    """Return the error of a displacement that is early by some samples."""
    return (
        f"the displacement turns before the voltage does, by {1e3 * early * record.sample_time:.4g} ms "
        f"({counted(early, 'sample')}): clocks or columns are shifted, or the voltage is measured late; shift the "
        "displacement back by that time"
    )


def butterfly(voltage: Array, displacement: Array) -> tuple[float, float, float] | None:
    """Return fall and rise [m] of the mean line of both branches, and the voltage between; None if it only rises."""
    span = float(np.ptp(voltage))
    points = [0, *turning_points(voltage, _WHOLE * span).tolist(), voltage.size - 1]
    edges = np.linspace(voltage.min(), voltage.max(), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, voltage) - 1, 0, _BINS - 1)
    counts, sums = np.zeros((2, _BINS)), np.zeros((2, _BINS))
    for begin, end in pairwise(points):
        rise = float(voltage[end] - voltage[begin])
        if abs(rise) >= _WHOLE * span:
            part, falling = slice(begin, end + 1), int(rise < 0)
            counts[falling] += np.bincount(bins[part], minlength=_BINS)
            sums[falling] += np.bincount(bins[part], displacement[part], _BINS)
    filled = counts.min(axis=0) > 0
    if np.count_nonzero(filled) < _BINS // 2:
        return None
    (up, down), places = sums[:, filled] / counts[:, filled], (0.5 * (edges[1:] + edges[:-1]))[filled]
    middle = 0.5 * (up + down)
    noise = white_noise(displacement) / sqrt(counts[:, filled].min())
    fall, climbed = np.maximum.accumulate(middle) - middle, middle - np.minimum.accumulate(middle)
    if min(fall.max(), climbed.max()) < max(_LEAST * float(np.ptp(displacement)), _LOUD * noise):
        return None
    top = int(np.argmax(climbed))
    bottom = int(np.argmin(middle[: top + 1]))
    return float(fall.max()), float(climbed.max()), float(places[bottom or top])


def echo(record: Record) -> str:
    """Return the error of a displacement that is linear in the voltage, now or some samples ago; or empty."""
    v, y = record.voltage, record.displacement
    left, of_v = _rounded(y), _rounded(v)
    middle = slice(max((y.size - _STRETCH) // 2, 0), (y.size + _STRETCH) // 2)
    for late in range(min(_LATE, y.size // 4) + 1):
        for part in (middle, slice(None)):
            sent, shown = v[part][: v[part].size - late], y[part][late:]
            sent, shown = sent - sent.mean(), shown - shown.mean()
            gain = float(sent @ shown) / max(float(sent @ sent), 1e-300)
            if np.abs(shown - gain * sent).max() > left + abs(gain) * of_v:
                break
        else:
            when = f" of {counted(late, 'sample')} before" if late else ""
            return (
                f"the displacement is a linear function of the voltage{when}, to {left:.2g} m: without any noise or "
                "hysteresis, it looks like the set-point and not like the sensor; record what the sensor measures"
            )
    return ""


def _rounded(values: Array) -> float:
    """Return the largest rounding error of values, by the digits in which they are written."""
    span = float(np.ptp(values))
    steps = np.diff(np.unique(values))
    steps = np.concatenate([steps, np.abs(np.diff(steps))])
    digit = float(steps[steps > _ROUNDING * span].min(initial=span))
    digits = (values[:_STRETCH] - values[0]) / digit
    rounded = digit < _DIGIT * span and np.abs(digits - np.round(digits)).max() < _ON_GRID
    return _SIX_DIGITS * span + (0.5 * digit * (1 + 3 / sqrt(values.size)) if rounded else 0.0)


def fringes(v: Array, y: Array) -> str:
    """Return the error of a displacement (n,) that turns many times in a stroke of the voltage (n,); or empty."""
    turns = turns_of(v)
    if turns.size < 2 or not float(np.ptp(y)) >= LEAST_STROKE:
        return ""
    own = turning_points(y, _FRINGE * float(np.ptp(y)))
    # A displacement that rings after a step turns while the voltage rests.
    branch = np.searchsorted(turns, own)
    ends = v[np.concatenate([[0], turns, [v.size - 1]])]
    low, high = np.minimum(ends[branch], ends[branch + 1]), np.maximum(ends[branch], ends[branch + 1])
    inside = np.abs(v[own] - 0.5 * (low + high)) < 0.5 * _INSIDE * (high - low)
    each = np.bincount(branch[inside], minlength=turns.size + 1)[1:-1] / np.maximum(np.abs(np.diff(v[turns])), 1e-300)
    many = float(np.median(each)) * float(np.ptp(v)) / (2 * _INSIDE)
    from_mean = y - y.mean()
    kurtosis = float(np.mean(from_mean**4) / np.mean(from_mean**2) ** 2)
    noise = kurtosis > _KURTOSIS and noise_span(y) > _FRINGE * float(np.ptp(y))
    if many < _FRINGES or noise or abs(float(np.corrcoef(v, y)[0, 1])) > _FOLLOWS:
        return ""
    return (
        f"the displacement moves up and down about {many:.0f} times in a stroke of the voltage, like the fringes of an "
        "interferometer, the lines of a grating, or a vibration; count fringes or lines, with "
        "displacement=NAME*fringe PERIOD nm or *grating PERIOD um"
    )


def remarks(record: Record) -> Iterator[str]:
    """Yield sentences on the origin of a clean record, by its loops."""
    turns = turns_of(record.voltage)
    if turns.size < 2 or record.stroke < LEAST_STROKE or fringes(record.voltage, record.displacement):
        return
    if sense(record.voltage, record.displacement, record.cycles()) >= 0 and (early := early_turns(record)):
        words = _shift(record, early)
        yield f"{words[0].upper()}{words[1:]}."
    yield from _no_hysteresis(record, turns)
    yield from _clamped(record, turns)
    yield from _slipping(record, turns)


def _no_hysteresis(record: Record, turns: NDArray[np.intp]) -> Iterator[str]:
    """Yield a remark if the displacement is a parabola of the earlier voltage: a lag without hysteresis."""
    v, time = record.voltage, record.time
    # Away from the turns, a lag gives a loop whose width is proportional to the speed.
    places = np.concatenate([np.arange(a + int(_TURNS * (b - a)), b) for a, b in pairwise(turns.tolist())])
    rate = np.gradient(v, time)
    left, (_, gain, _, wide) = _parabola(record, v, places, rate)
    width = float(np.median(np.abs(wide * rate[places])))
    least = _STRAIGHT * record.stroke + 1.2 * record.noise
    if gain * float(np.ptp(v)) < 0.5 * record.stroke or left > least + 0.1 * width or echo(record):
        return
    if width < least - record.noise:
        yield "No hysteresis is found: was a servo on?"
        return
    sizes, lag = np.abs(np.diff(v[turns])), -wide / gain
    # Loops of one size do not distinguish a lag from hysteresis.
    if lag <= 0 or np.ptp(sizes) < _VARIES * sizes.max():
        return
    if _parabola(record, np.interp(time - lag, time, v), slice(None))[0] < least + _ROUND * width:
        yield f"No hysteresis is found beyond a lag of {1e3 * lag:.3g} ms: was a servo on?"


def _parabola(record: Record, voltage: Array, places: Any, *others: Array) -> tuple[float, list[float]]:
    """Return the deviation of the displacement from a parabola of a voltage (n,) and others at places, and weights."""
    away = voltage - voltage.mean()
    columns = np.column_stack([np.ones(away.size), away, away**2, *others])[places]
    scales = np.abs(columns).max(axis=0).clip(1e-300)
    weights = np.linalg.lstsq(columns / scales, record.displacement[places], rcond=None)[0] / scales
    return float(np.std(record.displacement[places] - columns @ weights)), weights.tolist()


def _clamped(record: Record, turns: NDArray[np.intp]) -> Iterator[str]:
    """Yield a remark if the displacement stays within its noise near an extreme of the voltage."""
    branches = [slice(a, b + 1) for a, b in pairwise([0, *turns.tolist(), len(record) - 1])]
    for sign, side in ((1.0, "above"), (-1.0, "below")):
        v, y = sign * record.voltage, sign * record.displacement
        top, span = float(v.max()), float(np.ptp(v))
        own = [part for part in branches if v[part][-1] > top - _EQUAL * span and v[part][0] < v[part][-1] - 0.5 * span]
        if not own:
            continue
        begin = max(top - 0.5 * span, *(v[part][0] for part in own))
        grid = np.linspace(begin, min(v[part][-1] for part in own), 101)
        curve = np.mean([np.interp(grid, np.maximum.accumulate(v[part]), y[part]) for part in own], axis=0)
        gain, doubt = record.stroke / span, _FLAT * record.stroke + 2 * record.noise / sqrt(len(own))
        ahead = grid[-1] - grid
        flat = np.abs(curve - curve[-1]) <= doubt + _CREEPS * gain * ahead
        first = int(np.flatnonzero(~flat)[-1]) + 1 if not flat.all() else 0
        before = np.searchsorted(grid, grid[first] - _PLATEAU * span)
        steep = curve[first] - curve[before] > _SLOPE * gain * (grid[first] - grid[before])
        if 0 < before < first and ahead[first] > _PLATEAU * span and steep and gain * ahead[first] > 4 * doubt:
            yield (
                f"The displacement stays within its noise {side} {sign * grid[first]:.4g} V while the voltage goes on "
                f"to {sign * top:.4g} V: the amplifier or the sensor is at its limit, or the actuator saturates."
            )


def _slipping(record: Record, turns: NDArray[np.intp]) -> Iterator[str]:
    """Yield a remark if the displacement at an extreme of the voltage drifts with travel, not with time."""
    v, y = record.voltage, record.displacement
    lowest = turns[v[turns] < v[turns].min() + _EQUAL * float(np.ptp(v))]
    if lowest.size < _RETURNS:
        return
    travel = np.cumsum(np.abs(np.diff(v, prepend=v[0])))[lowest]
    left = []
    for places in (travel, record.time[lowest]):
        line = np.polyval(np.polyfit(places - places[0], y[lowest], 1), places - places[0])
        left.append(float(np.std(y[lowest] - line)))
    moved = float(y[lowest[-1]] - y[lowest[0]])
    if abs(moved) > _SLIPS * record.stroke and left[1] > _BETTER * (left[0] + record.noise):
        yield (
            f"At {v[lowest].min():.4g} V the displacement shifts by {1e9 * moved:.3g} nm, in proportion to the "
            "travel of the voltage and not to the time: the actuator slips, the sensor does not drift."
        )
