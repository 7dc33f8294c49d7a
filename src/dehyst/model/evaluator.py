"""The wider actuator at work: what time, load and inertia add around the elements and the spring."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._computable import FARTHEST, demand_divisors, demand_result
from dehyst._errors import ModelError
from dehyst._native import EMPTY, CoreState, StepCoefficients, WideCore, strains
from dehyst._types import Array
from dehyst._validation import vector
from dehyst.model.base import State
from dehyst.model.creep import Creep, clock
from dehyst.model.dynamics import Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, Spring, Transformer, frozen
from dehyst.model.smooth_slip import SmoothSlip

# What rounding may leave of a slope that is the difference of two.
_LEAST = 1e-9


@dataclass(frozen=True)
class PathData:
    """What goes with a path: time (n,) [s] and load (n,) [N], each or None; with dynamics, derivatives of the path."""

    time: ArrayLike | None = None
    load: ArrayLike | None = None
    velocity: ArrayLike | None = None
    acceleration: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Evaluator:
    """The parts of an `Actuator`: tau(v) = R(w) + creep + smooth elements + beta (w - y), see `dehyst.h`."""

    slip: MaxwellSlip | GradedSlip
    spring: Spring
    transformer: Transformer | None
    creep: Creep | None
    smooth: SmoothSlip | None
    dynamics: Dynamics | None
    lag: float
    load_stiffness: float | None

    @property
    def needs_time(self) -> bool:
        """Whether the answer depends on time."""
        return self.creep is not None or self.moves_on

    @property
    def moves_on(self) -> bool:
        """Whether a mass or an amplifier still answers what was before."""
        return self.dynamics is not None or self.lag > 0

    @cached_property
    def core(self) -> WideCore:
        """All parts in C."""
        slip, tau, dynamics = self.slip, self.transformer, self.dynamics
        graded = isinstance(slip, GradedSlip)
        s = self.smooth
        smooth = (EMPTY,) * 3 if s is None else (s.length, s.closing, s.stiffness)
        return WideCore(
            slip.breakaway,
            np.zeros(len(slip)) if graded else slip.stiffness,
            self.spring.displacement,
            self.spring.voltage,
            slip.knots if isinstance(slip, GradedSlip) else EMPTY,
            slip.stiffness.ravel() if graded else EMPTY,
            EMPTY if tau is None else tau.voltage,
            EMPTY if tau is None else tau.drive,
            EMPTY if self.creep is None else self.creep.stiffness,
            EMPTY if dynamics is None else np.array([dynamics.series, dynamics.share(self.spring)]),
            *smooth,
        )

    def simulate(self, voltage: Array, course: PathData, start: State, stack: bool) -> tuple[Array, State]:
        """Displacement (n,) [m] and the state reached; `start` is complete."""
        pace, push, held = (
            self._pace(course.time, voltage.size),
            self._push(course.load, voltage.size),
            self.held(start),
        )
        voltage = self._amplified(voltage, course.time, self.core.voltage(held))
        demand_result(voltage, "voltage that acts")
        y, reached = self.core.simulate(voltage, pace, held, load=push if self.dynamics else EMPTY, stack=stack)
        y = y if self.dynamics or not push.size else y + push
        demand_result(y, "displacement", FARTHEST)
        return y, self.state_of(reached)

    def compensate(self, path: Array, course: PathData, start: State, stack: bool) -> tuple[Array, State]:
        """Voltage (n,) [V] and the state reached; `start` is complete."""
        pace, push = self._pace(course.time, path.size), self._push(course.load, path.size)
        w, more, held = path - push if push.size else path, EMPTY, self.held(start)
        if self.dynamics is not None:
            velocity, acceleration = self.derivatives(path, course)
            w = w + self.dynamics.lead(velocity, acceleration)
            more = self.dynamics.series * (w - path)
            if path.size:
                held = held._replace(motion=np.array([path[-1], velocity[-1] / self.dynamics.frequency]))
        demand_result(w, "displacement of the electrical side")
        voltage, reached = self.core.compensate(w, pace, held, more=more, stack=stack)
        if self.lag and path.size > 1:
            rate = np.gradient(voltage, _seconds(course), edge_order=2 if path.size > 2 else 1)
            voltage = voltage + self.lag * rate
        demand_result(voltage, "voltage")
        return voltage, self.state_of(reached)

    def held(self, state: State) -> CoreState:
        """The state in the core's numbers."""
        motion = state.motion
        if self.dynamics is not None:
            motion = motion / np.array([1.0, self.dynamics.frequency])
        return CoreState(state.displacement, state.carts, np.concatenate([state.creep, state.smooth]), motion)

    def state_of(self, held: CoreState) -> State:
        """The core's numbers as a state."""
        motion = held.motion if self.dynamics is None else held.motion * np.array([1.0, self.dynamics.frequency])
        branches = 0 if self.creep is None else len(self.creep)
        return State(held.w, held.carts, held.strains[:branches], motion, held.strains[branches:])

    def fitted(self, start: State) -> State:
        """The state, complete and with rounding taken out; `ModelError` if it is none of this actuator."""
        if not isinstance(start, State):
            raise ModelError(f"state: got {type(start).__name__}, need a State, such as the one a Motion hands back")
        if start.carts.size != len(self.slip):
            raise ModelError(f"state: got {start.carts.size} carts, this actuator has {len(self.slip)} elements")
        start = self._complete(start)
        excess = np.abs(start.displacement - start.carts) - self.slip.breakaway
        worst = int(np.argmax(excess)) if excess.size else 0
        if excess.size and excess[worst] > 1e-9 * (self.slip.breakaway[worst] + abs(start.displacement)):
            raise ModelError(
                f"state: cart {worst} is {excess[worst]:.3g} m farther from the displacement than its breakaway "
                f"elongation {self.slip.breakaway[worst]:.3g} m"
            )
        return start if not excess.size or excess[worst] <= 0 else replace(start, carts=self._pulled(start))

    def _complete(self, state: State) -> State:
        """Put in creep strains, smooth elongations and motion, if they were left out."""
        branches, moving = 0 if self.creep is None else len(self.creep), 0 if self.dynamics is None else 2
        if state.creep.size not in (0, branches):
            raise ModelError(
                f"state: got {state.creep.size} creep strains, this actuator has {branches} creep branches"
            )
        if state.motion.size > moving:
            raise ModelError("state: got a motion, this actuator has no dynamics")
        if state.creep.size < branches:
            state = replace(state, creep=np.zeros(branches))
        state = self._elongated(state)
        return replace(state, motion=np.array([state.displacement, 0.0])) if state.motion.size < moving else state

    def _elongated(self, state: State) -> State:
        length = EMPTY if self.smooth is None else self.smooth.length
        if state.smooth.size not in (0, length.size):
            raise ModelError(
                f"state: got {state.smooth.size} smooth elongations, this actuator has {length.size} smooth elements"
            )
        if state.smooth.size < length.size:
            return replace(state, smooth=np.zeros(length.size))
        excess = np.abs(state.smooth) - length
        worst = int(np.argmax(excess / length)) if excess.size else 0
        if excess.size and excess[worst] > 1e-9 * length[worst]:
            raise ModelError(
                f"state: smooth element {worst} is elongated by {state.smooth[worst]:.3g} m, its length is "
                f"{length[worst]:.3g} m"
            )
        return replace(state, smooth=np.clip(state.smooth, -length, length)) if np.any(excess > 0) else state

    def _pulled(self, state: State) -> Array:
        low, high = state.displacement - self.slip.breakaway, state.displacement + self.slip.breakaway
        return frozen(np.clip(state.carts, low, high))

    def clock(
        self, time: ArrayLike | None, samples: int, cure: str = "give time= [s], one a sample"
    ) -> tuple[NDArray[np.int64], Array]:
        """Runs of equal steps, see `dehyst._native.steps`; without time one run of no duration.

        Raises
        ------
        ModelError
            If a time is needed and missing, or it is not strictly increasing, a number a sample.
        """
        if time is not None:
            return clock(time, samples)
        if self.needs_time:
            parts = {"creeps": self.creep, "has inertia": self.dynamics, "lags": self.lag}
            does = " and ".join(does for does, part in parts.items() if part)
            raise ModelError(f"this actuator {does}, so that the answer depends on time; {cure}")
        return np.array([0, samples]), np.zeros(1)

    def _pace(self, time: ArrayLike | None, samples: int) -> StepCoefficients:
        return self.pace(*self.clock(time, samples))

    def pace(self, bounds: NDArray[np.int64], durations: Array) -> StepCoefficients:
        """What steps of such durations (R,) [s] do; samples bounds[r] to bounds[r + 1] are of duration r.

        Raises
        ------
        ModelError
            If a step is too long for a resonance.
        """
        if self.creep is None and self.dynamics is None:
            bounds, durations = bounds[[0, -1]], np.zeros(1)
        empty = np.empty((durations.size, 0))
        decay, gain = (empty, empty) if self.creep is None else self.creep.tables(durations)
        if self.dynamics is None:
            return StepCoefficients(bounds, decay, gain, empty)
        share = self.dynamics.share(self.spring)
        pace = StepCoefficients(bounds, decay, gain, self.dynamics.transitions(durations, share))
        demand_result(pace.transition.ravel(), "time: what a step does to the mass", FARTHEST)
        self._demand_solvable(self.dynamics, share, pace, durations)
        return pace

    def amplifier(self, period: float) -> tuple[float, float, float, float]:
        """Lag in periods [s]; then keep, from_old and from_new of a voltage that is straight between samples."""
        if not self.lag:
            return 0.0, 0.0, 0.0, 1.0
        steps = period / self.lag
        demand_divisors(steps, "period over lag")
        keep, mean = math.exp(-steps), -math.expm1(-steps) / steps
        return 1 / steps, keep, mean - keep, 1 - mean

    def _demand_solvable(self, dynamics: Dynamics, share: float, pace: StepCoefficients, durations: Array) -> None:
        """An overshoot within one step pulls w back; it must not outdo the spring."""
        after = pace.transition[:, 6]
        slope = least_slope(self.slip, self.spring) + dynamics.series * (1 - after / (1 + share * after))
        if self.creep is not None:
            slope = slope + pace.gain @ self.creep.stiffness
        if np.any(slope <= 0):
            worst = durations[int(np.argmin(slope))]
            raise ModelError(
                f"time: a step of {worst:.3g} s is too long for a resonance at {dynamics.frequency / (2 * np.pi):.3g} "
                f"Hz and a spring this uneven; give {np.pi / 5 / dynamics.frequency:.2g} s or less"
            )

    def _push(self, load: ArrayLike | None, samples: int) -> Array:
        """F_ext/kc [m]."""
        if load is None:
            return EMPTY
        if self.load_stiffness is None:
            raise ModelError("load: this actuator does not know how far a force moves it; give load_stiffness= [N/m]")
        force = vector(load, "load")
        if force.size != samples:
            raise ModelError(f"load: got {force.size} values for {samples} samples, need as many")
        with np.errstate(over="ignore"):
            push = force / self.load_stiffness
        demand_result(push, "load over load_stiffness", FARTHEST)
        return push

    def _amplified(self, command: Array, time: ArrayLike | None, before: float) -> Array:
        """What a lagging amplifier makes of a command that is straight between samples, from its present voltage."""
        if not self.lag or not command.size or time is None:
            return command
        bounds, durations = clock(time, command.size)
        behind = strains(command, bounds, *Creep([self.lag], [0.0]).tables(durations), command[:1] - before)
        return command - behind[:, 0]

    def lead(self, path: Array, course: PathData) -> Array:
        """W less the path (n,) [m]: what inertia, damping and load ask for."""
        push = self._push(course.load, path.size)
        ahead = np.zeros(path.size) if self.dynamics is None else self.dynamics.lead(*self.derivatives(path, course))
        return ahead - push if push.size else ahead

    def derivatives(self, path: Array, course: PathData) -> tuple[Array, Array]:
        """Velocity and acceleration of the path, where they are not given those of its cubic spline."""
        self.clock(course.time, path.size)
        found = []
        for order, values, what in ((1, course.velocity, "velocity"), (2, course.acceleration, "acceleration")):
            if values is None:
                found.append(_spline(path, _seconds(course), order))
                continue
            given = vector(values, what)
            if given.size != path.size:
                raise ModelError(f"{what}: got {given.size} values for {path.size} samples, need as many")
            found.append(given)
        return found[0], found[1]


