"""Branches of a voltage between its turning points, and properties of a path that the records do not test."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dehyst._text import digits
from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst._views.lines import percent
from dehyst.model.elements import segment_of
from dehyst.records import turning_points
from dehyst.waveforms import FASTER, STEEPEST

if TYPE_CHECKING:
    from dehyst.model.promise import Validity

# A voltage turns where it reverses by this part of the range. Branches count as equal up to a quarter of this part.
BAND = 0.02
# Number of cells along each side of the plane of turning points; number of cells around a branch that it also tests.
CELLS, _AROUND = 40, 2
# A voltage rests where it moves at less than this part of the mean speed of its branch.
_AT_REST = 0.1
# Tested are paces and holds up to this ratio, and voltages up to this part of the range beyond those of the records. A
# drift of the records matters above this multiple of the RMS error of the records.
ALIKE, _BEYOND, _DRIFTS = 1.5, 0.02, 2.0
# Least voltage range of an excitation that tests a rate, as a part of the voltage range of the records.
_NARROWEST = 0.1
# Frequency [Hz] of an excitation without an option; factor by which a sample rate exceeds the least possible rate; part
# by which a frequency may differ from a round number; samples of a slow cycle that resolve the fastest branches.
_FREQUENCY, _SPARE, _ROUND, _FINE = 0.1, 1.1, 0.01, 1e4


def branches_of(voltage: Array, span: float) -> NDArray[np.intp]:
    """Return the first and last samples (k, 2) of each rise and fall of a voltage (n,) [V]; `span`: the range [V].

    A first branch that begins inside the range of the voltage does not count: the voltage before it is not known.
    """
    at = np.array([0, *turning_points(voltage, BAND * span), len(voltage) - 1], dtype=np.intp)
    pairs = np.column_stack([at[:-1], at[1:]])
    pairs = pairs[np.abs(np.diff(voltage[pairs], axis=1)[:, 0]) > 0.5 * BAND * span]
    within = min(float(np.ptp(voltage)), 2 * BAND * span) / 4
    inside = voltage.min() + within < voltage[0] < voltage.max() - within
    return pairs[1:] if len(pairs) and pairs[0, 0] == 0 and inside else pairs


def paces_of(time: Array, voltage: Array, at: NDArray[np.intp]) -> Array:
    """Return mean speed [V/s] and rate of turns [1/s] of each of the `branches` (k, 2), without the time at rest."""
    if not len(at):
        return np.zeros((0, 2))
    step, height = np.diff(time), np.abs(np.diff(voltage[at], axis=1)[:, 0])
    mean = height / np.maximum(np.diff(time[at], axis=1)[:, 0], 1e-300)
    own = np.clip(np.searchsorted(at[:, 0], np.arange(step.size), side="right") - 1, 0, len(at) - 1)
    moving = np.abs(np.diff(voltage)) > _AT_REST * mean[own] * step
    moved = np.append(0.0, np.cumsum(step * moving))
    seconds = np.maximum(moved[at[:, 1]] - moved[at[:, 0]], 1e-300)
    rate = 1 / seconds
    # The last branch has no turn at its end: its rate is reduced if it is shorter than the branch before.
    if len(at) > 1 and at[-1, 1] == len(voltage) - 1:
        rate[-1] *= min(height[-1] / height[-2], 1.0)
    return np.column_stack([height / seconds, rate])


def hold_of(time: Array, voltage: Array, span: float) -> float:
    """Return the longest time [s] for which a voltage stays within a fiftieth of the `span`, at rest or slow."""
    place = np.round(voltage / (BAND * span))
    begins = np.append(0, np.flatnonzero(np.diff(place)) + 1)
    return float(np.max(time[np.append(begins[1:] - 1, len(time) - 1)] - time[begins], initial=0.0))


def distances(path: Array, others: Array) -> Array:
    """Return the distance (k,) of each branch (k, 2) from the nearest of the `others` (m, 2) in the same direction.

    It is the root of the sum of two squares: the distance of the first turning points, and the overrun beyond the end
    of the other branch. It is at most the height of the branch.
    """
    found = np.abs(path[:, 1] - path[:, 0])
    for sign in (1.0, -1.0):
        known = others[sign * (others[:, 1] - others[:, 0]) > 0]
        mine = np.flatnonzero(sign * (path[:, 1] - path[:, 0]) > 0)
        if not known.size:
            continue
        for part in np.array_split(mine, 1 + mine.size // 2000):
            beyond = np.maximum(sign * (path[part, 1][:, None] - known[:, 1]), 0.0)
            apart = np.hypot(path[part, 0][:, None] - known[:, 0], beyond).min(axis=1)
            found[part] = np.minimum(found[part], apart)
    return np.asarray(found)


def tested_loops(branches: Array, edges: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the cells (n, n) in which branches (k, 2) [V] test a rise, and those in which they test a fall.

    `edges` (n + 1,) [V]: edges of the cells. A row belongs to an upper voltage, a column to a lower voltage. A branch
    tests branches that begin within two cells of its beginning and end at most two cells beyond its end.
    """
    cells, rising, places = segment_of(edges, branches), branches[:, 1] > branches[:, 0], np.arange(len(edges) - 1)
    low, high = np.sort(cells, axis=1).T[:, :, None]
    passed = (places >= low - _AROUND) & (places <= high + _AROUND)
    beside = np.abs(places - cells[:, :1]) <= _AROUND
    # In other cells the upper voltage would be below the lower one.
    above = np.tri(places.size, dtype=bool)
    return passed[rising].T @ beside[rising] & above, beside[~rising].T @ passed[~rising] & above


