"""Evaluation of all parts of an actuator: elements and spring, with time, load and inertia."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import EMPTY, Core, CoreState, StepCoefficients, output_creep, strains
from dehyst._types import Array
from dehyst._validation import FARTHEST, LEAST, demand_computable, demand_result, vector
from dehyst.model.base import State
from dehyst.model.dynamics import DisplacementCreep, Dynamics, Thermal, clock, low_pass_tables
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer, segment_of
from dehyst.model.temperatures import demand_thermal

# Relative rounding error of the difference of two slopes, and of the numbers of a state.
_ROUNDING = 1e-9
# Coefficients of one run of steps of an actuator that does not depend on time.
_NO_COEFFICIENTS = (np.empty((1, 0)),) * 3


@dataclass(frozen=True)
class PathData:
    """Time (n,) [s] and load (n,) [N] along a path, or None; with dynamics, the derivatives of the path.

    `temperature`: one or (n,) [degC].
    """

    time: ArrayLike | None = None
    load: ArrayLike | None = None
    velocity: ArrayLike | None = None
    acceleration: ArrayLike | None = None
    temperature: ArrayLike | None = None


@dataclass(frozen=True, eq=False)
class Evaluator:
    """The parts of an `Actuator`: tau(v) = R(w) + smooth elements + beta (w - m), see `dehyst_model.h`.

    m is the displacement of the elements or the mass. The displacement y of the actuator is m with creep in
    displacement.
    """

    slip: MaxwellSlip | GradedSlip
    spring: Spring
    transformer: Transformer | None
    smooth: SmoothSlip | None
    dynamics: Dynamics | None
    lag: float
    load_stiffness: float | None
    displacement_creep: DisplacementCreep | None
    thermal: Thermal | None

    @property
    def needs_time(self) -> bool:
        """Whether the answer depends on time."""
        return self.displacement_creep is not None or self.has_dynamics

    @property
    def has_dynamics(self) -> bool:
        """Whether a mass or an amplifier still responds to earlier samples."""
        return self.dynamics is not None or self.lag > 0

    @cached_property
    def core(self) -> Core:
        """The parts as an object of the C core."""
        slip, tau, dynamics, smooth = self.slip, self.transformer, self.dynamics, self.smooth
        graded = slip if isinstance(slip, GradedSlip) else None
        return Core(
            slip.breakaway,
            slip.stiffness if graded is None else np.zeros(len(slip)),
            self.spring.displacement,
            self.spring.voltage,
            EMPTY if graded is None else graded.knots,
            EMPTY if graded is None else graded.stiffness.ravel(),
            EMPTY if tau is None else tau.voltage,
            EMPTY if tau is None else tau.drive,
            EMPTY if dynamics is None else np.array([dynamics.series, dynamics.share(self.spring)]),
            *((EMPTY,) * 3 if smooth is None else (smooth.length, smooth.closing, smooth.stiffness)),
            EMPTY if self.displacement_creep is None else self.displacement_creep.gains,
        )

    def simulate(self, voltage: Array, path: PathData, start: State, stack: bool) -> tuple[Array, State]:
        """Return the displacement (n,) [m] and the state reached; `start` is complete."""
        steps, push = self._steps(path.time, voltage.size), self._push(path.load, voltage.size)
        state = self.core_state(start)
        if self.lag:
            voltage = self._amplified(voltage, path.time, self.core.voltage(state))
            demand_result(voltage, "acting voltage")
        m, reached = self.core.simulate(voltage, steps, state, load=push if self.dynamics else EMPTY, stack=stack)
        m = m if self.dynamics or not push.size else m + push
        y, crept = self._creep_behind(m, steps, start, push)
        if path.temperature is not None:
            y = demand_thermal(self.thermal).warmed(y, path.temperature)
        demand_result(y, "displacement", FARTHEST)
        return y, self.state_of(reached, crept)

    def compensate(
        self, displacement: Array, path: PathData, start: State, stack: bool, since: float = 0.0
    ) -> tuple[Array, State]:
        """Return the voltage (n,) [V] and the state reached.

        `start`: complete state, `since` seconds before the first sample; by default at the first sample.
        """
        steps, push = self._steps(path.time, displacement.size, since), self._push(path.load, displacement.size)
        y = displacement
        if path.temperature is not None:
            thermal = demand_thermal(self.thermal)
            y, gain = thermal.at_reference(y, path.temperature), thermal.scale(path.temperature, y.size)[0]
            rates = {"velocity": path.velocity, "acceleration": path.acceleration}
            given = {what: vector(values, what) for what, values in rates.items() if values is not None}
            if all(values.size == y.size for values in given.values()):
                path = replace(path, **{what: values / gain for what, values in given.items()})
        m, crept = self._creep_behind(y, steps, start, push, inverse=True)
        w, more, state = m - push if push.size else m, EMPTY, self.core_state(start)
        if self.dynamics is not None:
            velocity, acceleration = self._derivatives_of_mass(y, m, path, steps, start)
            w = w + self.dynamics.lead(velocity, acceleration)
            more = self.dynamics.series * (w - m)
            if m.size:
                state = state._replace(motion=np.array([m[-1], velocity[-1] / self.dynamics.omega]))
        if w is not displacement:
            demand_result(w, "displacement of the electrical side")
        voltage, reached = self.core.compensate(w, steps, state, more=more, stack=stack)
        if self.lag:
            acting, seconds = voltage, _seconds(path)
            if since:
                acting = np.append(self.core.voltage(self.core_state(start)), voltage)
                seconds = np.append(seconds[0] - since, seconds)
            if acting.size > 1:
                rate = np.gradient(acting, seconds, edge_order=2 if acting.size > 2 else 1)
                voltage = voltage + self.lag * rate[-m.size :]
        demand_result(voltage, "voltage")
        return voltage, self.state_of(reached, crept)

    def _creep_behind(
        self, path: Array, steps: StepCoefficients, start: State, push: Array, *, inverse: bool = False
    ) -> tuple[Array, Array]:
        """Return the displacements y from m, or with `inverse` m from y, and the final creep strains (K,) [m]."""
        part = self.displacement_creep
        if part is None:
            return path, EMPTY
        # The state holds no load: it takes the load of the first sample, where a continued path begins.
        before = float(start.motion[0]) if self.dynamics else start.deformation + float(push[:1].sum())
        return output_creep(path, steps, part.gains, before, start.displacement_creep, inverse=inverse)

    def _derivatives_of_mass(
        self, y: Array, m: Array, path: PathData, steps: StepCoefficients, start: State
    ) -> tuple[Array, Array]:
        """Return velocity and acceleration of m from those of y: ``m' = y' - sum_k g_k e_k / tau_k``."""
        velocity, acceleration = self.derivatives(y, path)
        part = self.displacement_creep
        if part is None:
            return velocity, acceleration
        before = start.displacement_creep, float(start.motion[0])
        relative = strains(m, steps.bounds, steps.decay, steps.gain, *before) / part.time_constants
        velocity = velocity - relative @ part.gains
        return velocity, acceleration - (velocity[:, None] - relative) @ (part.gains / part.time_constants)

    def displacement(self, state: State, *, of_mass: bool = True) -> float:
        """Return the displacement [m] of the actuator in a complete state, without a load."""
        m, part = state.deformation, self.displacement_creep
        if of_mass and state.motion.size:
            m = float(state.motion[0])
        if part is None:
            return m
        y = part.at_rest * m
        for gain, strain in zip(part.gains.tolist(), state.displacement_creep.tolist(), strict=True):
            y -= gain * strain
        return y

    def core_state(self, state: State) -> CoreState:
        """Return the state as numbers of the C core."""
        motion = state.motion
        if self.dynamics is not None:
            motion = motion / np.array([1.0, self.dynamics.omega])
        strains = np.concatenate([state.smooth, state.displacement_creep])
        return CoreState(state.deformation, state.carts, strains, motion)

    def state_of(self, core: CoreState, crept: Array | None = None) -> State:
        """Return a state from numbers of the C core, with the strains of displacement creep if they are given."""
        end = core.strains.size - len(self.displacement_creep or ())
        smooth, behind = core.strains[:end], core.strains[end:] if crept is None else crept
        if self.dynamics is None:
            return State._unchecked(core.w, core.carts, core.motion, smooth, behind)
        return State(core.w, core.carts, core.motion * np.array([1.0, self.dynamics.omega]), smooth, behind)

    def complete_state(self, start: State) -> State:
        """Return the state without rounding errors; missing strains, elongations and motion are set to rest.

        Raise `ModelError` if the state does not fit the parts.
        """
        if not isinstance(start, State):
            need = "a State, such as the state of a Motion"
            raise ModelError(argument="state", got=type(start).__name__, need=need)
        rho, length, w = self.slip.breakaway, EMPTY if self.smooth is None else self.smooth.length, start.deformation
        rest = {
            "motion": np.array([w, 0.0]) if self.dynamics is not None else EMPTY,
            "smooth": np.zeros(length.size),
            "displacement_creep": np.zeros(len(self.displacement_creep or ())),
        }
        sizes = {"carts": rho.size, **{name: values.size for name, values in rest.items()}}
        given = {name: getattr(start, name) for name in sizes}
        for name, size in sizes.items():
            if given[name].size != size and (given[name].size or name not in rest):
                need = f"{size} for the parts of this actuator"
                raise ModelError(argument=f"state {name}", got=f"{given[name].size} numbers", need=need)
        carts = _within(given["carts"], w, rho, rho + abs(w), "carts")
        motion, smooth, crept = (given[name] if given[name].size else values for name, values in rest.items())
        return State._unchecked(w, carts, motion, _within(smooth, 0.0, length, length, "smooth"), crept)

    def clock(
        self, time: ArrayLike | None, samples: int, remedy: str = "give the time [s] of each sample"
    ) -> tuple[NDArray[np.int64], Array]:
        """Return runs of equal steps, see `dehyst._native.steps`; without time, one run of duration 0.

        Raise `ModelError` if a required time is missing, or the time has another length than the samples or does not
        strictly increase.
        """
        if time is not None:
            return clock(time, samples)
        if self.needs_time:
            parts = {"creeps": self.displacement_creep, "has inertia": self.dynamics, "lags": self.lag}
            verbs = " and ".join(verb for verb, part in parts.items() if part)
            raise ModelError(
                f"this actuator {verbs}, so that the answer depends on time",
                hint=remedy,
                change=("time", "sample_rate"),
            )
        return np.array([0, samples]), np.zeros(1)

    def _steps(self, time: ArrayLike | None, samples: int, since: float = 0.0) -> StepCoefficients:
        if time is None and not self.needs_time:
            return StepCoefficients(np.array([0, samples]), *_NO_COEFFICIENTS)
        bounds, durations = self.clock(time, samples)
        return self.step_coefficients(bounds, np.append(since, durations[1:]) if since else durations)

    def step_coefficients(self, bounds: NDArray[np.int64], durations: Array) -> StepCoefficients:
        """Return the coefficients of steps of durations (R,) [s]; samples bounds[r] to bounds[r + 1] have duration r.

        Raise `ModelError` if a step is too long for a resonance.
        """
        behind = self.displacement_creep
        if self.dynamics is None and behind is None:
            bounds, durations = bounds[[0, -1]], np.zeros(1)
        empty = np.empty((durations.size, 0))
        decay, gain = (empty, empty) if behind is None else low_pass_tables(behind.time_constants, durations)
        if self.dynamics is None:
            return StepCoefficients(bounds, decay, gain, empty)
        share = self.dynamics.share(self.spring)
        steps = StepCoefficients(bounds, decay, gain, self.dynamics.transitions(durations, share))
        demand_result(steps.transition.ravel(), "time: motion of the mass in a step", FARTHEST)
        self._demand_solvable(self.dynamics, share, steps, durations)
        return steps

    def amplifier(self, period: float) -> tuple[float, float, float, float]:
        """Return lag / `period`, keep, from_old and from_new of the low-pass, for a voltage linear between samples."""
        if not self.lag:
            return 0.0, 0.0, 0.0, 1.0
        steps = period / self.lag
        demand_computable(steps, "period over lag", LEAST)
        keep, mean = math.exp(-steps), -math.expm1(-steps) / steps
        return 1 / steps, keep, mean - keep, 1 - mean

    def _demand_solvable(self, dynamics: Dynamics, share: float, steps: StepCoefficients, durations: Array) -> None:
        """Raise `ModelError` if an overshoot within one step would pull w back by more than the spring allows."""
        after = steps.transition[:, 6]
        slope = least_slope(self.slip, self.spring) + dynamics.series * (1 - after / (1 + share * after))
        if np.any(slope <= 0):
            worst = durations[int(np.argmin(slope))]
            raise ModelError(
                f"time: a step of {worst:.3g} s is too long for a resonance at {dynamics.frequency:.3g} Hz and a "
                f"spring with such different slopes; give {0.1 / dynamics.frequency:.2g} s or less"
            )

    def _push(self, load: ArrayLike | None, samples: int) -> Array:
        """Return F_ext/kc [m]."""
        if load is None:
            return EMPTY
        if self.load_stiffness is None:
            raise ModelError(
                "the load stiffness of this actuator is not known",
                argument="load",
                hint="give it [N/m]",
                change=("load_stiffness",),
            )
        force = vector(load, "load")
        if force.size != samples:
            raise ModelError(f"load: got {force.size} values for {samples} samples, need one per sample")
        with np.errstate(over="ignore"):
            push = force / self.load_stiffness
        demand_result(push, "load over load_stiffness", FARTHEST)
        return push

    def _amplified(self, command: Array, time: ArrayLike | None, before: float) -> Array:
        """Return the output of a lagging amplifier, from its present voltage, for a command linear between samples."""
        if not command.size or time is None:
            return command
        bounds, durations = clock(time, command.size)
        difference = strains(command, bounds, *low_pass_tables(np.array([self.lag]), durations), command[:1] - before)
        return command - difference[:, 0]

    def derivatives(self, displacement: Array, path: PathData) -> tuple[Array, Array]:
        """Return velocity and acceleration of a path, from its cubic spline if they are not given."""
        self.clock(path.time, displacement.size)
        columns = []
        for order, values, what in ((1, path.velocity, "velocity"), (2, path.acceleration, "acceleration")):
            found = _spline_derivative(displacement, path, order) if values is None else vector(values, what)
            if found.size != displacement.size:
                raise ModelError(
                    argument=what, got=f"{found.size} values for {displacement.size} samples", need="one per sample"
                )
            columns.append(found)
        return columns[0], columns[1]


def _within(values: Array, centre: float, most: Array, size: Array, what: str) -> Array:
    """Return values of a state, clipped to the distance `most` from a centre.

    Raise `ModelError` if a value lies farther away by more than a rounding error, which is a part of `size`.
    """
    excess = np.abs(values - centre) - most
    if not np.any(excess > 0):
        return values
    if np.any(excess > _ROUNDING * size):
        worst = int(np.argmax(excess))
        got = f"number {worst} at {most[worst] + excess[worst]:.3g} m from {centre:.3g} m"
        raise ModelError(argument=f"state {what}", got=got, need=f"{most[worst]:.3g} m or less for its element")
    return np.clip(values, centre - most, centre + most)


def _seconds(path: PathData) -> Array:
    return EMPTY if path.time is None else vector(path.time, "time")


def _spline_derivative(displacement: Array, path: PathData, order: int) -> Array:
    from scipy.interpolate import CubicSpline

    if displacement.size < 2:
        return np.zeros(displacement.size)
    time = _seconds(path)
    return np.asarray(CubicSpline(time, displacement)(time, order))


@lru_cache(maxsize=16)
def least_slope(slip: MaxwellSlip | GradedSlip, spring: Spring) -> float:
    """Return the least slope [V/m] of any branch in any state.

    Raise `ModelError` if the voltage does not rise on a branch of graded elements. Only the outermost two branches can
    fail: on any other branch some carts stand still, which adds to the slope.
    """
    if isinstance(slip, MaxwellSlip) or not len(slip):
        return float(spring.slopes.min())
    least = []
    for side, rho in (("rising", slip.breakaway), ("falling", -slip.breakaway)):
        bends = np.concatenate([spring.displacement[1:-1], slip.knots[1:-1], (slip.knots[1:-1, None] + rho).ravel()])
        bends = np.unique(bends) if bends.size else np.zeros(1)
        # Nothing lies between bends that coincide but for rounding.
        apart = np.diff(bends) > _ROUNDING * np.ptp(bends)
        at = np.concatenate([[bends[0] - 1], 0.5 * (bends[1:] + bends[:-1])[apart], [bends[-1] + 1]])
        own_slope = spring.slopes[segment_of(spring.displacement, at)]
        gains, losses = slip.slopes_at(at[:, None]).sum(axis=1), slip.slopes_at(at[:, None] - rho).sum(axis=1)
        slope, rounding = own_slope + gains - losses, _ROUNDING * (own_slope + gains)
        worst = int(np.argmin(slope - rounding))
        if slope[worst] <= rounding[worst]:
            raise ModelError(
                f"with these graded elements the voltage does not rise with the displacement on the {side} outermost "
                f"branch near {at[worst]:.6g} m: its slope there is {slope[worst]:.3g} V/m. Identify with a slope floor"
            )
        least.append(float(slope.min()))
    return min(least)