def _seconds(course: PathData) -> Array:
    return EMPTY if course.time is None else vector(course.time, "time")


def _spline(path: Array, time: Array, order: int) -> Array:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(time, path)(time, order)) if path.size > 1 else np.zeros(path.size)


def least_slope(slip: MaxwellSlip | GradedSlip, spring: Spring) -> float:
    """Least slope [V/m] of any branch, whatever the state.

    Raises
    ------
    ModelError
        If graded elements leave a branch that does not rise. It is enough to look at the outermost two: on any other
        some carts stand still, which adds to the slope.
    """
    if isinstance(slip, MaxwellSlip) or not len(slip):
        return float(spring.slopes.min())
    found = []
    for side, rho in (("rising", slip.breakaway), ("falling", -slip.breakaway)):
        bends = np.concatenate([spring.displacement[1:-1], slip.knots[1:-1], (slip.knots[1:-1, None] + rho).ravel()])
        bends = np.unique(bends) if bends.size else np.zeros(1)
        at = np.concatenate([[bends[0] - 1], 0.5 * (bends[1:] + bends[:-1]), [bends[-1] + 1]])
        own = spring.slopes[np.searchsorted(spring.displacement[1:-1], at, side="right")]
        gains, losses = slip.slopes_at(at[:, None]).sum(axis=1), slip.slopes_at(at[:, None] - rho).sum(axis=1)
        slope, rounding = own + gains - losses, _LEAST * (own + gains)
        worst = int(np.argmin(slope - rounding))
        if slope[worst] <= rounding[worst]:
            raise ModelError(
                f"with these graded elements the voltage does not rise with the displacement on the {side} outermost "
                f"branch near {at[worst]:.6g} m: its slope there is {slope[worst]:.3g} V/m. Identify with a slope floor"
            )
        found.append(float(slope.min()))
    return min(found)
