"""The estimator of a loop: sums over cycles of a path give weights, and a test decides whether they are used.

Each cycle is first predicted, by the weights in use and by the new weights from the cycles before it; only then is it
learnt. If the new weights predict it better, they are used from then on (a prequential test).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from math import isnan
from typing import Any, NamedTuple

import numpy as np

from dehyst._native import EMPTY, StepCoefficients, output_creep, strains
from dehyst._types import Array, Mask
from dehyst.adaptation.active_set import StepwiseProgram
from dehyst.adaptation.weights import Tracker, Weights
from dehyst.model import Actuator, Creep, DisplacementCreep, State

# Samples whose columns are made in one slice of work, and steps of the program that follow a cycle at most.
_CHUNK, _STEPS = 32, 60
# Strength of the model as it was given beside all cycles in memory, and of the likeness of neighbours' changes.
_RIDGE, _ALIKE = 1e-2, 1e-1
# Cycles before the first exchange; other weights must predict cycles better than the present ones by this part, and by
# this many standard errors of the sensor's noise. Factor on the evidence of the cycles before.
_FIRST, _BETTER, _SURE, _EVIDENCE = 5, 0.95, 2.0, 0.7
# Factor on the means of the cycles before: an offset is that of the last cycles.
_RECENT = 0.5
# Weight of the change of the means from one cycle to the next: that of a pair with one common mean.
_BETWEEN = 0.25
# Part of the sensor's noise below which an error is not known.
_UNKNOWN = 0.2
# Slopes of the drive over the path differ from the mean by this factor at most; samples that move less than this part
# of the fastest have none.
_UNEVEN, _MOVES = 8.0, 0.05
# An offset that differs from the explained one by this part of the usual error is corrected.
_OFFSET = 0.5
# Largest change of the displacement that one exchange makes, as a part of the reach.
_TRUST = 0.02
# Allowed mean slope of the spring and friction of all elements, of those of the model as it was given.
_SLOPE, _FRICTION = (0.6, 1.6), (0.3, 2.5)
# Of a cycle: least part of samples that count, slope of measured over wanted displacement, and their correlation.
_COUNTED, _FOLLOWS, _CORRELATED = 0.5, (0.6, 1.6), 0.95
# An error this many times the usual one, and of this part of the reach, is that of something else; so often in a row it
# is a change that stays.
_ODD, _ODD_PART, _ODD_CYCLES = 4.0, 0.002, 3
# A delay of the sensor must leave no more than this part of the error that gain and width leave; what it explains must
# be at least this part of the whole error, and this part of the reach.
_LATE, _LATE_SHARE, _LATE_PART = 0.6, 0.1, 5e-4
# Samples for which a sensor may repeat its value while the path moves, and parts of its noise in a first breakaway.
_REPEATS, _QUIET = 8, 30.0
# Entries of the log that are kept.
_LOGGED = 1000


@dataclass(frozen=True)
class Exchange:
    """A cycle of the path, and whether new weights are used after it.

    Attributes
    ----------
    step : int
        Number of steps of the loop at the end of the cycle.
    used : bool
        Whether new weights are used after the cycle.
    reason : str
        Why new weights are not used, or why the cycle was not learnt; empty if they are used.
    error, offered : float
        RMS error of the cycle [m] without its mean, with the weights in use and with the new ones; NaN if unknown.
    datum : float
        Sensor reading minus the model's displacement [m]; not learnt.
    slope, friction : float
        Mean slope of the spring, and friction of all elements, relative to the initial model.
    """

    step: int
    used: bool
    reason: str
    error: float
    offered: float
    datum: float
    slope: float
    friction: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        values = asdict(self)
        return values | {name: None for name in ("error", "offered") if isnan(values[name])}


@dataclass(frozen=True, eq=False)
class PathCycle:
    """Samples of a cycle (n,): displacement wanted and measured [m], voltage sent [V], and whether it was clamped.

    Displacements are at the reference temperature.

    `step`: number of steps of the loop at its end. `seconds`: time between samples; None if unknown.
    """

    wanted: Array
    measured: Array
    sent: Array
    clamped: Mask
    step: int
    seconds: float | None


class _Sums(NamedTuple):
    """What a cycle gives: second moments and means of the columns and the drive.

    `centred` (m + 1, m + 1) [V^2] and `mean` (m + 1,) [V]: the drive last. `samples`: their number. `noise`: of the
    sensor [m]. `datum`: the one with which the measured path was followed [m].
    """

    centred: Array
    mean: Array
    samples: int
    noise: float
    datum: float


class Estimator:
    """Estimator of the factors on an actuator's weights from the cycles of a path.

    `state`: state of the actuator before the first cycle. `zero_drifts`: whether the sensor's zero may drift; an offset
    is then learnt only as far as a change of gain and loop width explains it. Otherwise the sensor's zero is the zero
    of the model's axis.
    """

    def __init__(self, actuator: Actuator, state: State, zero_drifts: bool) -> None:
        self.weights = Weights.of(actuator)
        self.factors, self.constant = self.weights.initial, float(actuator.spring.voltage[0])
        self.datum, self.log = 0.0, deque[Exchange](maxlen=_LOGGED)
        self._zero, self._zero_drifts = 0.0, zero_drifts
        size = self.factors.size
        self._gram, self._image, self._sizes = np.zeros((size, size)), np.zeros(size), np.zeros(size)
        # Sums over cycles of the means of columns and drive and of their number; squares of the errors in use, of those
        # on offer, and of the difference's standard error.
        self._means, self._evidence = np.zeros(size + 2), np.zeros(3)
        self._program = StepwiseProgram(self.weights.least, *self.weights.limits, self.factors)
        self._tracker, self._creep = Tracker(self.weights, state), _CreepBehind(actuator, state)
        # Means of columns and drive in the cycle before, if that was learnt.
        self._before = EMPTY
        self._usual, self._odd, self._learnt = deque[float](maxlen=9), 0, 0
        self._lagging: Array = np.zeros(1)
        low, high = actuator.before_creep.reach
        self.reach = high - low
        self._slope = float(np.ptp(actuator.voltage_range)) / self.reach
        rho = actuator.slip.breakaway
        self.least_motion = max(2 * float(rho[0]) if rho.size else 0.0, 0.02 * self.reach)

    def numbers(self) -> dict[str, Array]:
        """Return the learnt arrays and the memory along the measured path, by name."""
        state, counts = self._tracker.state, [self.datum, self._zero, self.constant, self._odd, self._learnt]
        return {
            "factors": self.factors,
            "offered": self._program.x,
            "gram": self._gram.ravel(),
            "image": self._image,
            "sizes": self._sizes,
            "means": self._means,
            "before": self._before,
            "evidence": self._evidence,
            "usual": np.array(self._usual),
            "counts": np.array(counts, dtype=np.float64),
            "lagging": self._lagging,
            "displacement": np.array([state.displacement]),
            "carts": state.carts,
            "creep": state.creep,
            "smooth": state.smooth,
            **({"crept": self._creep.reached} if self._creep.reached.size > 1 else {}),
        }

    def restore(self, numbers: dict[str, Array]) -> Actuator:
        """Continue from `numbers` of the same actuator; return the actuator to use."""
        self.factors, self._image, self._sizes = (numbers[name].copy() for name in ("factors", "image", "sizes"))
        self._means, self._evidence, self._before = (numbers[name].copy() for name in ("means", "evidence", "before"))
        self._gram = numbers["gram"].reshape(self.factors.size, -1).copy()
        self._program = StepwiseProgram(self.weights.least, *self.weights.limits, numbers["offered"])
        self.datum, self._zero, self.constant, odd, learnt = numbers["counts"].tolist()
        self._odd, self._learnt, self._lagging = int(odd), int(learnt), numbers["lagging"].copy()
        self._usual = deque(numbers["usual"].tolist(), maxlen=self._usual.maxlen)
        place, carts, creep, smooth = (numbers[name] for name in ("displacement", "carts", "creep", "smooth"))
        self._tracker = Tracker(self.weights, State(float(place[0]), carts, creep, (), smooth))
        self._creep.reached = numbers.get("crept", self._creep.reached).copy()
        return self.weights.model(self.factors, self.constant)

    def pause(self, seconds: float, moved: float) -> None:
        """Let seconds [s] pass between two cycles, in which the actuator creeps by `moved` [m]."""
        self._tracker.follow(np.array([self._tracker.state.displacement + moved]), seconds)
        self._creep.hold(moved, seconds)

    def learn(self, cycle: PathCycle, keep: float) -> Iterator[Actuator | None]:
        """Learn from a cycle in slices of bounded work; yield a new actuator to use, at most once.

        `keep`: factor on the weight of the cycles before.
        """
        cycle = self._creep.removed_from(cycle)
        before, self._before = self._before, EMPTY
        path, left, noise, counted, reason = self._signal(cycle)
        yield None
        drive = self._drive(cycle)
        local = self._local(drive, cycle.wanted)
        drive, speed, weight = drive - local * left, local * np.gradient(path), self._slope / local
        sums = np.zeros((self.factors.size + 3,) * 2)
        for begin in range(0, path.size, _CHUNK):
            span = slice(begin, begin + _CHUNK)
            carts, internal = self._tracker.follow(path[span], cycle.seconds)
            if not reason:
                which = counted[span]
                columns = self.weights.columns(path[span][which], carts[which], internal[which])
                rows = np.column_stack([columns, speed[span][which], drive[span][which], np.ones(len(columns))])
                rows *= weight[span][which, None]
                sums += rows.T @ rows
            yield None
        if reason:
            self._note(cycle, reason)
            return
        yield None
        samples, mean = int(np.count_nonzero(counted)), sums[-1] / sums[-1, -1]
        centred = (sums - sums[-1, -1] * np.outer(mean, mean))[:-1, :-1] / samples
        late = self._lateness(centred)
        if late:
            reason = f"the sensor is late by {late:.2g} samples, or the given period is wrong"
            used = self.factors is not self.weights.initial
            if late >= 1:
                # What was learnt is of cycles in which that did not show.
                self._forget()
                reason += ": the initial weights are used again" if used else ""
            self._note(cycle, reason)
            if late >= 1 and used:
                yield self.weights.model(self.factors, self.constant)
            return
        kept = np.delete(np.arange(len(sums)), -3)
        found = _Sums(centred[np.ix_(kept[:-1], kept[:-1])], mean[kept][:-1], samples, noise, self.datum)
        yield from self._judged(cycle, found)
        if not self._odd:
            yield None
            yield from self._learnt_from(found, keep, before)

    def _judged(self, cycle: PathCycle, found: _Sums) -> Iterator[Actuator | None]:
        """Predict a cycle, and exchange the weights if the new ones predict the last cycles better."""
        error = self._error(found, self.factors)
        usual = float(np.median(self._usual)) if self._usual else error
        large = error > max(_ODD * usual, _ODD_PART * self.reach)
        odd = large and self._odd < _ODD_CYCLES
        self._odd = self._odd + 1 if odd else 0
        if odd:
            self._note(cycle, "its error is not like that of the cycles before: not learnt", error)
            return
        if large:
            # A change that stays: errors as large as this are usual now.
            self._usual.clear()
        self._usual.append(error)
        self.datum = self._offset(found, self.factors, self.constant)
        if self._zero_drifts and self.factors is self.weights.initial:
            # The sensor's zero while the model is believed.
            self._zero += (self.datum - self._zero) / min(self._learnt + 1, _FIRST)
        if self._learnt < _FIRST:
            self._note(cycle, "too few cycles yet", error)
            return
        offered = self._error(found, self._program.x)
        reason, factors, moved = self._trusted(found.centred, self._program.x)
        # Noise is in both errors: their difference has the standard error of its product with the change.
        doubt = 2 * _SURE * found.noise * moved / np.sqrt(found.samples)
        self._evidence = _EVIDENCE * self._evidence + np.array([error**2, offered**2, doubt**2])
        constant = self._constant(factors)
        datum = self._offset(found, factors, constant)
        # Better without regard to an offset, in this cycle too, and not worse with it.
        gained = self._evidence[0] - self._evidence[1]
        better = gained > max((1 - _BETTER**2) * self._evidence[0], np.sqrt(self._evidence[2])) and offered < error
        worse = np.hypot(self._error(found, factors), datum - self._zero) > np.hypot(error, self.datum - self._zero)
        if worse or not better:
            reason = "no weights on offer predict the cycles better"
            # Those in use may have got an offset.
            factors, constant = self.factors, self._constant(self.factors, self.constant)
            if abs(constant - self.constant) > _OFFSET * self._slope * usual:
                reason, datum = "", self._offset(found, factors, constant)
        else:
            self._evidence = np.zeros(3)
        if not reason:
            self.factors, self.constant, self.datum = factors, constant, datum
            yield None
            made = self.weights.model(factors, constant)
            yield None
            yield made
        self._note(cycle, reason, error, offered)

    def _learnt_from(self, found: _Sums, keep: float, before: Array) -> Iterator[None]:
        """Add the sums of a cycle, and solve for new weights step by step; the next cycle tests them.

        `before`: means of columns and drive in the cycle before (m + 1,) [V]; empty if that was not learnt.
        """
        self._learnt += 1
        columns, centred = found.mean[:-1], found.centred
        # As if the path had been followed with the sensor's zero.
        drive = found.mean[-1] - self._slope * (found.datum - self._zero)
        mean = np.array([*columns, drive])
        if before.size:
            centred = centred + _BETWEEN * np.outer(mean - before, mean - before)
        if not self._zero_drifts:
            # If the sensor keeps its zero, the means of successive cycles determine slopes too.
            self._before = mean
        self._means = min(keep, _RECENT) * self._means + np.append(mean, 1.0)
        self._gram = keep * self._gram + centred[:-1, :-1]
        self._image = keep * self._image + centred[:-1, -1]
        self._sizes = np.maximum(self._sizes, np.diag(centred)[:-1])
        prior = self.weights.prior(self._sizes / (1 - keep), _RIDGE, _ALIKE)
        yield None
        self._program.begin(self._gram + prior, self._image + prior @ self.weights.initial)
        for _ in range(_STEPS):
            if self._program.step():
                break
            yield None

    def _forget(self) -> None:
        """Return to the initial weights, with nothing learnt; the datum of the sensor stays."""
        self.factors, self.constant = self.weights.initial, float(self.weights.actuator.spring.voltage[0])
        for sums in (self._gram, self._image, self._sizes, self._means, self._evidence):
            sums[...] = 0.0
        self._program = StepwiseProgram(self.weights.least, *self.weights.limits, self.factors)
        self._odd = self._learnt = 0
        self._usual.clear()

    def _lateness(self, centred: Array) -> float:
        """Return the sensor's delay in samples, if it explains a cycle far better than gain and width do."""
        spring, size = self.weights.springs, self.factors.size
        common = np.zeros((size + 2, 4))
        common[: spring.start, 0], common[spring, 1] = self.factors[: spring.start], self.factors[spring]
        common[spring.stop : size, 0] = self.factors[spring.stop :]
        common[size, 2], common[:-2, 3], common[-1, 3] = 1.0, -self.factors, 1.0
        small = common.T @ centred @ common
        target = small[:3, 3]
        without, found = (np.linalg.lstsq(small[:n, :n], target[:n], rcond=1e-12)[0] for n in (2, 3))
        squares = float(small[3, 3] - without @ target[:2]), float(small[3, 3] - found @ target)
        explained = squares[0] - squares[1]
        least = max(_LATE_SHARE**2 * float(small[3, 3]), (_LATE_PART * self.reach * self._slope) ** 2)
        return float(found[2]) if squares[1] < _LATE**2 * squares[0] and explained > least else 0.0

    def _error(self, found: _Sums, factors: Array) -> float:
        """Return the RMS error [m] of factors on a cycle, without its mean and the sensor's noise."""
        vector = np.append(factors, -1.0)
        squares = float(vector @ found.centred @ vector) / self._slope**2 - found.noise**2
        return float(np.sqrt(max(squares, (_UNKNOWN * found.noise) ** 2)))

    def _trusted(self, centred: Array, offered: Array) -> tuple[str, Array, float]:
        """Return why new factors suggest another actuator, or "", the factors within one exchange, and its size [m]."""
        change = np.append(offered - self.factors, 0.0)
        moved = float(np.sqrt(max(change @ centred @ change, 0.0))) / self._slope
        share = min(1.0, _TRUST * self.reach / moved) if moved else 1.0
        factors = self.factors + share * change[:-1]
        slope, friction = self.weights.ratios(factors)
        for value, (low, high), name in ((slope, _SLOPE, "slope"), (friction, _FRICTION, "friction")):
            if not low <= value <= high:
                return f"the {name} would be {value:.3g} of the model's: this may be another actuator", factors, moved
        return "", factors, share * moved

    def _needed(self, factors: Array) -> float:
        """Return the constant c [V] with which factors predict the last cycles without an offset."""
        *columns, drive, weight = self._means
        return float(drive - np.array(columns) @ factors) / float(weight)

    def _offset(self, found: _Sums, factors: Array, constant: float) -> float:
        """Return the datum of the sensor [m] that a cycle shows with given weights."""
        return found.datum - float(found.mean[-1] - found.mean[:-1] @ factors - constant) / self._slope

    def _constant(self, factors: Array, present: float | None = None) -> float:
        """Return the constant c [V] for factors; `present`: the constant with which they are in use.

        If the sensor's zero does not drift, no offset is left. Otherwise a new constant changes only as far as an
        anchor of the model stays in place within the usual error, and what is left is the datum. It cannot have the
        other sign than the offset of the initial weights, nor be larger: that would be an error of the weights.
        """
        needed = self._needed(factors)
        if not self._zero_drifts:
            return needed
        if present is None:
            slack = self._slope * float(np.median(self._usual))
            low, high = self.weights.constants(factors)
            present = min(max(needed, low - slack), high + slack)
        initial = self._needed(self.weights.initial) - float(self.weights.actuator.spring.voltage[0])
        return needed - min(max(needed - present, min(initial, 0.0)), max(initial, 0.0))

    def _note(self, cycle: PathCycle, reason: str, error: float = np.nan, offered: float = np.nan) -> None:
        ratios = self.weights.ratios(self.factors)
        self.log.append(Exchange(cycle.step, not reason, reason, error, offered, self.datum, *ratios))

    def _drive(self, cycle: PathCycle) -> Array:
        """Return tau (n,) [V] of the acting voltages, without the part that drives the mass."""
        actuator, acting, seconds = self.weights.actuator, cycle.sent, cycle.seconds
        if actuator.lag and seconds:
            tables = Creep([actuator.lag], [0.0]).tables(np.array([seconds]))
            late = strains(acting, np.array([0, acting.size]), *tables, self._lagging)
            self._lagging = late[-1]
            acting = acting - late[:, 0]
        drive = acting if actuator.transformer is None else actuator.transformer(acting)
        return drive - actuator.dynamics.series * self._lead(cycle) if actuator.dynamics else drive

    def _local(self, drive: Array, wanted: Array) -> Array:
        """Return the slope (n,) [V/m] of the drive over the path: what an error of the drive divides by."""
        moved = np.gradient(wanted)
        moves = np.abs(moved) > _MOVES * float(np.abs(moved).max())
        local: Array = np.divide(np.gradient(drive), moved, out=np.full(drive.size, self._slope), where=moves)
        return local.clip(self._slope / _UNEVEN, self._slope * _UNEVEN)

    def _lead(self, cycle: PathCycle) -> Array:
        """Return w - y (n,) [m], the lead for inertia along the wanted path."""
        dynamics, seconds = self.weights.actuator.dynamics, cycle.seconds
        if dynamics is None or seconds is None:
            return np.zeros(cycle.wanted.size)
        velocity = np.gradient(cycle.wanted, seconds)
        return dynamics.lead(velocity, np.gradient(velocity, seconds))

    def _signal(self, cycle: PathCycle) -> tuple[Array, Array, float, Mask, str]:
        """Return the displacement (n,) [m] at the elements, what smoothing took from it, and the sensor's noise [m].

        Then the samples that count, and why the cycle is not learnt. Noise would move every cart. So the path is the
        wanted one plus the smoothed difference of the measured one from it; the rest counts with the mean slope.
        """
        rest = cycle.measured - self.datum - cycle.wanted
        seen = np.isfinite(rest) & ~(_stuck(cycle.measured, cycle.wanted, self.least_motion) & ~cycle.clamped)
        counted = seen & ~cycle.clamped
        reason = self._contradiction(cycle, counted)
        if reason:
            return cycle.wanted, np.zeros(rest.size), 0.0, counted, reason
        places = np.arange(rest.size)
        rest = np.interp(places, places[seen], rest[seen])
        inner = counted[:-2] & counted[1:-1] & counted[2:]
        noise = float(np.std(np.diff(rest, 2)[inner])) / np.sqrt(6)
        smooth = self._smoothed(rest, noise)
        return cycle.wanted + smooth + self._lead(cycle), rest - smooth, noise, counted, ""

    def _contradiction(self, cycle: PathCycle, counted: Mask) -> str:
        """Return why nothing can be learnt from a cycle; empty if something can."""
        if np.count_nonzero(counted) < max(_COUNTED * counted.size, 16):
            return "most samples are missing, stuck or clamped"
        wanted, measured = cycle.wanted[counted], cycle.measured[counted]
        if float(np.ptp(wanted)) < self.least_motion:
            return "the path moves less than a breakaway"
        variances = np.cov(wanted, measured)
        slope = variances[0, 1] / variances[0, 0]
        correlation = variances[0, 1] / np.sqrt(variances[0, 0] * variances[1, 1])
        if not (_FOLLOWS[0] <= slope <= _FOLLOWS[1] and correlation >= _CORRELATED):
            return f"the sensor contradicts the path: it moves {slope:.3g} of what was wanted"
        return ""

    def _smoothed(self, rest: Array, noise: float) -> Array:
        """Return a difference (n,) [m] without the noise that would move the element that slides first."""
        rho = self.weights.actuator.slip.breakaway
        width = min(np.ceil((_QUIET * noise / float(rho[0])) ** 2), rest.size // 12) if rho.size else 0
        if width < 2:
            return rest
        window = np.hanning(int(width) + 2)[1:-1]
        return np.convolve(rest, window, "same") / np.convolve(np.ones(rest.size), window, "same")


class _CreepBehind:
    """The creep in displacement of an actuator along a path, from an initial `state`.

    `reached` (1 + K,): displacement without this creep, and strains of its branches [m], at the last sample.
    """

    def __init__(self, actuator: Actuator, state: State) -> None:
        whole = actuator.model.complete_state(state)
        self._part = actuator.displacement_creep or DisplacementCreep((), ())
        self.reached = np.concatenate([[whole.displacement], whole.displacement_creep])

    def removed_from(self, cycle: PathCycle) -> PathCycle:
        """Return a cycle without the creep of the wanted path, and go on to its end."""
        if not len(self._part) or not cycle.seconds:
            return cycle
        first, strained = float(self.reached[0]), self.reached[1:]
        before = self._part.at_rest * first - float(self._part.gains @ strained)
        path = self._followed(np.append(before, cycle.wanted), cycle.seconds, inverse=True)[1:]
        return replace(cycle, wanted=path, measured=cycle.measured - (cycle.wanted - path))

    def hold(self, moved: float, seconds: float) -> None:
        """Let seconds [s] pass, in which the displacement without this creep moves by `moved` [m]."""
        if len(self._part):
            self._followed(self.reached[0] + np.array([0.0, moved]), seconds)

    def _followed(self, path: Array, seconds: float, *, inverse: bool = False) -> Array:
        """Return a path (n,) [m] with creep, or with `inverse` without it; it begins at the last sample before."""
        decay, rise = self._part.tables(np.array([0.0, seconds]))
        pace = StepCoefficients(np.array([0, 1, path.size]), decay, rise, np.empty((2, 0)))
        first, strained = float(self.reached[0]), self.reached[1:]
        made, strained = output_creep(path, pace, self._part.gains, first, strained, inverse=inverse)
        self.reached = np.append(made[-1] if inverse else path[-1], strained)
        return made


def _stuck(measured: Array, wanted: Array, least: float) -> Mask:
    """Return the samples (n,) at which a sensor repeats its value although the path moves on."""
    stuck = np.zeros(measured.size, dtype=bool)
    for run in np.split(np.arange(measured.size), np.flatnonzero(np.diff(measured) != 0) + 1):
        stuck[run] = run.size >= _REPEATS and float(np.ptp(wanted[run])) > 0.25 * least
    return stuck
