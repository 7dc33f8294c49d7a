"""What is put right before a fit, and said: a start-up transient, gaps, the delay, datums and drifts of records."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from dehyst._native import Array
from dehyst.glitches import Glitch, glitch_sentences, glitches
from dehyst.record import Record
from dehyst.regression import Coefficients, Regression
from dehyst.signals import turning_points

_BINS = 64
_SEARCH_ROWS = 4000
_STEPS = 20
# A repair is made only where it makes the RMS residual smaller by this much.
_WORTH = 0.97
# Loops of one height and rate tell a delay from hysteresis only at their turns: it has to explain much more there.
_WORTH_OF_DELAY = 0.5
# Displacements in a hole that lie beyond those beside it by this part of the stroke show a reversal.
_TURN = 0.02
# A sensor that was zeroed anew shows at once; a small gain is the model bending.
_WORTH_OF_DATUM = 0.8


def without_glitches(record: Record) -> tuple[Record, Mapping[float, bool], tuple[str, ...]]:
    """Leave out the samples of isolated voltage glitches, see `dehyst.glitches`.

    Returns
    -------
    Record
        The same object if there are none.
    Mapping
        Time [s] of the sample before each hole -> whether a reversal may lie in it, by the displacements left out.
    tuple of str
        A sentence for each glitch, of many glitches for some.
    """
    found = glitches(record.time, record.voltage, record.displacement)
    if not found:
        return record, {}, ()
    keep = np.ones(len(record), dtype=bool)
    for one in found:
        keep[one.start : one.stop] = False
    kept = replace(record, time=record.time[keep], voltage=record.voltage[keep],
                   displacement=record.displacement[keep])  # fmt: skip
    holes = dict(_hole(record, one) for one in found if len(one.neighbours) == 2)
    return kept, holes, tuple(f"{record.name}: {said}" for said in glitch_sentences(found))


def _hole(record: Record, glitch: Glitch) -> tuple[float, bool]:
    """Time of the sample before, and whether the displacement turns back within a glitch."""
    before, after = glitch.start - 1, glitch.stop
    ends = sorted(record.displacement[[before, after]].tolist())
    inside = record.displacement[glitch.start : glitch.stop]
    beyond = max(ends[0] - float(inside.min()), float(inside.max()) - ends[1])
    long = record.time[after] - record.time[before] > 1.5 * (after - before) * record.sample_time
    hidden = bool(long) or beyond > max(_TURN * record.stroke, 6 * record.noise)
    return float(record.time[before]), hidden


def transient(record: Record) -> int:
    """Samples at the start of a record that lie outside the loops that follow, 0 if none.

    The first cycle (at most) is compared with the band of displacements that later cycles cover at the same voltage,
    widened by 1.5 % of the stroke or 4 standard deviations of the noise; later cycles must go as far. The transient
    begins with the record and ends where a twentieth of a cycle lies inside. A first rise from an unknown state is left
    out with it: no state is known there.
    """
    cycles = record.cycles()
    if len(cycles) < 3:
        return 0
    begin = cycles[0].stop
    v, y = record.voltage, record.displacement
    tolerance = 0.02 * float(np.ptp(v))
    if v[begin:].max() < v.max() - tolerance or v[begin:].min() > v.min() + tolerance:
        return 0
    edges = np.linspace(v[begin:].min(), v[begin:].max(), _BINS + 1)
    bins = np.clip(np.searchsorted(edges, v) - 1, 0, _BINS - 1)
    low, high = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    np.minimum.at(low, bins[begin:], y[begin:])
    np.maximum.at(high, bins[begin:], y[begin:])
    margin = max(0.015 * float(np.ptp(y[begin:])), 4 * record.noise)
    early = slice(0, begin)
    outside = (y[early] < low[bins[early]] - margin) | (y[early] > high[bins[early]] + margin)
    ends = np.concatenate([[-1], np.flatnonzero(outside), [begin + begin]])
    calm = np.flatnonzero(np.diff(ends) > max(5, begin // 20))
    return int(ends[calm[0]]) + 1


def split_at_gaps(record: Record, holes: Mapping[float, bool] | None = None) -> tuple[list[Record], list[str]]:
    """Cut a record where a gap may hide a reversal; shorter gaps stay, for the model has no time. With sentences.

    Parameters
    ----------
    record : Record
    holes : Mapping, optional
        Of glitches that were left out, see `without_glitches`: what lies in them was measured.
    """
    cuts, said = [0], []
    cycle, known = cycle_time(record), holes or {}
    for i, length in record.gaps():
        jump = abs(float(record.voltage[i + 1] - record.voltage[i]))
        hidden = known.get(float(record.time[i]))
        if hidden is False:
            continue
        hidden = hidden or length > 0.2 * cycle or jump > 0.05 * float(np.ptp(record.voltage))
        where = f"{record.name}: a gap of {length:.4g} s after {record.time[i]:.4g} s"
        if hidden:
            cuts.append(i + 1)
            said.append(f"{where} may hide a reversal; the record was cut there.")
        else:
            said.append(f"{where} was bridged.")
    if len(said) > 5:
        said = [*said[:4], f"{record.name}: {len(said) - 4} more gaps, {len(cuts) - 1} cuts in all."]
    cuts.append(len(record))
    return [record.slice(a, b) for a, b in pairwise(cuts) if b - a >= 20], said


def cycle_time(record: Record) -> float:
    """Median time of a cycle of the excitation [s]; the record's length if it has none."""
    cycles = record.cycles()
    ends = [float(record.time[min(c.stop, len(record) - 1)] - record.time[c.start]) for c in cycles]
    return float(np.median(ends)) if ends else float(record.time[-1] - record.time[0])


