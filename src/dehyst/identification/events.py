"""Records with displacements at events only: interpolation between events, first simple, then by a model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dehyst._native import slip_elongations
from dehyst._types import Array, Mask
from dehyst.records import Record, interpolate, noise_span, reversals, rms, thinned, turning_points

if TYPE_CHECKING:
    from dehyst.identification.fit import Fit

# Least turn, as a share of the voltage's range. If a model changes the filled displacements by a smaller RMS, as a
# share of the stroke, they stay; a lag, which the first fill does not know, changes them by more.
_TURN, _STILL = 5e-3, 2e-3
# Number of elements of a rough model, and their ridge.
_ELEMENTS, _RIDGE = 12, 1e-3


def filled(record: Record) -> Record:
    """Return a record whose displacement between events is interpolated over the voltage, from turn to turn.

    From turn to turn, a branch passes through its events, and is monotone where they are. The displacement at a turn
    comes from a rough model of all events, corrected by its errors at neighbouring events. A record without `measured`
    is returned unchanged.
    """
    known, v, y = record.measured, record.voltage, record.displacement
    if known is None or np.count_nonzero(known) < 2:
        return record
    least = max(_TURN * float(np.ptp(v)), noise_span(v))
    turns = np.unique([0, *turning_points(v, least), v.size - 1])
    branches = [(a, b + 1, _rising(v[a : b + 1])) for a, b in pairwise(turns.tolist())]
    path = np.concatenate([x[int(a > 0) :] if v[b - 1] >= v[a] else -x[int(a > 0) :] for a, b, x in branches])
    levels = np.where(known, y, _rough(path, known, turns, y))
    new = levels.copy()
    for a, b, _ in branches:
        # The turns of a branch are its extremes: no event lies beyond them.
        own, up = np.flatnonzero(known[a:b]), np.sign(v[b - 1] - v[a])
        for turn, side in ((a, -up), (b - 1, up)):
            if own.size and not known[turn]:
                levels[turn] = side * max(side * levels[turn], *(side * y[a + own]).tolist())
    for a, b, x in branches:
        knots = np.unique([0, *np.flatnonzero(known[a:b]), x.size - 1])
        new[a:b] = interpolate(x[knots], levels[a + knots], x)
    return replace(record, displacement=np.where(known, y, new))


def refilled(record: Record, time: Array, simulated: Array) -> Record:
    """Return a record whose displacement between events is a simulation, corrected by its errors at the events.

    The correction is linear in time between events. `time`, `simulated` (n,) [s], [m]: the simulation, which may have
    another zero. The record does not change before, after, and in gaps of the simulation.
    """
    known, when = record.measured, record.time
    if known is None:
        return record
    step = record.sample_time
    late = np.abs(when - time[np.clip(np.searchsorted(time, when - 0.5 * step), 0, time.size - 1)]) < step
    own = known & late
    if not own.any():
        return record
    path = np.interp(when, time, simulated)
    path += np.interp(when, when[own], record.displacement[own] - path[own])
    return replace(record, displacement=np.where(late & ~known, path, record.displacement))


def identified(
    records: Sequence[Record],
    held_out: Sequence[Record],
    identify: Callable[[list[Record], list[Record]], Fit],
    rounds: int = 2,
) -> Fit:
    """Return the fit of records; records of events are filled, then refilled by each fit until they hardly change.

    `held_out`: records to validate. `identify`: function that fits records; it gets the turns of the voltage as further
    events, and its first traces belong to the records, in order. `rounds`: largest number of fits after the first.
    """
    now, others = ([filled(thinned(record)) for record in some] for some in (records, held_out))
    fit = identify([_with_turns(record) for record in now], others)
    for _ in range(rounds if any(record.measured is not None for record in now) and fit.traces else 0):
        traces = zip(now, fit.traces, strict=False)
        before, now = now, [refilled(record, trace.time, trace.simulated) for record, trace in traces]
        moved = [rms(a.displacement - b.displacement) / a.stroke for a, b in zip(before, now, strict=True)]
        if max(moved) < _STILL:
            break
        fit = identify([_with_turns(record) for record in now], others)
    return fit


def _with_turns(record: Record) -> Record:
    """Return a record whose filled displacements at turns and ends count like events: no event may lie near them."""
    if record.measured is None:
        return record
    known = record.measured.copy()
    known[[0, *reversals(record), -1]] = True
    return replace(record, measured=known)


def _rising(voltage: Array) -> Array:
    """Return the voltages of a branch (n,), negated if it falls: strictly rising, without noise, also in holds."""
    from scipy.optimize import isotonic_regression

    smooth = np.asarray(isotonic_regression(voltage if voltage[-1] >= voltage[0] else -voltage).x)
    return smooth + 1e-9 * max(float(np.ptp(smooth)), 1e-9) * np.arange(voltage.size)


def _rough(path: Array, known: Mask, turns: NDArray[np.intp], displacement: Array) -> Array:
    """Return displacements (n,) [m], exact at turns only: a model of elements, corrected by its errors at events."""
    at = np.union1d(np.flatnonzero(known), turns)
    v, own = path[at], known[at]
    half = 0.5 * float(np.ptp(v))
    x = (v - v.min()) / half - 1
    rho = half * np.linspace(0, 1, _ELEMENTS + 1)[1:] ** 2
    slips = slip_elongations(rho, np.full(rho.size, v[0]), np.ascontiguousarray(v))[0] / half
    columns = np.hstack([np.vander(x, 4), slips, slips * x[:, None]])
    y = displacement[at[own]]
    # The coefficients of a straight line have no ridge.
    ridge = np.delete(np.eye(columns.shape[1]), [2, 3], axis=0) * (_RIDGE * y.size) ** 0.5
    model = columns @ np.linalg.lstsq(np.vstack([columns[own], ridge]), np.append(y, np.zeros(len(ridge))))[0]
    travel = np.append(0, np.cumsum(np.abs(np.diff(v))))
    model += np.interp(travel, travel[own], y - model[own])
    return np.asarray(np.interp(np.arange(path.size), at, model))
