"""The golden trace: calls of a compensator and their results in Python, which the exported code replays."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from contextlib import suppress
from enum import IntEnum
from itertools import pairwise
from string import Template
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import Clamps, ClampWarning, Compensator
from dehyst.model import Actuator, Stage, apply

# Turning points lie beyond the reach by up to this share of it, so that some displacements are clamped.
_BEYOND = 0.25
_BRANCHES, _JUMPS, _VOLTAGES = 14, 80, 80
_LEAST_BRANCH, _MOST_BRANCH = 25, 400
_COMMITS, _NONSENSE, _HELD, _OFFERED, _STEPS = 13, 29, 17, 11, 255
_HEADER = Template("""/* Calls and the results that Python computed with this model. */
#ifndef TRACE_H
#define TRACE_H

${macros}
typedef struct trace_row {
    int what;
    double $columns;
} trace_row;
$counts
static const trace_row trace[TRACE_SIZE] = {
$rows
};

#endif
""")


class Call(IntEnum):
    """A call of `piezo.h`, in the order of `check.c`; from COMMIT on, except NONSENSE, its result is a displacement."""

    STEP = 0
    OFFER = 1
    COMMIT = 2
    ACCEPT = 3
    HOLD = 4
    NONSENSE = 5
    SIMULATE = 6


class TraceRow(NamedTuple):
    """A call, its arguments [m or V], and its results for each axis: voltages [V], or the displacements [m] reached."""

    what: Call
    given: tuple[float, ...]
    answer: tuple[float, ...]


class GoldenTrace(NamedTuple):
    """A trace.

    `clamps`: number of clamped samples of each axis. `refused`: number of wanted displacements that are not a number.
    `volts`, `stroke`: references of errors: the largest width of the limits [V] and of the reach [m]. `coupled`:
    whether the trace belongs to a stage, whose calls have arrays.
    """

    rows: tuple[TraceRow, ...]
    clamps: tuple[Clamps, ...]
    refused: int
    volts: float
    stroke: float
    coupled: bool


def golden_trace(compensator: Compensator) -> GoldenTrace:
    """Play a trace on copies of a compensator, from its start; the compensator does not change.

    The trace has wanted displacements within and beyond the reach, slow and in jumps, and some that are not a number.
    With several axes, it clamps one, several and all of them. It also has offers that are dropped, committed, or
    committed with other voltages, and periods in which nothing is sent. At the end, voltages drive the actuators alone.
    """
    loop, body = compensator._clone("m"), compensator._clone("m")
    axes = loop._axes
    limits, reach = np.array([axis.limits for axis in axes]), np.array([axis.reach for axis in axes])
    slowest = 0.0
    for axis, (low, high) in zip(axes, limits.tolist(), strict=True):
        if axis.slew_rate is not None and axis.period is not None:
            slowest = max(slowest, 4 * (high - low) / (axis.slew_rate * axis.period))
    moved = reach[:, 0] + (reach[:, 1] - reach[:, 0]) * _shares(len(axes), slowest)
    path = moved if len(axes) == 1 else apply(loop.stage.coupling, moved)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClampWarning)
        rows = tuple(_played(loop, path, limits))
        (low, high), rng = limits.T, np.random.default_rng(21)
        half = _VOLTAGES // 2
        for voltage in np.vstack([np.linspace(low, high, half), rng.uniform(low, high, (half, len(limits)))]):
            body.commit(_given(body, voltage))
            rows += (TraceRow(Call.SIMULATE, tuple(voltage.tolist()), _place(body)),)
    refused = sum(row.what is Call.NONSENSE for row in rows)
    clamps, coupled = tuple(axis.clamps for axis in axes), isinstance(loop.model, Stage)
    volts, stroke = (float(np.ptp(table, axis=1).max()) for table in (limits, reach))
    return GoldenTrace(rows, clamps, refused, volts, stroke, coupled)


def trace_header(trace: GoldenTrace, least: float, most: float) -> str:
    """Return the text of `trace.h`; the error of floats must lie between two shares of the range."""
    form = "    {{{}, {{{}}}, {{{}}}}}" if trace.coupled else "    {{{}, {}, {}}}"
    # C has no literal for NaN: `check.c` passes a NaN in these calls.
    rows = [
        form.format(
            int(row.what),
            *(", ".join(v.hex() if math.isfinite(v) else "0" for v in some) for some in (row.given, row.answer)),
        )
        for row in trace.rows
    ]
    macros = {call.name: str(int(call)) for call in Call} | {"SIZE": str(len(rows))}
    limited, slewed = [[f"{count}UL" for count in counts] for counts in zip(*trace.clamps, strict=True)]
    columns, counts = "given, answer", ""
    if not trace.coupled:
        macros |= {
            "LIMITED": limited[0],
            "SLEWED": slewed[0],
            "REFUSED": f"{trace.refused}UL",
            "VOLTS": trace.volts.hex(),
            "STROKE": trace.stroke.hex(),
            "LEAST": repr(least),
            "MOST": repr(most),
        }
    else:
        size = f"[{len(limited)}]"
        columns = f"given{size}, answer{size}"
        counts = "".join(
            f"\nstatic const unsigned long trace_{name}{size} = {{{', '.join(values)}}};\n"
            for name, values in (("limited", limited), ("slewed", slewed))
        )
    defined = "".join(f"#define TRACE_{name} {value}\n" for name, value in macros.items())
    return _HEADER.substitute(macros=defined, columns=columns, counts=counts, rows=",\n".join(rows))


def _shares(axes: int, slowest: float) -> Array:
    """Return a path (n, axes) in shares of the reach: half cosines of `slowest` samples or more, then jumps."""
    rng = np.random.default_rng(20)
    branch = int(np.clip(slowest, _LEAST_BRANCH, _MOST_BRANCH))
    turns = rng.uniform(-_BEYOND, 1 + _BEYOND, (_BRANCHES, axes))
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, branch + 1) / branch)
    branches = [a + (b - a) * shape[:, None] for a, b in pairwise(turns)]
    return np.vstack([*branches, rng.uniform(-_BEYOND, 1 + _BEYOND, (_JUMPS, axes))])


def _played(loop: Compensator, path: Array, limits: Array) -> Iterator[TraceRow]:
    """Yield the rows of a path (n, axes) [m], with every kind of call mixed in."""
    low, high = limits.T
    nothing = (0.0,) * len(limits)
    for t, wanted in enumerate(path):
        given = tuple(wanted.tolist())
        if t % _OFFERED == 3:
            yield TraceRow(Call.OFFER, tuple(path[-1 - t].tolist()), _row(loop.offer(_given(loop, path[-1 - t]))))
        if t % _COMMITS in (5, 9):
            offered = np.atleast_1d(loop.offer(_given(loop, wanted)))
            yield TraceRow(Call.OFFER, given, _row(offered))
            if t % _COMMITS == 9:
                loop.commit(_given(loop, offered))
                yield TraceRow(Call.ACCEPT, nothing, _place(loop))
                continue
            # The voltage is rounded like in a converter with few bits, except on the first of several axes.
            sent = low + (high - low) * np.round(_STEPS * (offered - low) / (high - low)) / _STEPS
            if len(sent) > 1:
                sent[0] = offered[0]
            loop.commit(_given(loop, sent))
            yield TraceRow(Call.COMMIT, _row(sent), _place(loop))
        elif t % _HELD == 7:
            loop.hold()
            yield TraceRow(Call.HOLD, nothing, _place(loop))
        elif t % _NONSENSE == 11:
            with suppress(ModelError):
                loop.offer(_given(loop, np.full(len(limits), math.nan)))
            loop.hold()
            yield TraceRow(Call.NONSENSE, (math.nan,) * len(limits), _row(loop.voltage))
        else:
            yield TraceRow(Call.STEP, given, _row(loop.step(_given(loop, wanted))))


def _given(loop: Compensator, values: Array) -> Any:
    """Return values (axes,) in the form that a loop takes: a number for one axis."""
    return float(values[0]) if isinstance(loop.model, Actuator) else values


def _row(values: float | Array) -> tuple[float, ...]:
    return tuple(np.atleast_1d(values).tolist())


def _place(loop: Compensator) -> tuple[float, ...]:
    """Return the displacements of the body [m]; for one actuator, of its mass."""
    return _row(loop.displacement)