def are_tested(path: Array, rising: NDArray[np.bool_], falling: NDArray[np.bool_], edges: Array) -> NDArray[np.bool_]:
    """Return for each branch (k, 2) [V] of a path whether its cell is tested; see `tested_loops`."""
    lower, upper = segment_of(edges, np.sort(path, axis=1)).T
    return np.asarray(np.where(path[:, 1] > path[:, 0], rising[upper, lower], falling[upper, lower]))


@dataclass(frozen=True)
class ExciteCommand:
    """A `dehyst excite` command in SI units, by default one that tests any path; 0 is the default of an option."""

    high: float
    low: float
    kind: str = "recommended"
    hold: float = 0.0
    cycles: int = 0
    frequency: float = _FREQUENCY
    slew_rate: float = 0.0
    sample_rate: float = 0.0

    @property
    def speed(self) -> float:
        """Largest speed [V/s]."""
        faster = FASTER if self.kind == "recommended" else 1.0
        return min(2 * STEEPEST * self.frequency * (self.high - self.low) * faster, self.slew_rate or np.inf)

    def with_cycle(self, seconds: float) -> ExciteCommand:
        """Return an excitation with cycles that take `seconds`, or with a round frequency within 1 % of that."""
        rounded = (float(digits(1 / seconds, count)) for count in (1, 2, 3))
        return replace(self, frequency=next(number for number in rounded if abs(number * seconds - 1) < _ROUND))

    def within(self, allowed: float | None, step: float = 0.0, *, fine: bool = False) -> ExciteCommand:
        """Return an excitation that keeps to an `allowed` slew rate [V/s].

        `step`: largest one [V] between samples, 0 for any; `fine`: with samples that resolve its fastest branches.
        """
        kept = self if allowed is None or self.speed <= allowed else replace(self, slew_rate=allowed)
        rates = fine * _FINE * self.frequency, _SPARE * kept.speed / step if step else 0.0
        return replace(kept, sample_rate=float(digits(max(rates))))

    def __str__(self) -> str:
        # The voltages are rounded inwards, as the stage may not allow more.
        step = 10.0 ** (np.floor(np.log10(self.high - self.low)) - 3)
        top, base = step * np.floor(self.high / step + 1e-6), step * np.ceil(self.low / step - 1e-6)
        base = base if abs(base) > 1e-3 * top else 0.0
        numbers = {name: getattr(self, name) for name in ("hold", "cycles", "frequency", "slew_rate", "sample_rate")}
        given = {name: digits(number, 6) for name, number in numbers.items() if number != getattr(ExciteCommand, name)}
        options = "".join(f"--{name.replace('_', '-')} {number} " for name, number in given.items())
        # Different excitations have different files.
        file = "_".join([self.kind, f"{top:g}", *[f"{base:g}"] * bool(base), *given.values()])
        return f"dehyst excite {self.kind} {top:g} --base {base:g} {options}-o {file}.csv"


@dataclass(frozen=True)
class Untested:
    """A property of a path that the records do not test.

    `what`: "voltages", "turns", "speed", "rate", "drift", "hold" or "temperature". `sentence`: in words. `command`: an
    excitation that tests it; None for a drift or a temperature, which need no other excitation.
    """

    what: str
    sentence: str
    command: ExciteCommand | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "what sentence")


