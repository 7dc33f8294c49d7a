"""What is given to a bank: what it is made of, a compensator for each actuator, and its samples."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.control import Compensator
from dehyst.model import Actuator, State


def reason_alone(actuator: Actuator) -> str:
    """Return the part for which an actuator must be computed alone, or nothing."""
    model = actuator.model
    if model.core.in_lanes and not model.lag:
        return ""
    if model.lag:
        return "an amplifier that lags"
    if model.dynamics is not None:
        return "a mass"
    return "smooth elements" if model.smooth is not None else "graded elements"


def compensators(
    actuators: tuple[Actuator, ...],
    limits: Any,
    slew_rate: Any,
    period: float | None,
    states: State | Sequence[State] | None,
) -> list[Compensator]:
    """Return a compensator for each: they check what was given."""
    m = len(actuators)
    low_high = _for_each(limits, m, "limits", single=limits is None or np.ndim(limits) == 1)
    slews = _for_each(slew_rate, m, "slew_rate", single=slew_rate is None or np.ndim(slew_rate) == 0)
    starts = _for_each(states, m, "states", single=states is None or isinstance(states, State))
    made = []
    for i in range(m):
        try:
            made.append(Compensator(actuators[i], low_high[i], slews[i], period=period, state=starts[i]))
        except ModelError as error:
            raise ModelError(f"actuator {i}: {error}") from error
    return made


def _for_each(values: Any, m: int, what: str, *, single: bool) -> list[Any]:
    if single:
        return [values] * m
    each = listed(values, what)
    if len(each) != m:
        raise ModelError(argument=what, got=f"{len(each)} for {m} actuators", need="one for each, or one for all")
    return each


def listed(values: Any, what: str) -> list[Any]:
    """Return `values` as a list; raise `ModelError` if they are none."""
    if not isinstance(values, Iterable):
        raise ModelError(argument=what, got=type(values).__name__, need="a list with one for each actuator")
    return list(values)


def positive(threads: int) -> int:
    """Return a number of `threads`; raise `ModelError` if it is none."""
    count = number(threads, "threads")
    if count < 1 or count != int(count):
        raise ModelError(f"threads: got {threads}, need a whole number from 1 on")
    return int(count)


def table_of(values: ArrayLike, what: str, count: int) -> Array:
    """Return samples (n, count); raise `ModelError` if they have another shape, or one is no finite number."""
    given = np.asarray(values)
    if given.dtype.kind not in "iuf":
        raise ModelError(argument=what, got=f"an array of {given.dtype}", need="numbers")
    table = np.ascontiguousarray(given, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != count:
        got = table.shape[1:] if table.ndim == 2 and what == "displacement" else table.shape
        raise ModelError(argument=what, got=f"the shape {got}", need=f"a column for each of {count} actuators")
    if not np.isfinite(table).all():
        t, i = np.argwhere(~np.isfinite(table))[0]
        raise ModelError(f"{what}: sample {t} of actuator {i} is {table[t, i]}, need finite numbers")
    return table


def fitting(out: Array, count: int) -> Array:
    """Return `out`, into which a sample (count,) can be written; raise `ModelError` if it cannot."""
    fits = isinstance(out, np.ndarray) and out.shape == (count,) and out.dtype == np.float64
    if not (fits and out.flags.c_contiguous and out.flags.writeable):
        raise ModelError(f"out: need a writeable array of {count} float64 in a row")
    return out
