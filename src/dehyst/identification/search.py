"""The search for the parts that move the path in time, and for the static parts, by the held-out error.

That error comes from a simulation with the voltages alone (`Frame.held_out_error`). Each part must lower it to a given
ratio: the score is the error over these ratios, the least score wins. Trials of moving parts use a small dictionary.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from math import prod
from typing import Any

import numpy as np

from dehyst._types import Array, Progress
from dehyst._views.fields import json_values
from dehyst.identification.expectation import new_branches
from dehyst.identification.frame import FOLDS, Frame, part_of, tuned, zero_of
from dehyst.identification.motion import A_DECADE, creep_times, moved
from dehyst.identification.program import Program, Solution, with_folds
from dehyst.identification.regressors import RowSource
from dehyst.identification.rules import RULES
from dehyst.identification.structure import Structure
from dehyst.model import Actuator, branches_of
from dehyst.records import bandwidth, rms

_PLAIN = Structure(elements=20, knots=21, smoothing=1e-3)
_LIGHT = Structure(elements=24, spacing=2.0, grades=6, smooth=True, knots=31, smoothing=1e-2)
_WHOLE = Structure(elements=40, spacing=2.0, grades=8, knots=41, smooth=True, smoothing=1e-2)
# Candidates: the dictionary with several smoothings, the default first; then the same with a transformer.
WIDE = (
    *(replace(_WHOLE, smoothing=s) for s in (1e-2, 3e-2, 3e-3)),
    *(replace(_WHOLE, grades=16, smoothing=s) for s in (1e-2, 3e-3)),
    *(replace(_WHOLE, transformer=20, grades=m, smoothing=s) for m, s in ((1, 1e-2), (8, 1e-2), (8, 3e-3))),
)
# Structures if the turning points do not determine the elements: the first is used, the others show the uncertainty.
OPEN = (replace(_WHOLE, smoothing=3e-2), replace(_WHOLE, transformer=20, grades=1), _PLAIN)
# Numbers of rows of the first trials, of the search, and of the final program.
FEW, _ROWS, _MOST = 2000, 4000, 12_000
# Largest number of Gauss-Newton iterations in the search; number of tunings of a resonance.
_TURNS, _TUNINGS = 8, 3
# An iteration that moves the path by less than this part of the RMS residual is the last.
_SETTLED = 0.3
# Time constant of the fastest branch of creep, and tolerance of a lead of half a sample; both in samples.
_FASTEST, _HALF_SAMPLE = 2.0, 0.1
# Usual creep of piezoelectric actuators per decade, as parts of a step.
_USUAL_CREEP = 0.01, 0.02
# The weight of a structure falls by a factor of e if its held-out error is larger by this part.
_WORSE = 0.5
# A larger disagreement, as a part of the stroke, indicates a failed fit.
_FAILED = 0.2
# Path for the comparison of models: number of random turning points, and of samples from one to the next.
_PATH_TURNS, _BRANCH = 40, 24


@dataclass(frozen=True)
class Trial:
    """A candidate of the search and its held-out error [m]; `structure`: None where only moving parts differ."""

    words: str
    held_out: float
    structure: Structure | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "words held_out_m=held_out structure")


@dataclass(frozen=True, eq=False)
class Fitted:
    """Records with the numbers of the moving parts, and the solution of a structure.

    `names`: names of the moving parts.
    """

    frame: Frame
    structure: Structure
    names: tuple[str, ...]
    source: RowSource
    program: Program
    found: Solution

    @cached_property
    def held_out(self) -> float:
        """Held-out error [m]."""
        return self.frame.held_out_error(self.source, self.program, self.found)

    @cached_property
    def actuator(self) -> Actuator:
        """The actuator, without limits and name."""
        return self.frame.actuator(self.program, self.found)

    @property
    def rms(self) -> float:
        """RMS residual of the rows [m]."""
        return rms(self.program.residual(self.found))

    def spread(self, name: str) -> float:
        """Return the standard error of the number of a part, from solutions that leave out one fold each."""
        numbers = [float(self.program.solved(self.found, without=k).numbers[name][0]) for k in range(FOLDS)]
        return float(np.sqrt((FOLDS - 1) * np.var(numbers)))

    def with_structure(self, structure: Structure) -> Fitted:
        """Return the solution of another structure for the same samples and moving parts."""
        source, rows = self.source, self.program.rows
        if replace(structure, smoothing=self.structure.smoothing) != self.structure:
            source = self.frame.source(structure)
            rows = source.thinned(_ROWS)
        program = self.program.with_static(rows, source.grid, structure.smoothing)
        found = program.solved(self.found)
        if structure.transformer and source is not self.source:
            # With a transformer, the slope of tau(v) must weight the rows.
            program = replace(program, near=found)
            found = program.solved(found)
        return replace(self, structure=structure, source=source, program=program, found=found)

    @property
    def score(self) -> float:
        """The held-out error divided by the ratios to which the parts must lower it."""
        gains = _GAINS if any(self.frame.rests) else _GAINS | {"creep": RULES.hidden_creep_gain}
        # Grades and a transformer have similar effects: with grades, the ratio of a transformer counts twice.
        bends = bool(self.structure.transformer) * (1 + (self.structure.grades > 1))
        return self.held_out / prod(gains.get(name, 1.0) for name in self.names) / RULES.static_gain**bends


# Moving parts that do not depend on the structure.
_OF_RECORDS = ("delay", "lag", "inertia")
# Ratios to which each part must lower the held-out error.
_GAINS = {
    "delay": RULES.moving_gain,
    "lag": RULES.moving_gain * RULES.lag_gain,
    "creep": RULES.creep_gain,
    "inertia": RULES.inertia_gain,
    "drift": RULES.moving_gain,
    "thermal": RULES.temperature_helps,
    "expansion": RULES.moving_gain,
}


def fitted(
    frame: Frame,
    structure: Structure,
    rows: int,
    names: tuple[str, ...] = (),
    turns: int = 0,
    near: Solution | None = None,
) -> Fitted:
    """Solve the program of a structure, after `turns` Gauss-Newton iterations of the parts in `names`.

    `near`: solution of a similar program with the same structure.
    """
    source = frame.source(structure)
    found = frame.program(source, structure, rows).solved() if near is None else near
    for _ in range(turns):
        program = frame.program(source, structure, rows, names, found)
        found = program.solved(found)
        frame = replace(frame, motion=moved(frame.motion, names, found.numbers))
        source = frame.source(structure)
        if program.step(found) < _SETTLED * rms(program.residual(found)):
            break
    program = frame.program(source, structure, rows, names, found)
    program = with_folds(program, frame.folds(program))
    return Fitted(frame, structure, names, source, program, program.solved(found))


@dataclass(eq=False)
class _Search:
    """The search for moving parts: start of the trials, parts that always move, and trials so far."""

    report: Progress
    near: Solution | None = None
    always: tuple[str, ...] = ()
    trials: list[Trial] = field(default_factory=list)

    def tried(self, frame: Frame, names: tuple[str, ...], more: str = "", near: Solution | None = None) -> Fitted:
        """Solve the small dictionary with the moving parts in `names`."""
        moved = [name for name in names if name != "creep_before"]
        words = f"moves: {' and '.join(moved) or 'nothing'}{more}"
        self.report(f"trying what {words}")
        whole = (*names, *(name for name in self.always if name not in names))
        # Trials begin at the solution without moving parts, or at the solution `near`.
        self.near = self.near or frame.program(frame.source(_LIGHT), _LIGHT, FEW).solved()
        made = fitted(frame, _LIGHT, FEW, whole, _TURNS if whole else 0, near or self.near)
        self.trials.append(Trial(words, made.held_out))
        return made

    def own(self, made: Fitted, *without: str) -> tuple[str, ...]:
        """Return the names of the moving parts of a solution, except parts that always move and those in `without`."""
        return tuple(name for name in made.names if name not in (*self.always, *without))

    def lag_again(self, best: Fitted, other: Fitted) -> Fitted:
        """Try the lag again beside the `other` parts: a lag may hide these, and they may imitate a lag."""
        names = self.own(other, "delay")
        on_time = other.frame.with_motion(delay=0.0)
        both = self.tried(on_time, names if "delay" in other.names else ("delay", *names), near=other.found)
        best = _best([best, both])
        if "delay" in both.names and not _lags(both.frame) and both.held_out < best.held_out:
            # This delay has another cause and is left out; the better numbers of the other parts are kept.
            best = _best([best, self.tried(both.frame.with_motion(delay=0.0), names, near=both.found)])
        return best


def moving(
    frame: Frame, report: Progress, *, lag: bool, drift: bool, more: bool
) -> tuple[Frame, tuple[str, ...], list[Trial]]:
    """Return the records with the numbers of the moving parts, the names of these parts, and all trials.

    `lag`, `drift`: whether the search may find these. `more`: whether it may find creep and a resonance.
    """
    search = _Search(report, always=("zero",) if frame.motion.zero.any() else ())
    tau = creep_times(_FASTEST * frame.times[0], frame.times[1])
    none = np.zeros((len(frame.training), tau.size))
    frame = frame.with_motion(time_constants=tau, gains=0 * tau, creep_before=none)
    best = search.tried(frame.with_motion(reference=None), ())
    if frame.motion.thermal is not None:
        warm = [search.tried(frame, names) for names in (("thermal",), ("thermal", "expansion"))]
        best = _best([best, *warm])
        if "thermal" in best.names:
            search.always = (*search.own(best), *search.always)
        else:
            frame = frame.with_motion(reference=None)
    # Creep, logarithmic drift and linear drift are tried in turn.
    items, steady = frame.training, [replace(item, steady=True) for item in frame.training]
    ways = list[tuple[tuple[str, ...], Any, str]]([(("creep", "creep_before"), items, "")] if more else [])
    ways += [(("drift",), items, ""), (("drift",), steady, ", in proportion to time")] if drift else []
    late = search.tried(frame, ("delay",)) if lag else best
    base = _best([best, late])
    beside = [
        search.tried(replace(base.frame, training=items), (*search.own(base), *names), words, base.found)
        for names, items, words in ways
    ]
    best = _best([base, *beside])
    if lag and beside:
        best = search.lag_again(best, min(beside, key=lambda made: made.score))
    late = best if "delay" in best.names else late
    at = late.frame.motion
    # A low-pass as slow as the cycles gives a delay that is too long, but about as long as its time constant.
    too_long = at.delay > RULES.longest_lag * min(item.cycle for item in frame.training)
    # A lag below a sample does not show whether it is a delay or a low-pass, and its inverse would overshoot at steps.
    if "delay" in late.names and (late is best or too_long) and at.delay >= frame.times[0]:
        slow = late.frame.with_motion(delay=0.0, lag=max(at.delay, 0.0))
        best = _best([best, search.tried(slow, ("lag", *search.own(late, "delay")), near=late.found)])
    # Creep shows in rests. Without rests, `hidden` is the largest usual creep that does not raise the held-out error.
    for rate in _USUAL_CREEP if more and "creep" not in best.names and not any(frame.rests) else ():
        creeping = best.frame.with_motion(gains=np.full_like(tau, rate / A_DECADE))
        made = fitted(creeping, _LIGHT, FEW, (*best.names, "creep_before"), _TURNS, best.found)
        if RULES.moving_gain * made.held_out <= best.held_out:
            best = replace(best, frame=best.frame.with_motion(hidden=rate))
    if more and _may_swing(frame):
        swinging = _tuned(search.tried(best.frame, (*search.own(best), "inertia")))
        search.trials[-1] = replace(search.trials[-1], held_out=swinging.held_out)
        if swinging.score < best.score and _excited(swinging.frame):
            best = swinging
    return best.frame, best.names, search.trials


def _tuned(made: Fitted) -> Fitted:
    """Return a solution whose resonance and other numbers are tuned alternately."""
    for _ in range(_TUNINGS):
        if not _excited(made.frame):
            break
        frame = tuned(made.frame, made.source, made.program, made.found)
        made = with_parts(frame, made.structure, made.names, near=made.found)
    return made


def _best(some: Sequence[Fitted]) -> Fitted:
    """Return the best of some solutions, without those whose delay must have another cause."""
    return min((made for made in some if "delay" not in made.names or _lags(made.frame)), key=lambda made: made.score)


def _lags(frame: Frame) -> bool:
    """Whether the delay is plausible: a lead of a sample or more, or a long lag, has another cause."""
    step, cycle = frame.times[0], min(item.cycle for item in frame.training)
    delay = frame.motion.delay
    lags = RULES.shortest_lag * step <= delay <= RULES.longest_lag * cycle
    # A displacement that is read at the end of each step of a converter leads by half a sample.
    return lags or abs(delay / step + 0.5) < _HALF_SAMPLE


def _may_swing(frame: Frame) -> bool:
    """Whether the records have fast cycles and enough samples to show a resonance."""
    step, cycle = frame.times[0], min(item.cycle for item in frame.training)
    # Events are too few to show a resonance.
    return cycle <= RULES.slowest_cycle * step and all(item.record.measured is None for item in frame.training)


def _excited(frame: Frame) -> bool:
    """Whether a voltage excites the resonance, which must lie below the Nyquist frequency."""
    dynamics = frame.motion.dynamics
    if dynamics is None or dynamics.damping > RULES.damped:
        return False
    resonance = dynamics.frequency
    pieces = [piece for item in frame.training for piece in item.pieces]
    highest = max(bandwidth(piece.voltage, piece.sample_time, RULES.excited) for piece in pieces)
    return 0.5 * resonance < highest and resonance < 0.5 / frame.times[0]


def with_parts(
    frame: Frame, structure: Structure, names: tuple[str, ...], rows: int = FEW, near: Solution | None = None
) -> Fitted:
    """Return the solution of a structure with the moving parts in `names`, whose numbers change by one iteration."""
    free = tuple(name for name in names if name not in _OF_RECORDS)
    return replace(fitted(frame, structure, rows, free, int(bool(free)), near), names=names)


def static(
    frame: Frame, structures: Sequence[Structure], names: tuple[str, ...], report: Progress
) -> tuple[Fitted, list[Trial], list[Fitted]]:
    """Return the solution of the structure with the least held-out error, all trials, and all solutions."""
    trials = list[Trial]()

    def solved(structure: Structure, near: Fitted | None = None) -> Fitted:
        report(f"solving the program for {structure.words}")
        made = near.with_structure(structure) if near else with_parts(frame, structure, names, _ROWS)
        trials.append(Trial(f"{structure.words}; smoothing {structure.smoothing:g}", made.held_out, structure))
        return made

    first, *others = structures
    best = solved(first)
    if structures is WIDE:
        # Inner loops do not close with smooth elements: therefore these must lower the held-out error. Creep differs
        # with and without smooth elements: therefore the moving parts are fitted again.
        closed = solved(replace(first, smooth=False), best if {*names} <= {*_OF_RECORDS} else None)
        if best.held_out >= RULES.static_gain * closed.held_out:
            best, others = closed, [replace(structure, smooth=False) for structure in others]
    made = [best]
    for structure in others:
        # With another smoothing on the last grid, the last solution is a good start.
        same = replace(made[-1].structure, smoothing=structure.smoothing) == structure
        made.append(solved(structure, made[-1] if same else best))
    if structures is not OPEN:
        best = min(made, key=lambda each: each.score)
    report("solving the program of all samples")
    if "inertia" in names:
        frame = tuned(best.frame, best.source, best.program, best.found)
        best = replace(best, frame=frame)
    final = with_parts(best.frame, best.structure, names, _MOST, best.found)
    program, found = final.program.reweighted(final.found)
    final = min(final, replace(final, program=program, found=found), key=lambda made: made.held_out)
    final.__dict__["held_out"] = best.held_out
    return final, trials, made


def warmed(frame: Frame) -> Frame:
    """Return the records with a first estimate of the effect of temperature."""
    return fitted(frame, _LIGHT, FEW, ("thermal",), _TURNS).frame


def with_zeros(frame: Frame, report: Progress) -> Frame:
    """Return the records on one axis: the zero of each record is estimated, then all zeros are refined together."""
    zero = np.zeros(len(frame.training))
    for q in range(zero.size):
        report("estimating the zeros of the sensor")
        zero[q] = 0.0 if q == frame.widest else _zero(frame, q)
    frame = frame.with_motion(zero=zero)
    return fitted(frame, _PLAIN, FEW, ("zero",), _TURNS).frame if zero.any() else frame


def _zero(frame: Frame, number: int) -> float:
    """Return the zero of a record relative to the widest record; 0 unless another zero fits much better."""
    # Only these two records are fitted: zeros of other records could hide the improvement.
    pair, motion = [frame.widest, number], frame.motion
    both = replace(motion, creep_before=motion.creep_before[pair], drift=motion.drift[pair])
    alone = replace(frame, training=[frame.training[q] for q in pair], widest=0)

    def cost(shift: float) -> float:
        moved = replace(alone, motion=replace(both, zero=np.array([0.0, shift])))
        program = moved.program(moved.source(_PLAIN), _PLAIN, FEW // 2)
        return rms(program.residual(program.solved()))

    return zero_of(cost, frame.stroke, 1e-4)


def disagreement(actuator: Actuator, others: Sequence[Fitted], chosen: Fitted, frame: Frame) -> float:
    """Return the RMS distance [m] on a random path from other structures.

    A structure with a larger held-out error has a smaller weight; the weight of an equal error is 1. If the sum of all
    weights is below 1, the held-out error gets the rest. The path has random turning points after two full loops.
    """
    low, high = frame.voltages
    turns = np.concatenate([[low, high, low, high, low], np.random.default_rng(1).uniform(low, high, _PATH_TURNS)])
    voltage = np.concatenate([np.linspace(a, b, _BRANCH, endpoint=False) for a, b in pairwise(turns)])
    time = np.arange(voltage.size) * frame.times[0]

    def played(model: Actuator) -> Array:
        return model.simulate(voltage, time=time, extrapolate=True).displacement[4 * _BRANCH :]

    mine, squares, weights = played(actuator), [], []
    # Models that differ in smoothing only count as one structure.
    grids = {replace(other.structure, smoothing=0.0): other for other in reversed(others)}
    for other in grids.values():
        apart = float(np.std(played(other.actuator) - mine))
        if other.structure != chosen.structure and apart < _FAILED * frame.stroke:
            squares.append(apart**2)
            weights.append(float(np.exp(-max(other.held_out / max(chosen.held_out, 1e-300) - 1, 0.0) / _WORSE)))
    rest = max(1.0 - sum(weights), 0.0)
    return float(np.average([*squares, chosen.held_out**2], weights=[*weights, rest]) ** 0.5)


def new_in_time(frame: Frame) -> tuple[float, float]:
    """Return the distances of rises, and of falls, in held-out parts of the time from the branches in other parts.

    Each is an RMS over the parts, relative to the range.
    """
    low, high = frame.voltages
    part, pairs = [], []
    for item in frame.training:
        voltage = item.record.voltage
        at = branches_of(voltage, high - low)
        # A branch belongs to the part that holds its middle.
        part.append(part_of(np.asarray(at.mean(axis=1) / len(voltage))) % FOLDS)
        pairs.append(voltage[at])
    of, every = np.concatenate(part), np.concatenate(pairs)
    squares = [np.square(new_branches(every[of == k], every[of != k])) for k in range(FOLDS)]
    rising, falling = np.sqrt(np.mean(squares, axis=0)).tolist()
    return rising, falling