def drift_curve(record: Record, start: float) -> Array:
    """Creep since the record's start: log10 of time, mean zero (n,)."""
    scale = 0.1 * cycle_time(record)
    curve = np.log10(1 + (record.time - start) / scale)
    return np.asarray(curve - curve.mean())


def find_delay(build: Callable[[float], Regression], longest: float, sample_time: float) -> float:
    """Seconds by which the displacement lags the voltage: least RMS residual; 0 unless that is worth it.

    Parameters
    ----------
    build : callable
        Delay [s] -> Regression on the voltages delayed by it.
    longest : float
        Largest delay looked for [s]; a displacement that leads has another cause.
    sample_time : float
        [s]; the answer is good to 1 % of it.
    """

    def cost(delay: float) -> float:
        return _rms(build(float(delay)).thinned(_SEARCH_ROWS))

    none = build(0.0)
    return searched_delay(cost, longest, sample_time, none.rows.voltage, _stroke(none))


def searched_delay(
    cost: Callable[[float], float], longest: float, sample_time: float, voltage: Array, stroke: float
) -> float:
    """Seconds at which a cost, an RMS residual [m], is least; 0 unless that is worth it.

    Parameters
    ----------
    cost : callable
        Delay [s] -> [m].
    longest, sample_time : float
        As those of `find_delay`.
    voltage : (n,) array
        Of the samples that count [V]: loops of one height have to tell more.
    stroke : float
        [m].
    """
    best = _search(cost, 0.0, longest, 13, 0.01 * sample_time)
    share = _WORTH_OF_DELAY if _one_height(voltage) else _WORTH
    return best if abs(best) > 0.02 * sample_time and _worth(cost(best), cost(0.0), stroke, share) else 0.0


def _one_height(voltage: Array) -> bool:
    """Whether all legs of the voltage are of one height."""
    turns = turning_points(voltage, 0.02 * float(np.ptp(voltage)))
    legs = np.abs(np.diff(voltage[turns]))
    return legs.size < 2 or bool(legs.min() > 0.9 * legs.max())


def with_datums(regression: Regression, records: list[int], stroke: float) -> Regression:
    """Put records on one axis: each datum looked for by itself, then those found polished together (Gauss-Newton).

    A datum that was looked for while others were still wrong may have been missed, hence two rounds.
    """
    few = regression.thinned(_SEARCH_ROWS)
    for _ in range(2 if len(records) > 1 else 1):
        for q in records:
            if not few.datum[q]:
                datum = few.datum.copy()
                datum[q] = find_datum(few, q, stroke)
                few = replace(few, datum=datum)
        few = _polished(few, [q for q in records if few.datum[q]])
    return replace(regression, datum=few.datum)


def _polished(regression: Regression, records: list[int]) -> Regression:
    """All these datums at once; each step may only make the residual smaller."""
    if not records:
        return regression
    best = _rms(regression)
    for _ in range(_STEPS):
        datum = regression.datum.copy()
        datum[records] += regression.datum_steps(records)
        trial = replace(regression, datum=datum)
        cost = _rms(trial)
        if not cost < best:
            break
        regression, best = trial, cost
    return regression


def find_datum(regression: Regression, record: int, stroke: float, given: Coefficients | None = None) -> float:
    """Shift d_q [m] that puts a record on the axis of the others, or of a given model; 0 unless that is worth it."""
    few = regression.thinned(_SEARCH_ROWS)

    def cost(shift: float) -> float:
        datum = few.datum.copy()
        datum[record] = shift
        return _rms(replace(few, datum=datum), given)

    best = _search(cost, -0.6 * stroke, 0.6 * stroke, 25, 1e-9 * stroke)
    return best if _worth(cost(best), cost(0.0), _stroke(few), _WORTH_OF_DATUM) else 0.0


def find_drifts(regression: Regression, candidates: list[int]) -> tuple[int, ...]:
    """Records among the candidates whose creep since the start is worth a coefficient."""
    few = regression.thinned(_SEARCH_ROWS)
    return worthwhile(lambda drifting: _rms(replace(few, drifting=drifting)), candidates, _stroke(few))


def worthwhile(cost: Callable[[tuple[int, ...]], float], candidates: Sequence[int], stroke: float) -> tuple[int, ...]:
    """Those of the candidates that make a cost, an RMS residual [m], worthily smaller, one after another."""
    kept: tuple[int, ...] = ()
    best = cost(kept)
    for q in candidates:
        trial = cost((*kept, q))
        if _worth(trial, best, stroke):
            kept, best = (*kept, q), trial
    return kept


def _worth(after: float, before: float, stroke: float, share: float = _WORTH) -> bool:
    """Whether a repair makes the RMS residual smaller, by more than a hundred-thousandth of the stroke."""
    return after < share * before and before - after > 1e-5 * stroke


def _stroke(regression: Regression) -> float:
    return float(np.ptp(regression.knots))


def _rms(regression: Regression, given: Coefficients | None = None) -> float:
    """RMS residual [m], of the best model or of the given one."""
    found = regression.fit("l2") if given is None else regression.nuisances_of(given)
    return regression.rms(found)


def _search(cost: Callable[[float], float], low: float, high: float, points: int, tolerance: float) -> float:
    """Global scan on `points` places, then Brent's method between the neighbours of the best."""
    from scipy.optimize import minimize_scalar

    grid = np.linspace(low, high, points)
    k = int(np.argmin([cost(float(x)) for x in grid]))
    bounds = grid[max(k - 1, 0)], grid[min(k + 1, points - 1)]
    found = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": tolerance, "maxiter": 60})
    return float(found.x)
