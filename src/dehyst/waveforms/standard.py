"""Standard excitations: voltages for the loops or creep of an actuator, for homing, and for a stage's coupling.

All functions take `drive`, the speed and sampling. They raise `RecordError` if a voltage or a number is impossible or
outside of the limits, the record would have more than 5e7 samples, or the slew rate is too low for the sample rate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import DEFAULT_AXES, axis_names
from dehyst._validation import count as whole
from dehyst.waveforms.excitation import STEEPEST, Branch, Excitation, Sampling, positive, voltages, volts

_PAPER, _PACE = Sampling(), Sampling(0.1)
# Recommended excitation: numbers of major loops and falling tops; duration of each of its two holds in cycles; numbers
# of random turning points at each of three speeds; index of the turning point with a hold; ratio of the speeds.
_LOOPS, _TOPS, _HOLD, _TURNS, _HELD, FASTER = 2, 5, 3.0, (12, 12, 24), 10, 25.0
# Least number of samples of a cycle at the largest speed; default number at the smallest speed, also for `calibrate`.
_FEWEST, _SAMPLES = 16, 1000
_MOST_TURNS = 1_000_000
_count = partial(whole, least=1, most=_MOST_TURNS // 4, error=RecordError)
# Branches between random turning points: least height, as a part of the range; least time, as a part of half a cycle.
_LEAST_BRANCH, _SHORT = 0.08, 0.3
# Turning points of a wanted path, as fractions of the stroke: nine between its ends, all different.
TURNS = (0.02, 0.95, 0.2, 0.7, 0.35, 0.85, 0.1, 0.6, 0.45, 0.9, 0.3)
# Ratio of the periods of successive axes that move together (plastic number): no combination of phases repeats.
RATIO = 1.3247179572447460


def recommended(highest: float, *, drive: Sampling = _PACE) -> Excitation:
    """Return the excitation for an identification: one run of about 17 cycles, with two holds and three speeds.

    It has two major loops, the second one with a hold at the top, and loops with falling tops. Then come random turning
    points, always the same: twelve slow ones with a second hold, the last ones up to 25 times as fast.

    `highest` [V], above the base. `drive`: slowest speed, by default 0.1 Hz, and sampling, by default 1000 samples per
    slow cycle. Raise `RecordError` as all excitations do.
    """
    drive = replace(drive, sample_rate=drive.sample_rate or _SAMPLES * drive.frequency)
    top, hold = _top(highest, drive), _HOLD / drive.frequency
    height, tops = top - drive.base, [*(top,) * _LOOPS, *_tops(top, _TOPS, drive)[1:]]
    branches = drive.branches([drive.base, *(v for peak in tops for v in (peak, drive.base))])
    branches.insert(2 * _LOOPS - 1, Branch(top, top, hold))
    steepest = math.inf if drive.slew_rate is None else drive.slew_rate / (2 * STEEPEST * drive.frequency * height)
    fastest = max(1.0, min(FASTER, drive.rate / (_FEWEST * drive.frequency), steepest))
    speeds = np.repeat(fastest ** np.array([0.0, 0.5, 1.0]), _TURNS).tolist()
    ends = [drive.base + height * turn for turn in (0.0, *_random_turns(len(speeds)), 0.0)]
    for k, (now, end, speed) in enumerate(zip(ends[:-1], ends[1:], [*speeds, 1.0], strict=True), 1):
        branches.append(Branch(now, end, drive.half * (_SHORT + (1 - _SHORT) * abs(end - now) / height) / speed))
        branches += [Branch(end, end, hold)] if k == _HELD else []
    # A slew rate slows the requested turns too.
    free = drive.slew_rate and recommended(highest, drive=replace(drive, slew_rate=None)).duration
    made = drive.play("recommended", drive.lead_in(height) + branches, free)
    possible = min(FASTER, steepest)
    warning = (
        f"at {drive.rate:g} Hz the fastest turns are only {fastest:.3g} times as fast as the slowest; a sample rate of "
        f"{possible * _FEWEST * drive.frequency:.4g} Hz allows {possible:.3g} times"
    )
    return replace(made, warnings=(*made.warnings, *[warning] * (fastest < possible)))


def raised_cosine(peaks: ArrayLike, *, cycles: int = 1, drive: Sampling = _PAPER) -> Excitation:
    """Return cycles base -> peak -> base, ``v = base + (peak - base) (1 - cos(2 pi f t)) / 2`` (paper, Sec. 3).

    `peaks`: one or (m,) voltages [V] above the base. `cycles`: number of cycles to each peak. `drive`: speed and
    sampling. Raise `RecordError` as all excitations do.
    """
    several: Any = [peaks] if isinstance(peaks, Real) or getattr(peaks, "ndim", None) == 0 else peaks
    tops = voltages(several, "peaks")
    if not tops.size or np.any(tops <= drive.base):
        raise RecordError(argument="peaks", got=tops, need=f"voltages above the base {drive.base:g} V")
    turns = [v for top in tops.tolist() for v in _cycles(cycles, "cycles", top, drive.base, rows=tops.size)]
    return _through("raised-cosine", turns, drive)


def descending_tops(highest: float, *, steps: int = 10, majors: int = 2, drive: Sampling = _PAPER) -> Excitation:
    """Return major cycles, then cycles with tops that fall from `highest` to 1/steps of it in equal steps.

    If there are as many tops as elements, they determine every stiffness that loops can determine. The first cycle
    homes the actuator from any state.

    `highest` [V], above the base, where all cycles end. `steps`: number of tops; the first top is `highest`.
    `majors`: number of cycles up to `highest` before the tops. `drive`: speed and sampling. Raise `RecordError` as all
    excitations do.
    """
    top = _top(highest, drive)
    falling = [v for peak in _tops(top, _count(steps, "steps"), drive) for v in (peak, drive.base)]
    return _through("descending-tops", _cycles(majors, "majors", top, drive.base, least=0) + falling, drive)


def staircase(
    highest: float, *, steps: int = 5, hold: float = 60.0, back: bool = False, drive: Sampling = _PAPER
) -> Excitation:
    """Return equal steps from the base up to `highest` and down again; a hold after each step shows creep.

    All steps up together take half a cycle. `highest` [V], above the base. `steps`: number of steps up, and down.
    `hold`: time at each voltage [s], rounded up to a sample; the last hold is at the base. `back`: whether one step
    back follows each two steps. These inner loops determine stiffnesses that cycles from the base do not determine.
    `drive`: speed and sampling. Raise `RecordError` as all excitations do.
    """
    top, number, waiting = _top(highest, drive), _count(steps, "steps"), positive(hold, "hold")
    moving = drive.half / number
    places = [0]
    while places[-1] < number:
        places.append(min(places[-1] + 1 + back, number))
        if back and places[-1] < number:
            places.append(places[-1] - 1)
    levels = np.linspace(drive.base, top, number + 1).tolist()
    path = [levels[i] for i in places] + [levels[number - i] for i in places[1:]]
    stairs = [part for a, b in pairwise(path) for part in (Branch(a, b, moving), Branch(b, b, waiting))]
    return drive.play("staircase", drive.lead_in(top - drive.base) + stairs)


def homing(highest: float | None = None, *, turns: ArrayLike | None = None, drive: Sampling = _PAPER) -> Excitation:
    """Return a voltage that homes an actuator: base -> highest -> base, or straight through given turning points.

    `highest` [V], above the base. `turns` (m,) [V], instead of `highest`: voltages to visit in this order, from the
    present voltage (by default the base) to the last of `turns`. `drive`: speed and sampling. Raise `RecordError` as
    all excitations do, and unless exactly one of `highest` and `turns` is given.
    """
    if (turns is None) == (highest is None):
        got = f"{'neither' if turns is None else 'both'} of highest and turns"
        raise RecordError(argument="homing", got=got, need="one of them", hint="try the highest voltage in use")
    if turns is None:
        return _through("homing", [_top(highest, drive), drive.base], drive)
    stops = voltages(turns, "turns").tolist()
    if stops[:1] == [drive.start]:
        del stops[0]
    if not 0 < len(stops) <= _MOST_TURNS:
        got = f"{len(stops)} beside the present {drive.start:g} V"
        raise RecordError(argument="turns", got=got, need=f"1 to {_MOST_TURNS} voltages")
    return drive.play("homing", drive.branches([drive.start, *stops]))


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
    """Return descending tops on each axis in turn, with the others at the base, then a motion of all axes together.

    In this motion each axis turns at other levels, and the ratio of the periods is irrational, so that no combination
    of states repeats. The excitation has `axes`, and `parts` "x alone", ... and "together". Raise `RecordError` as all
    excitations do, and if the axes have different sample rates.

    Parameters
    ----------
    highest : (axes,) sequence of float
        Highest voltage [V] of each axis.
    drive : Sampling or sequence of Sampling, optional
        Base, frequency, limits and slew rate of each axis; all have one sample rate.
    steps, majors : int
        As in `descending_tops`, for each axis alone.
    cycles : int
        Cycles of the first axis in the motion of all axes together; 0: no such motion.
    axes : sequence of str, optional
        Names of the axes; default: x, y, z.
    seed : int
        Seed of the levels at which the axes turn in this motion.
    """
    count = len(highest)
    names = axis_names(DEFAULT_AXES[:count] if axes is None else axes, count, "excitation", RecordError)
    drives = [drive or Sampling()] * count if drive is None or isinstance(drive, Sampling) else list(drive)
    if len(drives) != count or len({own.rate for own in drives}) > 1:
        raise RecordError(f"drive: need one Sampling an axis, {count}, and one sample rate for all")
    driven = list(zip(highest, drives, strict=True))
    moves = [
        {j: descending_tops(top, steps=steps, majors=majors, drive=own).voltage} for j, (top, own) in enumerate(driven)
    ]
    if cycles:
        # Each axis starts from the base, with another period and the same sample rate.
        slower = [
            replace(own, present=None, sample_rate=own.rate, frequency=own.frequency / RATIO**j)
            for j, own in enumerate(drives)
        ]
        moves.append(
            {j: _turns(highest[j], slower[j], max(3, round(cycles / RATIO**j)), seed + j) for j in range(count)}
        )
    still, blocks, parts, first = [own.start for own in drives], [], [], 0
    for name, moving in zip([*(f"{name} alone" for name in names), "together"], moves, strict=False):
        block = np.tile(still, (max(map(len, moving.values())), 1))
        for j, row in moving.items():
            still[j] = float(row[-1])
            block[: len(row), j], block[len(row) :, j] = row, still[j]
        blocks.append(block)
        parts.append((name, first, first + len(block)))
        first += len(block)
    return Excitation("stage", np.concatenate(blocks), drives[0].rate, axes=names, parts=tuple(parts))


def wanted_path(stroke: float, turns: tuple[float, ...] = TURNS, *, branch: int = 200) -> Array:
    """Return a path through turning points in shares of the stroke, joined by cosines of `branch` samples."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, branch + 1) / branch)
    branches = [start + (end - start) * rise for start, end in pairwise(turns)]
    return stroke * np.concatenate([[turns[0]], *branches])