def untested_by(
    validity: Validity, voltage: Array, time: Array | None, at: NDArray[np.intp], waits: float
) -> Iterator[Untested]:
    """Yield the properties of a path that the records do not test."""
    low, high = validity.limits
    over = max(low - float(voltage.min()), float(voltage.max()) - high)
    if over > _BEYOND * validity.span:
        words = f"The path goes {over:.3g} V beyond the voltages of the records."
        ends = max(high, float(voltage.max())), min(low, float(voltage.min()))
        yield Untested("voltages", words, ExciteCommand(*ends))
    path, edges = voltage[at], np.linspace(low, high, CELLS + 1)
    outside = int(np.count_nonzero(~are_tested(path, *tested_loops(validity.branches, edges), edges)))
    # Records with random turning points also test the turning points between these.
    if outside and not validity.turns_anywhere:
        words = f"{outside} of {len(path)} branches begin where no record turned."
        yield Untested("turns", words, ExciteCommand(high, low))
    if time is None or time.size < 2:
        return
    speed, rate = paces_of(time, voltage, at).T
    slowest, fastest = validity.speeds
    new = {"fastest": (speed.max(initial=0.0), fastest), "slowest": (speed.min(initial=np.inf), slowest)}
    for which, (found, known) in new.items():
        if fastest and (found > ALIKE * known if which == "fastest" else found * ALIKE < known):
            ratio = f"{digits(found / known)} times the {which} of the records"
            words = f"The mean speed of its {which} branch is {digits(found, 3)} V/s, {ratio}."
            yield Untested("speed", words, _paced(high, low, found, FASTER if which == "fastest" else 1.0))
    # The excitation for a higher speed also tests the rate of branches over the whole range at this speed.
    often = ALIKE * max(validity.rates[1], speed.max(initial=0.0) / validity.span)
    if fastest and rate.max(initial=0.0) > often:
        words = f"It turns {rate.max():.3g} times a second at its fastest, the records {validity.rates[1]:.3g} times."
        # An excitation over the voltages of these branches needs the same speed for the same rate.
        own = path[rate > often]
        half = 0.5 * max(float(np.ptp(own)), _NARROWEST * validity.span)
        middle = float(np.clip(0.5 * (own.max() + own.min()), low + half, max(high - half, low + half)))
        yield Untested("rate", words, _paced(middle + half, middle - half, 2 * half * float(rate.max()), FASTER))
    moved = validity.drift * min(float(np.ptp(time)) / validity.lasts, 1.0) if validity.lasts else 0.0
    if moved > _DRIFTS * validity.shown:
        drifted = f"{percent(validity.drift, validity.stroke)} of the stroke in {validity.lasts:.3g} s"
        words = f"The promise leaves out the drift of the records, {drifted}; the path may drift as fast. "
        yield Untested("drift", words + "Let the actuator warm up and rest.")
    hold = max(waits, hold_of(time, voltage, validity.span))
    if hold > ALIKE * validity.hold:
        words = f"The path holds for up to {hold:.3g} s; the records hold for {validity.hold:.3g} s at most."
        yield Untested("hold", words, ExciteCommand(high, low, "staircase", hold=float(digits(hold))))


def not_recorded(validity: Validity) -> Iterator[Untested]:
    """Yield properties that paths often have and the records do not test."""
    low, high = validity.limits
    if not validity.turns_anywhere:
        words = "The records do not turn at random: branches that begin elsewhere are tested little."
        yield Untested("turns", words, ExciteCommand(high, low))
    branch = validity.span / validity.speeds[1] if validity.speeds[1] else 0.0
    if branch and validity.hold < branch:
        words = f"The records hold for {validity.hold:.3g} s at most: creep at rest is tested little."
        yield Untested("hold", words, ExciteCommand(high, low, "staircase", hold=round(max(10.0, 2 * branch))))


def _paced(high: float, low: float, speed: float, faster: float) -> ExciteCommand:
    """Return an excitation with branches of a mean `speed` [V/s], `faster` times that of its slowest branches."""
    # The fastest branches have the speed of the path and not more.
    frequency, slew_rate = digits(0.5 * speed / faster / (high - low)), digits(STEEPEST * speed, 3)
    return ExciteCommand(high, low, frequency=float(frequency), slew_rate=float(slew_rate))
