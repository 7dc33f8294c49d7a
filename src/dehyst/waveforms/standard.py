"""Standard excitations: voltages for the loops or creep of an actuator, for homing, and for a stage's coupling.

All take `drive`, the speed, shape and sampling. They raise `RecordError` if a voltage or a number is impossible or
outside of the limits, the record would have more than 5e7 samples, or the slew rate is too low for the sample rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import DEFAULT_AXES, axis_names
from dehyst._validation import count as whole
from dehyst.waveforms.excitation import Excitation, Leg, Sampling, positive, voltages, volts

_PAPER = Sampling()
_MOST_TURNS = 1_000_000
# Least height of a leg between random turning points, as a part of the range.
_LEAST_LEG = 0.08
# Time of the shortest of them, as a part of half a cycle.
_SHORT = 0.3
# Turning points of a path to follow, as fractions of the stroke: nine of them, no two alike.
TURNS = (0.02, 0.95, 0.2, 0.7, 0.35, 0.85, 0.1, 0.6, 0.45, 0.9, 0.3)
# Periods of the axes of a stage moving together, in those of the first one: powers of the plastic number repeat never.
RATIO = 1.3247179572447460


def raised_cosine(peaks: ArrayLike, *, cycles: int = 1, drive: Sampling = _PAPER) -> Excitation:
    """Return cycles base -> peak -> base, ``v = base + (peak - base) (1 - cos(2 pi f t)) / 2`` (paper, Sec. 3).

    `peaks`: one or (m,) voltages [V] above the base. `cycles`: number of cycles to each of them. `drive`: how it is
    played. Raise `RecordError` as all excitations do.
    """
    several: Any = [peaks] if isinstance(peaks, Real) or getattr(peaks, "ndim", None) == 0 else peaks
    tops = voltages(several, "peaks")
    if not tops.size or np.any(tops <= drive.base):
        raise RecordError(argument="peaks", got=tops, need=f"voltages above the base {drive.base:g} V")
    turns = [v for top in tops.tolist() for v in _cycles(cycles, "cycles", top, drive.base, rows=tops.size)]
    return _through("raised-cosine" if drive.shape == "cosine" else "triangle", turns, drive)


def descending_tops(
    highest: float, *, steps: int = 10, majors: int = 2, random: int = 0, drive: Sampling = _PAPER
) -> Excitation:
    """Return major cycles, then cycles with tops that fall from `highest` to 1/steps of it in equal steps.

    With as many tops as elements, they determine every stiffness that loops can determine. The first cycle homes the
    actuator from any state.

    `highest` [V], above the base, to which all cycles go down. `steps`: number of tops; the first top is `highest`.
    `majors`: number of cycles up to `highest` before the tops. `random`: number of random turning points after the
    tops, always the same ones. Identification holds out parts of the record; with some 24 such turning points these
    parts differ from the rest, and test the model for any path. `drive`: speed, shape and sampling. Raise `RecordError`
    as all excitations do.
    """
    top, number = _top(highest, drive), _count(steps, "steps")
    tops = drive.base + (top - drive.base) * np.linspace(1, 1 / number, number)
    tops[0] = top
    falling = [v for peak in tops.tolist() for v in (peak, drive.base)]
    anywhere = [drive.base + (top - drive.base) * turn for turn in _random_turns(_count(random, "random", least=0))]
    legs = drive.legs([drive.base, *_cycles(majors, "majors", top, drive.base, least=0), *falling])
    # Shorter legs take less time, as in use, but not so much less that they look like a second speed.
    ends = list(pairwise([drive.base, *anywhere])) if anywhere else []
    shares = [_SHORT + (1 - _SHORT) * abs(b - a) / (top - drive.base) for a, b in ends]
    legs += [Leg(a, b, drive.half * share) for (a, b), share in zip(ends, shares, strict=True)]
    return drive.play("descending-tops", drive.lead_in(top - drive.base) + legs)


def reversal_curves(
    highest: float, *, lowest: float | None = None, count: int = 10, majors: int = 1, drive: Sampling = _PAPER
) -> Excitation:
    """Return first-order reversal curves: major cycles, then highest -> a -> highest for falling a, then the base.

    `highest` [V], above the base. `lowest` [V]: the last a; by default the base. If `lowest` is below the base, major
    cycles go down to it too. `count`: number of curves, from `highest` down in equal steps. `majors`: number of major
    cycles. `drive`: how it is played. Raise `RecordError` as all excitations do.
    """
    top = _top(highest, drive)
    bottom = drive.base if lowest is None else volts(lowest, "lowest")
    if not bottom < top:
        raise RecordError(argument="lowest", got=f"{bottom:g} V", need=f"a voltage below the highest, {top:g} V")
    levels = np.linspace(top, bottom, _count(count, "count") + 1)[1:]
    curves = [top, *(v for level in levels.tolist() for v in (level, top)), drive.base]
    major_cycles = _cycles(majors, "majors", top, min(bottom, drive.base), least=0)
    return _through("reversal-curves", major_cycles + curves, drive)


def minor_loop(
    low: float, high: float, *, highest: float, cycles: int = 1, majors: int = 2, drive: Sampling = _PAPER
) -> Excitation:
    """Return major cycles, then a minor loop with its lead-in: base -> high -> low -> high ... -> base.

    The first major cycle homes the actuator; the second one is the major loop.

    `low`, `high` [V]: turning points, base <= low < high <= highest. `highest` [V]: top of the major cycles. `majors`:
    number of major cycles. `cycles`: number of minor cycles. `drive`: how it is played. Raise `RecordError` as all
    excitations do.
    """
    top, lower, upper = _top(highest, drive), volts(low, "low"), volts(high, "high")
    if not drive.base <= lower < upper <= top:
        raise RecordError(
            f"minor loop: got {lower:g} to {upper:g} V, need low below high, both between the base {drive.base:g} V "
            f"and the highest, {top:g} V"
        )
    rounds = [upper, *_cycles(cycles, "cycles", lower, upper), drive.base]
    return _through("minor-loop", _cycles(majors, "majors", top, drive.base, least=0) + rounds, drive)


def staircase(
    highest: float,
    *,
    steps: int = 5,
    hold: float = 60.0,
    ramp: float | None = None,
    back: bool = False,
    drive: Sampling = _PAPER,
) -> Excitation:
    """Return equal steps from the base up to `highest` and down again; a hold after each step shows creep.

    Parameters
    ----------
    highest : float
        [V], above the base.
    steps : int
        Number of steps up, and down.
    hold : float
        Time at each voltage [s], to the next sample; the last hold is at the base.
    ramp : float, optional
        Time from one voltage to the next [s], at least four samples; by default all steps up take half a cycle.
    back : bool
        Whether one step back follows each two steps. These inner loops at all levels determine stiffnesses that tops
        with returns to the base leave open.
    drive : Sampling
        How it is played; its pace has no effect.

    Raises
    ------
    RecordError
    """
    top, number = _top(highest, drive), _count(steps, "steps")
    waiting = positive(hold, "hold")
    moving = drive.half / number if ramp is None else positive(ramp, "ramp")
    places = [0]
    while places[-1] < number:
        places.append(min(places[-1] + 1 + back, number))
        if back and places[-1] < number:
            places.append(places[-1] - 1)
    levels = np.linspace(drive.base, top, number + 1).tolist()
    path = [levels[i] for i in places] + [levels[number - i] for i in places[1:]]
    stairs = [part for a, b in pairwise(path) for part in (Leg(a, b, moving), Leg(b, b, waiting))]
    return drive.play("staircase", drive.lead_in(top - drive.base) + stairs)


def homing(highest: float | None = None, *, turns: ArrayLike | None = None, drive: Sampling = _PAPER) -> Excitation:
    """Return a voltage that homes an actuator: base -> highest -> base, or straight through given turning points.

    `highest` [V], above the base. `turns` (m,) [V], instead of `highest`: voltages to visit in this order, from the
    present voltage (by default the base) to the last of `turns`. `drive`: how it is played. Raise `RecordError` as all
    excitations do, or unless exactly one of `highest` and `turns` is given.
    """
    if (turns is None) == (highest is None):
        got = f"{'neither' if turns is None else 'both'} of highest and turns"
        raise RecordError(argument="homing", got=got, need="one", hint="try the highest voltage in use")
    if turns is None:
        return _through("homing", [_top(highest, drive), drive.base], drive)
    stops = voltages(turns, "turns").tolist()
    if stops[:1] == [drive.start]:
        del stops[0]
    if not 0 < len(stops) <= _MOST_TURNS:
        got = f"{len(stops)} beside the present {drive.start:g} V"
        raise RecordError(argument="turns", got=got, need=f"1 to {_MOST_TURNS} voltages")
    return drive.play("homing", drive.legs([drive.start, *stops]))


def stage_excitation(
    highest: Sequence[float],
    *,
    drive: Sequence[Sampling] | Sampling | None = None,
    steps: int = 10,
    majors: int = 2,
    cycles: int = 12,
    axes: Sequence[str] | None = None,
    seed: int = 0,
) -> Excitation:
    """Return descending tops on each axis in turn, the others at their base, then turns of all axes together.

    When moving together, each axis turns at its own levels, and the periods are powers of an irrational ratio, so that
    no combination of states repeats. The excitation has `axes`, and `parts` "x alone", ... and "together".

    Parameters
    ----------
    highest : (axes,) sequence of float
        Highest voltage [V] of each axis.
    drive : Sampling or sequence of Sampling, optional
        How each axis is sampled: base, frequency, limits and slew rate; one sample rate for all.
    steps, majors : int
        As in `descending_tops`, for each axis alone.
    cycles : int
        Cycles of the first axis when all move together; 0: only one axis after the other.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z.
    seed : int
        Seed of the levels at which the axes turn when moving together.

    Raises
    ------
    RecordError
        As `descending_tops`, or if the axes have different sample rates.
    """
    count = len(highest)
    names = axis_names(DEFAULT_AXES[:count] if axes is None else axes, count, "excitation", RecordError)
    drives = [drive or Sampling()] * count if drive is None or isinstance(drive, Sampling) else list(drive)
    if len(drives) != count or len({one.rate for one in drives}) > 1:
        raise RecordError(f"drive: need one Sampling an axis, {count}, and one sample rate for all")
    alone = [
        descending_tops(top, steps=steps, majors=majors, drive=one) for top, one in zip(highest, drives, strict=True)
    ]
    together = [
        # From the base, with another period and the same samples.
        _turns(
            top,
            replace(one, present=None, sample_rate=one.rate, frequency=one.frequency / RATIO**j),
            max(3, round(cycles / RATIO**j)),
            seed + j,
        )
        if cycles
        else np.zeros(0)
        for j, (top, one) in enumerate(zip(highest, drives, strict=True))
    ]
    most = max(map(len, together)) if cycles else 0
    sizes = [len(one) for one in alone]
    voltage = np.empty((sum(sizes) + most, count))
    first, parts = 0, []
    for j, one in enumerate(alone):
        rest = [other.base if k < j else other.start for k, other in enumerate(drives)]
        voltage[first : first + len(one)] = rest
        voltage[first : first + len(one), j] = one.voltage
        parts.append((f"{names[j]} alone", first, first + len(one)))
        first += len(one)
    if cycles:
        for j, row in enumerate(together):
            voltage[first:, j] = np.concatenate([row, np.full(most - len(row), row[-1])])
        parts.append(("together", first, first + most))
    return Excitation("stage", voltage, drives[0].rate, axes=names, parts=tuple(parts))


def wanted_path(stroke: float, turns: tuple[float, ...] = TURNS, *, leg: int = 200) -> Array:
    """Return a path through turning points in shares of the stroke, joined by cosines of `leg` samples."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, leg + 1) / leg)
    legs = [start + (end - start) * rise for start, end in pairwise(turns)]
    return stroke * np.concatenate([[turns[0]], *legs])


