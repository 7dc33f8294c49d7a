"""The only door to the C core: arrays are made contiguous here, and its refusals become `ModelError`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst import _core
from dehyst._errors import ModelError

Array = NDArray[np.float64]


def vector(values: ArrayLike, what: str) -> Array:
    """Return `values` as a contiguous one-dimensional array of finite doubles.

    Raises
    ------
    ModelError
        If it has another number of dimensions, is not numeric, or holds NaN or infinity.
    """
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "iuf" and given.size:
            raise TypeError
        array = np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise ModelError(f"{what}: got {type(values).__name__}, need an array of numbers") from error
    if array.ndim != 1:
        raise ModelError(f"{what}: got an array of shape {array.shape}, need one dimension")
    bad = np.flatnonzero(~np.isfinite(array))
    if bad.size:
        raise ModelError(f"{what}: {bad.size} of {array.size} values are not finite, the first at index {bad[0]}")
    return array


def number(value: object, what: str) -> float:
    """Return `value` as a finite float.

    Raises
    ------
    ModelError
        If it is no number, or NaN or infinite.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            as_float = float(value)
        except OverflowError:
            as_float = math.inf
        if math.isfinite(as_float):
            return as_float
    raise ModelError(f"{what}: got {value!r}, need a finite number")


class Core:
    """An actuator's tables in C. Equations and names: `core/dehyst.h`.

    Parameters
    ----------
    rho, kappa : (N,) array
        Breakaway elongations [m], strictly increasing, and stiffnesses [V/m] of the elements.
    knots, values : (M,) array
        The parallel spring: displacement [m] and voltage [V], both strictly increasing, M >= 2.

    Raises
    ------
    ModelError
        If the core refuses the numbers.
    """

    __slots__ = ("_core",)

    def __init__(self, rho: Array, kappa: Array, knots: Array, values: Array) -> None:
        try:
            self._core = _core.Core(rho, kappa, knots, values)
        except _core.CoreError as error:
            raise ModelError(f"impossible actuator: {error}") from error

    def compensate(self, y: Array, start: float, carts: Array, *, stack: bool = True) -> tuple[Array, float, Array]:
        """Displacements [m] to voltages [V] from the state (start, carts); returns the state reached too."""
        return self._run(self._core.compensate, y, start, carts, stack)

    def simulate(self, v: Array, start: float, carts: Array, *, stack: bool = True) -> tuple[Array, float, Array]:
        """Voltages [V] to displacements [m] from the state (start, carts); returns the state reached too."""
        return self._run(self._core.simulate, v, start, carts, stack)

    def depth(self, y: Array, start: float, carts: Array) -> int:
        """Entries on the stack of reversals after the displacements y."""
        return int(checked(self._core.depth, y, start, carts))

    def voltage(self, y: float, carts: Array) -> float:
        """Voltage [V] in the state (y, carts)."""
        return float(checked(self._core.voltage, y, carts))

    def spring_at(self, y: float) -> float:
        """Voltage [V] of the parallel spring at y."""
        return float(self._core.spring_at(y))

    def spring_inverse(self, v: float) -> float:
        """Displacement [m] at which the parallel spring alone holds v."""
        return float(self._core.spring_inverse(v))

    def _run(
        self, function: Callable[..., Any], x: Array, start: float, carts: Array, stack: bool
    ) -> tuple[Array, float, Array]:
        out, position, moved = checked(function, x, start, carts, stack)
        return out, float(position), moved


def checked(function: Callable[..., Any], *arguments: object) -> Any:
    """Call the core; its refusal becomes a `ModelError`."""
    try:
        return function(*arguments)
    except _core.CoreError as error:
        raise ModelError(f"impossible state: {error}") from error


def stops(rho: Array, carts: Array | Sequence[float], y: Array) -> tuple[Array, Array]:
    """Elongations (n, N) of elements of breakaway `rho` driven by y (n,), from and to the cart positions."""
    matrix, moved = checked(_core.stops, rho, np.array(carts, dtype=np.float64), y)
    return matrix, moved
