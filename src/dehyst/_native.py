"""The only interface to the C core. Its refusals become `ModelError`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import dehyst._core as compiled
from dehyst._errors import ModelError
from dehyst._types import Array

EMPTY: Array = np.zeros(0)
EMPTY.flags.writeable = False


class Core:
    """Tables of an actuator in C, which chooses the fastest evaluator for the parts that it has.

    Equations and names: `core/include/dehyst.h`. Copies and pickles have the numbers from which it is made.

    `rho`, `kappa` (N,): breakaway elongations [m], strictly increasing, and stiffnesses [V/m] of the elements; with
    grades, the stiffnesses are not read. `knots`, `values` (K,): the parallel spring, displacement [m] and voltage [V],
    both strictly increasing, K >= 2. Empty if there is no such part: `grade_knots` (M + 1,) [m] and `grades` (N M,)
    [V/m], a row an element; `voltages`, `drives` (L,), the transformer tau; `inertia` (2,), beta [V/m] and theta;
    `lengths`, `closings`, `smooth` (L,), smooth elements and their stiffnesses k_l [V/m]; `output` (K,), gains g_k of
    creep behind the elements, whose strains follow the elongations; only a loop computes this creep. Raise `ModelError`
    if the core refuses the numbers.
    """

    __slots__ = ("_core", "_made_from")

    def __init__(
        self,
        rho: Array,
        kappa: Array,
        knots: Array,
        values: Array,
        grade_knots: Array = EMPTY,
        grades: Array = EMPTY,
        voltages: Array = EMPTY,
        drives: Array = EMPTY,
        inertia: Array = EMPTY,
        lengths: Array = EMPTY,
        closings: Array = EMPTY,
        smooth: Array = EMPTY,
        output: Array = EMPTY,
    ) -> None:
        grading, tau = (grade_knots, grades), (voltages, drives)
        self._made_from = rho, kappa, knots, values, *grading, *tau, inertia, lengths, closings, smooth, output
        try:
            self._core = compiled.Core(*self._made_from)
        except compiled.CoreError as error:
            raise ModelError(f"impossible actuator: {error}") from error

    def __reduce__(self) -> tuple[type, tuple[Array, ...]]:
        return type(self), self._made_from

    def compensate(
        self, w: Array, pace: StepCoefficients, start: CoreState, *, more: Array = EMPTY, stack: bool = True
    ) -> tuple[Array, CoreState]:
        """Convert displacements [m] to voltages [V], with `more` [V] added to tau(v); also return the last state."""
        return self._run(self._core.compensate, w, more, pace, start, stack)

    def simulate(
        self, v: Array, pace: StepCoefficients, start: CoreState, *, load: Array = EMPTY, stack: bool = True
    ) -> tuple[Array, CoreState]:
        """Convert voltages [V] to displacements [m] under a load F_ext/kc [m]; also return the last state."""
        return self._run(self._core.simulate, v, load, pace, start, stack)

    def voltage(self, start: CoreState) -> float:
        """Return the voltage [V] in a state."""
        return float(checked(self._core.voltage, *start))

    def depth(self, y: Array, start: float, carts: Array) -> int:
        """Count the entries of the stack of reversals after displacements y [m] from a state (start, carts)."""
        return int(checked(self._core.depth, y, start, carts))

    def spring_inverse(self, v: float) -> float:
        """Return the displacement [m] at which the parallel spring alone needs the voltage v."""
        return float(self._core.spring_inverse(v))

    def loop(
        self,
        pace: StepCoefficients,
        tap: Array,
        numbers: Array,
        on_clamp: Callable[[bool, float, float, float], None],
        start: CoreState,
    ) -> compiled.Loop:
        """Return a loop with the coefficients of one step, from a state; see `dehyst_model`.

        `tap` (M,). `numbers` (7,): lowest and highest voltage, largest change, lag in periods, and the three
        coefficients of the amplifier. `on_clamp` is called at the first clamp of each kind, before its voltage is
        committed, with four arguments: whether the slew rate is the cause, the wanted displacement [m], the voltage
        [V], and the one sent before [V].
        """
        decay, gain, transition = (table[0] for table in pace[1:])
        loop: compiled.Loop = checked(compiled.Loop, self._core, decay, gain, transition, tap, numbers, on_clamp)
        checked(loop.begin, *start)
        return loop

    def _run(
        self, function: Callable[..., Any], x: Array, more: Array, pace: StepCoefficients, start: CoreState, stack: bool
    ) -> tuple[Array, CoreState]:
        out, w, *rest = checked(function, x, more, *pace, *start, stack)
        return out, CoreState(float(w), *rest)


class CoreState(NamedTuple):
    """A state as numbers [m]: w, carts (N,), elongations and strains behind the elements (L + K,), motion.

    With inertia `motion` (2,) is y and y'/omega.
    """

    w: float
    carts: Array
    strains: Array
    motion: Array


class StepCoefficients(NamedTuple):
    """Coefficients of steps of time: samples bounds[r] to bounds[r + 1] are equal steps with the coefficients of row r.

    `bounds` (R + 1,). `decay`, `gain` (R, K): coefficients of creep behind the elements.
    `transition` (R, 8) or (R, 0): coefficients of a mass: phi, before and after of `dehyst_transition`.
    """

    bounds: NDArray[np.int64]
    decay: Array
    gain: Array
    transition: Array


CoreError = compiled.CoreError
Bank = compiled.Bank
Feedback = compiled.Feedback
Loop = compiled.Loop
judge = compiled.judge


def checked(function: Callable[..., Any], *arguments: object) -> Any:
    """Call the core; its refusal becomes a `ModelError`."""
    try:
        return function(*arguments)
    except compiled.CoreError as error:
        raise ModelError(f"impossible state: {error}") from error


def slip_elongations(rho: Array, carts: Array | Sequence[float], y: Array) -> tuple[Array, Array]:
    """Return the elongations (n, N) of elements with breakaway `rho` along y (n,), and the carts at the end."""
    matrix, moved = checked(compiled.slip_elongations, rho, np.array(carts, dtype=np.float64), y)
    return matrix, moved


def smooth_elongations(length: Array, closing: Array, y: Array, start: Array | None = None) -> Array:
    """Return the elongations (n, L) of smooth elements along y (n,); they begin with `start` (L,) or 0."""
    begin = np.zeros(length.size) if start is None else start
    matrix: Array = checked(compiled.smooth_elongations, length, closing, y, begin)
    return matrix


def steps(time: Array) -> tuple[NDArray[np.int64], Array]:
    """Divide samples into runs of equal steps of time: bounds (R + 1,) and the duration (R,) [s] of a step in each.

    The first sample, which has no step before it, is a run without duration. Each step that is not positive is a run.
    """
    bounds, durations = compiled.steps(time)
    return bounds, durations


def strains(
    path: Array, bounds: NDArray[np.int64], decay: Array, gain: Array, start: Array, before: float | None = None
) -> Array:
    """Return the strains (n, K) of low-passes along a path (n,) that begins with the strains `start` (K,).

    `start` belongs to the displacement `before` the first sample, which by default equals the first sample.
    """
    if before is None:
        before = float(path[0]) if path.size else 0.0
    matrix, _ = checked(compiled.strains, path, bounds, decay, gain, before, start)
    return np.asarray(matrix)


def output_creep(
    path: Array, pace: StepCoefficients, gains: Array, before: float, strains: Array, *, inverse: bool = False
) -> tuple[Array, Array]:
    """Return the path (n,) [m] with creep behind the elements, and the strains (K,) [m] at its end.

    Its coefficients are those of `pace`. `before` [m] is the displacement without creep before the first sample,
    at which the strains are `strains`. With `inverse`, `path` includes creep, and the result is the displacement
    without it.
    """
    out, reached = checked(compiled.output_creep, path, *pace[:3], gains, before, strains, inverse)
    return np.asarray(out), np.asarray(reached)
