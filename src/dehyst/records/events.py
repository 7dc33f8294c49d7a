"""Known positions in place of a sensor: events at samples, and the counting of a periodic signal."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import RecordError
from dehyst._text import digits
from dehyst._types import Array
from dehyst._validation import choice, number, vector
from dehyst.records.signals import noise_span, resolution, runs, turning_points

if TYPE_CHECKING:
    from dehyst.records.record import Record

# Least number of events of a record, and of its longest branch; a longer record is thinned to this number of samples,
# unless they would then be farther apart than events, by this quantile of the distances of events.
_FEWEST, _MOST, _NEAR = 4, 10_000, 0.05
# A crossing goes from minus to plus this part of the amplitude; an extreme lies among samples above the second part.
_BAND, _TOP = 0.35, 0.6
# Least part of its range by which a signal returns from an extreme; number of extremes whose median is a level.
_SWING, _LEVELS = 0.3, 5
# Turns of the voltage below this part of its range, or of the way between crossings, do not change a count.
_LEAST_TURN, _SMALL_TURN = 1e-3, 0.2
# A late displacement may turn between two crossings if their distance is below this share of the usual way; a signal
# within this amplitude between two crossings has no extreme there; a branch with this share of samples at rest is held.
_TWICE, _EXTREME, _HELD = 0.4, 0.95, 0.5
# Largest step of the voltage in a sample, and largest change with the signal near its middle, in half periods; largest
# change without a crossing, in usual ways.
_STEP, _STAYS, _LONGEST = 0.5, 0.6, 3.5
# Bounds of a way between crossings, in ways beside it: a longer way lost a period, a shorter way has an extra period.
_LONG, _FIRST, _SHORT = {"fringe": 2.2, "grating": 1.8}, 2.2, 0.35
# The way back from a turn may be this number of usual ways shorter than the way there, or longer than three of them.
_NEARER, _FARTHER = 0.75, 1.0
# Margin of the recommended sample rate; largest sample, in amplitudes.
_SPARE, _BEYOND = 1.1, 1.5
# Wavelengths of usual lasers [nm]; a period this near to one of them, as a part of it, is doubtful.
_LASERS, _NEAR_LASER = (405, 488, 514.5, 532, 632.8, 635, 650, 780, 785, 808, 850, 980, 1064, 1310, 1550), 1e-3
# Ends of similar cycles differ by less than this part of the range, and their counts by at most this, in half periods.
_ALIKE, _JUMP = 0.01, 1.6


def at_samples(time: Array, voltage: Array, event_time: ArrayLike, position: ArrayLike) -> Array:
    """Return positions (n,) at the samples nearest to events, moved along the motion to their times; NaN elsewhere."""
    when = vector(event_time, "event_time", error=RecordError)
    where = vector(position, "position", error=RecordError)
    if when.size != where.size or when.size < _FEWEST:
        got = f"{when.size} times and {where.size} positions of events"
        raise RecordError(argument="event_time, position", got=got, need=f"one of each for {_FEWEST} events at least")
    bad = np.flatnonzero((np.diff(when, prepend=when[0]) < 0) | (when < time[0]) | (when > time[-1]))
    if bad.size:
        got, need = f"{when[bad[0]]:.9g} s", f"rising times in the record, {time[0]:.9g} to {time[-1]:.9g} s"
        hint = "sort the events, and check that both have one clock"
        raise RecordError(argument=f"event_time[{bad[0]}]", got=got, need=need, hint=hint)
    nearest = np.clip(np.searchsorted(time, when), 1, time.size - 1)
    nearest -= when - time[nearest - 1] < time[nearest] - when
    # Between turns of the displacement, a parabola over time through three events leads from an event to its sample.
    steps = np.sign(np.diff(where))
    begins = np.append(True, (steps == 0) | (steps * np.append(steps[:1], steps[:-1]) < 0))
    ends = np.append(np.flatnonzero(begins), when.size)
    first, last = ends[np.cumsum(begins) - 1], ends[np.cumsum(begins)] - 1
    a = np.clip(np.arange(when.size) - 1, first, np.maximum(last - 2, first))
    b, c, now = np.minimum(a + 1, last), np.minimum(a + 2, last), time[nearest]
    with np.errstate(all="ignore"):
        slope = (where[b] - where[a]) / (when[b] - when[a])
        bend = ((where[c] - where[b]) / (when[c] - when[b]) - slope) / (when[c] - when[a])
        moved = where[a] + (now - when[a]) * (slope + np.nan_to_num(bend) * (now - when[b])) - where
    # An event alone, or two at one time, move by the mean gain of the voltage.
    usual = voltage[nearest] - np.interp(when, time, voltage)
    usual *= float(np.ptp(where)) / max(float(np.ptp(voltage)), 1e-300)
    likely = np.abs(moved) <= 2 * np.maximum(np.abs(usual), np.median(np.abs(usual)))
    samples, which, shared = np.unique(nearest, return_inverse=True, return_counts=True)
    found = np.full(time.size, np.nan)
    found[samples] = np.bincount(which, where + np.where(likely, moved, usual)) / shared
    return found


def thinned(record: Record) -> Record:
    """Return a record of events with fewer samples, and in its meta the recorded events and samples, and the step."""
    known = record.measured
    if known is None:
        return record
    at, every = np.flatnonzero(known), 1
    if len(record) >= 2 * _MOST and at.size >= _FEWEST:
        # Events are near one another where the stage is fast.
        every = max(min(len(record) // _MOST, int(np.quantile(np.diff(at), _NEAR))), 1)
    meta = {"recorded": (at.size, len(record)), **record.meta, "every": every * record.meta.get("every", 1)}
    if every == 1:
        return replace(record, meta=meta)
    coarse = record[np.arange(0, len(record), every)]
    own = known & (record.time <= coarse.time[-1])
    y = at_samples(coarse.time, coarse.voltage, record.time[own], record.displacement[own])
    return replace(coarse, displacement=y, measured=~np.isnan(y), meta=meta)


def record_of_periodic(
    time: Array, voltage: Array, signal: Array, period: float, *, kind: str, name: str, unit: str = "a.u."
) -> Record:
    """Return a record of events, see `counted_events`, with the `signal` [unit] as a further channel of that name."""
    from dehyst.records.record import Record

    others: Any = {f"signal [{unit}]": signal}
    whole = Record(time, voltage, np.zeros(len(time)), name, others=others)
    when, where = counted_events(whole.time, whole.voltage, whole.others[0].values, period, kind)
    record = Record.from_events(time, voltage, when, where, name=name, units="m")
    with np.errstate(all="ignore"):
        way = np.nanmedian(np.abs(np.diff(np.interp(when, whole.time, whole.voltage)) / np.diff(where)))
    laser = kind == "fringe" and min(abs(1e9 * period / line - 1) for line in _LASERS) < _NEAR_LASER
    doubt = ": a laser wavelength, and a period of a Michelson interferometer is half of it" * laser
    scale = [f"One period of the signal is {1e9 * period:.7g} nm of travel{doubt}."]
    return replace(record, others=whole.others, meta={"step_V": 0.5 * _STEP * period * float(way), "scale": scale})


def counted_events(
    time: Array, voltage: Array, signal: Array, period: float, kind: str = "fringe"
) -> tuple[Array, Array]:
    """Return times [s] and positions (k,) of a `signal` (n,) that repeats when the displacement moves by a `period`.

    The count follows the voltage up and down. For a "fringe", a sine of the displacement, the events are crossings of
    the middle and extremes between them; for a "grating", one edge of each line. Middle and contrast may drift. Raise
    `RecordError` if the signal does not repeat, has too few samples or periods, or loses a count, and say when.
    """
    choice(kind, "kind", ("fringe", "grating"), error=RecordError)
    if not number(period, "period", error=RecordError) > 0:
        raise RecordError(argument="period", got=period, need="a length above 0, as half a wavelength")
    least = max(noise_span(voltage), 2 * resolution(voltage)[0], _LEAST_TURN * float(np.ptp(voltage)))
    turns = turning_points(voltage, least)
    z = _normalised(time, signal, turns)
    found = _crossings(time, voltage, z, turns, least, kind)
    # Leave out smaller turns, which cross no level twice.
    turns = turning_points(voltage, max(least, _SMALL_TURN * found.usual))
    found = _crossings(time, voltage, z, turns, least, kind)
    if kind == "grating":
        even = found.number % 2 == 0
        found = _Crossings(*(values[even] for values in found))
    _refuse_lost_counts(time, voltage, z, turns, found, kind)
    if kind == "grating":
        return found.time, np.asarray(0.5 * period * found.number)
    when, count = np.hstack([(found.time, found.number), _extremes(time, z, found)])
    order = np.argsort(when)
    return when[order], np.asarray(0.5 * period * count[order])


def _refusal(got: str, hint: str) -> RecordError:
    return RecordError(argument="signal", got=got, need="a signal in which each period can be counted", hint=hint)


class _Crossings(NamedTuple):
    """Crossings of the middle: times [s], voltages [V], their branches and numbers (k,)."""

    time: Array
    voltage: Array
    branch: NDArray[np.intp]
    number: NDArray[np.intp]

    @property
    def way(self) -> Array:
        """The change of the voltage (k - 1,) [V] from each to the next of the same branch, NaN to another branch."""
        return np.where(np.diff(self.branch) == 0, np.abs(np.diff(self.voltage)), np.nan)

    @property
    def usual(self) -> float:
        """The median of the ways [V]; raise `RecordError` if there is none."""
        if not np.nan_to_num(self.way).any():
            raise _refusal("no period between two turns of the voltage", "drive over more periods")
        return float(np.nanmedian(self.way))


def _normalised(time: Array, signal: Array, turns: NDArray[np.intp]) -> Array:
    """Return the signal from -1 to 1 between levels that follow its extremes."""
    extremes = turning_points(signal, max(_SWING * float(np.ptp(signal)), noise_span(signal)))
    # Maxima and minima alternate; the extreme next to a turn of the voltage is incomplete.
    above = signal[extremes] > signal[np.roll(extremes, 1)]
    above[:1] = ~above[1:2]
    whole = np.ones(extremes.size, dtype=bool)
    if extremes.size:
        whole[np.abs(extremes - turns[:, None]).argmin(axis=1)] = False
    if min(np.count_nonzero(whole & above), np.count_nonzero(whole & ~above)) < 2:
        hint = "name the column that repeats with the motion, sample faster, or drive over more periods"
        raise _refusal(f"{extremes.size} extremes beyond its noise", hint)
    levels = []
    for own in (extremes[whole & above], extremes[whole & ~above]):
        padded = np.pad(signal[own], _LEVELS // 2, mode="edge")
        smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, _LEVELS), axis=1)
        levels.append(np.interp(time, time[own], smooth))
    return np.asarray((2 * signal - levels[0] - levels[1]) / (levels[0] - levels[1]))


def _crossings(time: Array, voltage: Array, z: Array, turns: NDArray[np.intp], least: float, kind: str) -> _Crossings:
    """Return the crossings of the middle, each the zero of a line through its samples, and count them.

    The displacement turns where the voltage does, and at the end of a hold. Between two crossings without an extreme of
    the signal it turns there instead: it is late, or creeps back while the voltage is held within `least` [V].
    """
    outside = np.flatnonzero(np.abs(z) > _BAND)
    last = np.flatnonzero(np.diff(z[outside] > 0))
    when = np.empty(last.size)
    for k, (a, b) in enumerate(zip(outside[last].tolist(), outside[last + 1].tolist(), strict=True)):
        w, t = np.arcsin(np.clip(z[a : b + 1], -1, 1)), time[a : b + 1]
        slope = float(np.polyfit(t - t.mean(), w, 1)[0])
        when[k] = np.clip(t.mean() - w.mean() / slope, t[0], t[-1])
    at, edges = np.interp(when, time, voltage), np.searchsorted(time, when)
    peaks = np.array([np.abs(z[a:b]).max(initial=0.0) for a, b in pairwise([0, *edges.tolist(), z.size])])
    bounds = [0, *turns.tolist(), voltage.size]
    begins = [turn - _held(voltage[a : turn + 1][::-1], least) for a, turn in pairwise(bounds[:-1])]
    ends = [turn + _held(voltage[turn:b], least) for turn, b in pairwise(bounds[1:])]
    signs = np.sign(np.diff(voltage[[0, *turns.tolist(), -1]]))

    def counted(places: NDArray[np.intp]) -> _Crossings:
        """Count the crossings, with a turn of the displacement before the crossing at each of `places`."""
        branch = np.searchsorted(places, np.arange(when.size), side="right")
        rising = signs[branch]
        number = np.cumsum(np.append(0, (rising[1:] + rising[:-1]) // 2)).astype(np.intp)
        return _Crossings(when, at, branch, number[: when.size])

    before, there, after = (np.searchsorted(when, time[own]) for own in (begins, turns, ends))
    # Creep moves away from earlier displacements: on along the branch, or back.
    on = (voltage[turns] - np.cumsum(voltage)[turns] / (turns + 1)) * signs[:-1] >= 0
    held = time[ends] - time[begins] > np.median(np.diff(when))
    places = np.where(held, np.where(on, after, before), there)
    raw = counted(there)
    short = np.append(raw.way < _TWICE * raw.usual, [False] * 2)
    for j, (first, last, place) in enumerate(zip(before.tolist(), after.tolist(), places.tolist(), strict=True)):
        if kind == "grating":
            # A line beside the turn has full height: a short way shows the turn instead.
            places[j] = place + 1 if short[place] else place - 1 if place > 1 and short[place - 2] else place
            continue
        among = np.arange(first, last + 1 + short[last])
        best = int(among[np.argmin(peaks[among])])
        places[j] = best if peaks[best] < _EXTREME else place
    return counted(np.maximum.accumulate(places))


def _held(voltage: Array, least: float) -> int:
    """Return the number of samples after the first one that stay within `least` [V] of it."""
    away = np.abs(voltage - voltage[0]) > least
    return (int(np.argmax(away)) if away.any() else voltage.size) - 1


def _extremes(time: Array, z: Array, found: _Crossings) -> Array:
    """Return times and counts (2, k) of the extremes between two crossings of one branch: vertices of parabolas."""
    events = []
    for k in np.flatnonzero(~np.isnan(found.way)).tolist():
        first, last = np.searchsorted(time, found.time[k : k + 2]).tolist()
        own = np.flatnonzero(np.abs(z[first:last]) > _TOP) + first
        if own.size < _FEWEST:
            continue
        middle = float(time[own].mean())
        bend, slope, _ = np.polyfit(time[own] - middle, z[own], 2).tolist()
        place = middle - 0.5 * slope / bend if bend else np.inf
        if time[own[0]] <= place <= time[own[-1]]:
            events.append((place, 0.5 * float(found.number[k] + found.number[k + 1])))
    return np.array(events).reshape(-1, 2).T


def _refuse_lost_counts(
    time: Array, voltage: Array, z: Array, turns: NDArray[np.intp], found: _Crossings, kind: str
) -> None:
    """Raise `RecordError` where crossings are missing or too many, or may be."""

    def demand(good: object, start: float, end: float) -> None:
        if not good:
            hint = "look whether the signal was blocked, weak or sampled too slowly there, and record it anew"
            raise _refusal(f"a lost count between {start:.6g} and {end:.6g} s", hint)

    way, usual, longest = found.way, found.usual, int(np.bincount(found.branch).max(initial=0))
    if longest < _FEWEST:
        raise _refusal(f"{longest} crossings in the longest branch", f"drive over more periods, {_FEWEST} crossings")
    half = usual if kind == "fringe" else 0.5 * usual
    steps, seconds = np.abs(np.diff(voltage)), np.diff(time)
    if (fast := np.flatnonzero(steps > _STEP * half)).size:
        rate, slow = (steps / seconds)[fast].max() / (_STEP * half) * _SPARE, _STEP * half / seconds[fast] / _SPARE
        hint = f"sample at {digits(rate)} Hz, or drive at {digits(slow.min())} V/s at most"
        raise _refusal(f"too few samples at {time[fast[0]]:.6g} s, {1e3 * seconds[fast[0]]:.3g} ms apart", hint)
    beyond = time[np.abs(z) > _BEYOND]
    if beyond.size:
        demand(False, float(beyond[0]), float(beyond[-1]))
    for first, stop in runs(np.abs(z) < _BAND):
        k = int(np.searchsorted(found.time, time[first]))
        beside = np.nanmax([usual, *way[max(k - 2, 0) : k + 1]])
        demand(np.ptp(voltage[first:stop]) < _STAYS * half / usual * beside, *time[[first, stop - 1]].tolist())
    ends, rest = [time[0], *found.time.tolist(), time[-1]], _LEAST_TURN * float(np.ptp(voltage))
    for k, (a, b) in enumerate(pairwise(ends), -1):
        within = voltage[np.searchsorted(time, a) : np.searchsorted(time, b, side="right")]
        demand(np.ptp(within) <= _LONGEST * usual, a, b)
        # While the voltage is held, the displacement creeps: this way is not checked.
        if not 0 <= k < way.size or np.mean(np.abs(within - np.median(within)) <= rest) > _HELD:
            continue
        before, after = (way[j] if 0 <= j < way.size else np.nan for j in (k - 1, k + 1))
        if not np.isnan(way[k]):
            # After a turn, the displacement follows the voltage slowly at first.
            most = _FIRST if np.isnan(before) else _LONG[kind]
            demand(not (way[k] > most * np.fmax(before, after) or way[k] < _SHORT * np.fmin(before, after)), a, b)
        elif found.branch[k + 1] == found.branch[k] + 1:
            there, back = np.abs(voltage[turns[found.branch[k]]] - found.voltage[k : k + 2]).tolist()
            demand(not there > _LONG[kind] * before, a, b)
            demand(-_NEARER * usual < back - there < 2 * there + _FARTHER * usual, a, b)
    # Similar cycles end at the same displacement.
    levels, last = voltage[turns], np.searchsorted(found.branch, np.arange(turns.size), side="right") - 1
    place = found.number[last] + (levels - found.voltage[last]) / half
    alike = np.append([False] * 2, np.abs(levels[2:] - levels[:-2]) < _ALIKE * np.ptp(voltage))
    branches = [voltage[a : b + 1] for a, b in pairwise([0, *turns.tolist()])]
    held = np.array([np.mean(np.abs(branch - branch[-1]) <= rest) > _HELD for branch in branches])
    for k in range(3, turns.size):
        # Creep during a hold and after it moves the ends of cycles.
        same = alike[k] and alike[k - 1] and not held[k - 3 : k + 1].any()
        demand(not same or abs(place[k] - place[k - 2]) < _JUMP, *time[turns[[k - 2, k]]].tolist())
