"""Checks of numbers, arrays and options of the caller; each error states what was got and what is needed.

Every check raises the class `error`.

The core multiplies, divides and adds the numbers of a model. The results must stay finite, also for motions far beyond
the records. The rule limits magnitudes, in SI units, and is far wider than any device needs:

- A coordinate, a stiffness, a ratio or a delay is 1e30 at most in magnitude.
- A divisor is between 1e-30 and 1e30: the distance of two knots, a length, a time constant, a frequency.
- A voltage limit, which is only compared, is 1e300 at most: the difference of two limits is then finite.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import isroutine
from math import inf
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import DehystError, IdentifyError, ModelError, of_part
from dehyst._types import Array

# Default names of axes.
DEFAULT_AXES = ("x", "y", "z")

LEAST, MOST, MOST_ADDED = 1e-30, 1e30, 1e300
# DEHYST_FARTHEST of the core, the largest displacement.
FARTHEST = float(np.finfo(np.float64).eps) ** -2
_LARGEST = float(np.finfo(np.float64).max)
_PLAIN = frozenset({float, int, bool, str, bytes, type(None), np.float64, np.float32, np.int64, np.int32, np.bool_})


def keep(owner: object, **fields: Any) -> None:
    """Set fields of a frozen dataclass; arrays become read-only."""
    for name, value in fields.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(owner, name, value)


def untimely(time: Array, samples: int) -> str:
    """Return an error for times whose number is not that of the `samples`, or which do not increase."""
    if time.size != samples:
        return f"time: got {time.size} values for {samples} samples, need one per sample"
    k = int(np.argmax(np.diff(time) <= 0)) + 1
    got = f"got {time[k]:.9g} s after {time[k - 1]:.9g} s in row {k + 1} of {samples}"
    return f"time: {got}, need strictly increasing times; sort the samples, and leave out those that repeat a time"


def plain(values: Any, what: str, *, error: type[DehystError] = ModelError) -> Any:
    """Return values unchanged; raise `error` if NumPy would drop a unit, a mask or an imaginary part."""
    kind = type(values)
    if kind in _PLAIN or (kind is np.ndarray and values.dtype.kind not in "OcmM"):
        return values
    if isinstance(values, list | tuple):
        if not _PLAIN.issuperset(map(type, values)):
            return [plain(value, what, error=error) for value in values]
        return values
    if unit := _unit_of(values) or _unit_of(getattr(values, "data", None)):
        hint = 'give only the numbers, as quantity.to("um").magnitude, or numpy.asarray(numbers)'
        raise error(argument=what, got=f"a quantity in {unit}", need="plain numbers", hint=hint)
    mask, stored = getattr(values, "mask", None), getattr(getattr(values, "dtype", None), "kind", "")
    # Tables and series of pandas have a method of this name.
    if isinstance(mask, np.ndarray | np.bool_ | bool) and np.any(mask):
        raise error(argument=what, got="an array with masked values", need="all of them")
    if stored and stored in "mM":
        raise error(argument=what, got="dates or durations", need="plain numbers, as seconds since the first")
    if stored == "c":
        raise error(argument=what, got="complex numbers", need="real ones", hint="give their real part, or magnitude")
    return plain(np.asarray(values).tolist(), what, error=error) if stored == "O" and np.ndim(values) else values


def _unit_of(values: Any) -> str:
    """Return the unit of a quantity of pint, astropy or another library, or of an array of xarray; "" if none."""
    attributes = (getattr(values, name, None) for name in ("units", "unit"))
    return next((str(unit) for unit in attributes if unit is not None and not isroutine(unit)), "")


def vector(values: ArrayLike, what: str, *, error: type[DehystError] = ModelError) -> Array:
    """Return `values` as a contiguous one-dimensional array of finite doubles.

    Raise `error` if it has another number of dimensions, is not numeric, has a unit, or holds NaN or infinity.
    """
    return spanned(values, what, error=error)[0]


def spanned(values: ArrayLike, what: str, *, error: type[DehystError] = ModelError) -> tuple[Array, float, float]:
    """Return the array that `vector` returns, its smallest and its largest value; both are NaN if it is empty."""
    array = _doubles(values, what, error)
    if array.ndim != 1:
        raise error(argument=what, got=f"an array of shape {array.shape}", need="one dimension")
    if not array.size:
        return array, math.nan, math.nan
    low, high = float(np.minimum.reduce(array)), float(np.maximum.reduce(array))
    if not (math.isfinite(low) and math.isfinite(high)):
        bad = np.flatnonzero(~np.isfinite(array))
        words = f"{bad.size} of {array.size} values are not finite, first at index {bad[0]}"
        raise error(words, argument=what, hint="fill them in")
    return array, low, high


def matrix(values: ArrayLike, what: str, *, error: type[DehystError] = ModelError) -> Array:
    """Return `values` as a contiguous two-dimensional array of finite doubles; raise as `vector` does."""
    array = _doubles(values, what, error)
    array = array.reshape(0, 0) if array.shape == (0,) else array
    if array.ndim != 2:
        raise error(argument=what, got=f"an array of shape {array.shape}", need="two dimensions")
    spanned(array.ravel(), what, error=error)
    return array


def _doubles(values: ArrayLike, what: str, error: type[DehystError]) -> Array:
    numbers = plain(values, what, error=error)
    try:
        given = np.asarray(numbers)
        if given.dtype.kind not in "iuf" and given.size:
            raise TypeError
        return np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError) as cause:
        raise error(argument=what, got=type(values).__name__, need="an array of numbers") from cause


def number(value: object, what: str, *, error: type[DehystError] = ModelError) -> float:
    """Return `value` as a finite float; raise `error` for anything else."""
    bare = plain(value, what, error=error)
    if isinstance(bare, Real) and not isinstance(bare, bool):
        with suppress(OverflowError):
            if math.isfinite(as_float := float(bare)):
                return as_float
    raise error(argument=what, got=repr(value), need="a finite number")


def interval(limits: Sequence[float], *, error: type[DehystError] = ModelError) -> tuple[float, float]:
    """Return voltage limits [V] as two floats; raise `error` unless they are finite, the lower one first."""
    pair = plain(limits, "limits", error=error)
    ends = [number(end, "limits", error=error) for end in pair] if isinstance(pair, Sequence | np.ndarray) else []
    if len(ends) != 2 or ends[0] >= ends[1]:
        got, need = " and ".join(f"{end:g}" for end in ends) or limits, "two finite voltages, the lower one first"
        raise error(argument="limits", got=got, need=need)
    demand_computable(ends, "limits [V]", most=MOST_ADDED, error=error)
    return ends[0], ends[1]


def for_each(values: Any, count: int, what: str, *, error: type[DehystError] = ModelError) -> list[Any]:
    """Return one entry for each of `count` axes or actuators, from one entry for all, or from a list.

    A pair of numbers is one entry: limits. Raise `error` that names `what` if the list has another length.
    """
    alone = isinstance(values, str) or not isinstance(values, Iterable) or getattr(values, "ndim", 1) == 0
    given = [values] if alone else list(values)
    if what == "limits" and len(given) == 2 and all(end is not None and np.ndim(end) == 0 for end in given):
        given = [values]
    if len(given) not in (1, count):
        raise error(argument=what, got=f"{len(given)} for {count}", need="one, or one for each")
    return (given * count)[:count]


def count(
    value: object, name: str, least: int = 1, most: int | None = 500, *, error: type[DehystError] = IdentifyError
) -> int:
    """Return a whole number from `least` to `most` (None: no upper bound); raise `error` for anything else."""
    if isinstance(value, Integral) and not isinstance(value, bool) and least <= int(value) <= (most or inf):
        return int(value)
    raise error(argument=name, got=repr(value), need=f"a whole number from {least}{(f' to {most}' if most else '')}")


def choice(value: Any, name: str, among: Collection[str], *, error: type[DehystError] = IdentifyError) -> str:
    """Return a value that is one of the words; raise `error` for any other value."""
    words = " or ".join(map(repr, among))
    near = get_close_matches(value, among, 1) if isinstance(value, str) else []
    if not isinstance(value, str) or value not in among:
        raise error(argument=name, got=repr(value), need=words + (f"; did you mean {near[0]!r}?" if near else ""))
    return value


def axis_names(axes: Sequence[str], count: int, what: str, error: type[DehystError] = ModelError) -> tuple[str, ...]:
    """Return the names of `count` axes; raise `error` unless these are `count` different names without blanks."""
    names = tuple(axes)
    good = all(isinstance(name, str) and name and not set(name) & set(" \t\n,;:\"'") for name in names)
    if isinstance(axes, str) or len(names) != count or not good or len(set(names)) < count or not count:
        need = f"{count} different names without blanks, such as x, y"
        raise of_part(error(argument="axes", got=", ".join(map(str, names)), need=need), what)
    return names


def demand_result(values: Array, what: str, most: float = _LARGEST) -> None:
    """Raise ModelError for a result that is not finite, or is larger than `most`."""
    if not values.size or (values.min() >= -most and values.max() <= most):
        return
    first = int(np.argmax(~(np.abs(values) <= most)))
    raise ModelError(
        f"{what}: value {first} would be {values[first]:.3g}, too large to compute with; check the units of the input, "
        "and stay near the range of the model"
    )


def demand_computable(
    values: ArrayLike, what: str, least: float = -inf, most: float = MOST, *, error: type[DehystError] = ModelError
) -> None:
    """Raise `error` for magnitudes over `most` or below `least`, which is `LEAST` for a divisor."""
    magnitudes = np.abs(np.asarray(values, dtype=np.float64)).ravel()
    bad = np.flatnonzero(~((magnitudes >= least) & (magnitudes <= most)))
    if bad.size:
        needed = f"at most {most:g}" if least < 0 else f"{least:g} to {most:g}"
        raise error(
            argument=what,
            got=f"{magnitudes[bad[0]]:.3g}, which is out of range",
            need=f"{needed} in magnitude, in SI units",
            hint="check the units, or whether the file is damaged",
        )


@dataclass(frozen=True)
class Numbers:
    """A checker of a number, a vector or a table, with conditions for each number.

    `dimensions`: 0, 1 or 2. `positive`: above 0. `least`, `most`: smallest and largest number. `rising`: each is larger
    than the one before. `divides`: the numbers, or the steps between rising numbers, are divisors. `largest`: largest
    magnitude for computing. `plausible`: largest magnitude in a file, far above that of any piezo actuator. `optional`:
    None is allowed. `error`: the class that is raised.
    """

    dimensions: int = 0
    positive: bool = False
    least: float = -inf
    most: float = inf
    rising: bool = False
    divides: bool = False
    largest: float = MOST
    plausible: float = inf
    optional: bool = False
    hint: str = ""
    error: type[DehystError] = ModelError

    def __call__(self, value: Any, where: str) -> Any:
        """Return the number as a float, or numbers as an array; raise `error` if one is impossible."""
        if value is None and self.optional:
            return None
        found = (number, vector, matrix)[self.dimensions](value, where, error=self.error)
        demand_computable(found, where, most=self.largest, error=self.error)
        numbers = np.atleast_1d(found)
        bad = (numbers < self.least) | (numbers > self.most) | (self.positive & (numbers <= 0))
        if self.rising:
            bad[1:] |= np.diff(numbers) <= 0
        if bad.any():
            first = tuple(np.argwhere(bad)[0].tolist())
            place = f" at index {', '.join(map(str, first))}" if numbers.size > 1 else ""
            raise self.error(argument=where, got=f"{numbers[first]:.6g}{place}", need=self.need, hint=self.hint)
        if self.divides:
            steps = np.diff(numbers) if self.rising else numbers[numbers != 0]
            demand_computable(steps, f"{where}: steps" if self.rising else where, LEAST, error=self.error)
        return found

    @property
    def need(self) -> str:
        """The conditions for the numbers, as text."""
        words = [f"{self.least:g} or more"] * (self.least > -inf) + [f"{self.most:g} or less"] * (self.most < inf)
        words = [f"{self.least:g} to {self.most:g}"] if len(words) == 2 else words
        words += ["above 0"] * self.positive + ["strictly increasing"] * self.rising
        return ", ".join(["numbers" if self.dimensions else "a number", *words])


def fraction(value: object, name: str, least: float | None = None) -> float:
    """Return a number below 1 and above 0 (or at least `least`); raise `IdentifyError` for anything else."""
    bounds = Numbers(positive=least is None, least=least or 0.0, most=math.nextafter(1.0, 0.0), error=IdentifyError)
    return float(bounds(value, name))