def _through(name: str, turns: list[float], drive: Sampling) -> Excitation:
    """Return the excitation from the present voltage to the base and on through the turning points."""
    path = [drive.base, *turns]
    legs = drive.legs(path)
    return drive.play(name, drive.lead_in(max(path) - min(path)) + legs)


def _cycles(cycles: object, what: str, first: float, second: float, *, least: int = 1, rows: int = 1) -> list[float]:
    """Return two turning points repeated for each cycle, for one or several such rows."""
    return [first, second] * _count(cycles, what, least, _MOST_TURNS // (2 * rows))


def _random_turns(count: int) -> list[float]:
    """Return a number of alternating top and bottom turning points, as parts of the range, and the way back to 0."""
    rng, turns = np.random.default_rng(0), [0.0]
    for k in range(count):
        below, above = (turns[-1] + _LEAST_LEG, 1.0) if k % 2 == 0 else (0.0, turns[-1] - _LEAST_LEG)
        turns.append(float(rng.uniform(below, above)))
    return [*turns[1:], 0.0] if count else []


def _count(value: object, what: str, least: int = 1, most: int = _MOST_TURNS // 4) -> int:
    return whole(value, what, least, most, error=RecordError)


def _top(highest: object, drive: Sampling) -> float:
    top = volts(highest, "highest")
    if top <= drive.base:
        raise RecordError(argument="highest", got=f"{top:g} V", need=f"a voltage above the base {drive.base:g} V")
    return top


def _turns(highest: float, drive: Sampling, cycles: int, seed: int) -> Array:
    """Return voltages between levels that fill the range, each half cycle of one duration."""
    rng = np.random.default_rng([18, seed])
    span = highest - drive.base
    tops = drive.base + span * rng.permuted((np.arange(cycles) + 1.0) / cycles * 0.55 + 0.45)
    lows = drive.base + span * rng.permuted((np.arange(cycles) + 0.5) / cycles * 0.4)
    levels = [drive.base, *np.column_stack([tops, lows]).ravel()[:-1].tolist(), drive.base]
    return homing(turns=levels, drive=drive).voltage