def _through(name: str, turns: list[float], drive: Sampling) -> Excitation:
    """Return the excitation from the present voltage to the base and on through the turning points."""
    path = [drive.base, *turns]
    return drive.play(name, drive.lead_in(max(path) - min(path)) + drive.branches(path))


def _cycles(cycles: object, what: str, first: float, second: float, *, least: int = 1, rows: int = 1) -> list[float]:
    """Return two turning points repeated for each cycle; `rows`: number of such repetitions in the excitation."""
    return [first, second] * _count(cycles, what, least=least, most=_MOST_TURNS // (2 * rows))


def _tops(top: float, steps: int, drive: Sampling) -> list[float]:
    """Return tops [V] that fall in equal steps, the highest one exact."""
    return [top, *(drive.base + (top - drive.base) * np.linspace(1, 1 / steps, steps))[1:].tolist()]


def _random_turns(count: int) -> list[float]:
    """Return random turning points, alternately top and bottom, as parts of the range."""
    rng, turns = np.random.default_rng(0), [0.0]
    for k in range(count):
        below, above = (turns[-1] + _LEAST_BRANCH, 1.0) if k % 2 == 0 else (0.0, turns[-1] - _LEAST_BRANCH)
        turns.append(float(rng.uniform(below, above)))
    return turns[1:]


def _top(highest: object, drive: Sampling) -> float:
    top: float = volts(highest, "highest")
    if top <= drive.base:
        raise RecordError(argument="highest", got=f"{top:g} V", need=f"a voltage above the base {drive.base:g} V")
    return top


def _turns(highest: float, drive: Sampling, cycles: int, seed: int) -> Array:
    """Return voltages between random levels that fill the range; all half cycles have one duration."""
    rng = np.random.default_rng([18, seed])
    span = highest - drive.base
    tops = drive.base + span * rng.permuted((np.arange(cycles) + 1.0) / cycles * 0.55 + 0.45)
    lows = drive.base + span * rng.permuted((np.arange(cycles) + 0.5) / cycles * 0.4)
    levels = [drive.base, *np.column_stack([tops, lows]).ravel()[:-1].tolist(), drive.base]
    return homing(turns=levels, drive=drive).voltage
