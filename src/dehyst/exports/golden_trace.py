"""The golden trace: what Python computes with a compensator, call by call, for its export to replay."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from contextlib import suppress
from enum import IntEnum
from itertools import pairwise
from string import Template
from typing import NamedTuple

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import ClampWarning, Compensator
from dehyst.control.limits import Clamps

# How far turning points may lie beyond the reach, as a share of it: such displacements are clamped.
_BEYOND = 0.25
_LEGS, _JUMPS, _VOLTAGES = 14, 80, 80
_LEAST_LEG, _MOST_LEG = 25, 400
_HEADER = Template("""/* What Python computed with this model. */
#ifndef TRACE_H
#define TRACE_H

${macros}
typedef struct trace_row {
    int what;
    double given, answer;
} trace_row;

static const trace_row trace[TRACE_SIZE] = {
$rows
};

#endif
""")
_COMMITS, _NONSENSE, _HELD, _OFFERED, _STEPS = 13, 29, 17, 11, 255


class Call(IntEnum):
    """A call of `piezo.h`, in the order of `check.c`. From COMMIT on, except NONSENSE, displacements are compared."""

    STEP = 0
    OFFER = 1
    COMMIT = 2
    ACCEPT = 3
    HOLD = 4
    NONSENSE = 5
    SIMULATE = 6


class TraceRow(NamedTuple):
    """A call, its argument [m or V] and its result: a voltage [V], or the displacement [m] of the actuator after it."""

    what: Call
    given: float
    answer: float


class GoldenTrace(NamedTuple):
    """A trace.

    `clamps`: of the steps. `refused`: number of wanted displacements that are not a number. `volts`, `stroke`: ranges
    to which errors are referred: the width of the limits [V] and of the reach [m].
    """

    rows: tuple[TraceRow, ...]
    clamps: Clamps
    refused: int
    volts: float
    stroke: float


def golden_trace(compensator: Compensator) -> GoldenTrace:
    """Play a trace on compensators like this one, from their start; this one does not change.

    It has wanted displacements within the reach and beyond it, slow and in jumps, and some that are not a number;
    offers that are dropped, committed, or committed with another voltage; periods in which nothing is sent; and at the
    end voltages on the actuator alone.
    """
    compensator = compensator.afresh("m")
    low, high = compensator.limits
    bottom, top = compensator.reach
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClampWarning)
        loop = compensator.afresh()
        rows = tuple(_played(loop, _path(compensator)))
        actuator = compensator.afresh()
        for voltage in _voltages(low, high).tolist():
            actuator.commit(voltage)
            rows += (TraceRow(Call.SIMULATE, voltage, _place(actuator)),)
    refused = sum(row.what is Call.NONSENSE for row in rows)
    return GoldenTrace(rows, loop.clamps, refused, high - low, top - bottom)


def trace_header(trace: GoldenTrace, least: float, most: float) -> str:
    """Return the text of `trace.h`; the error of floats must lie between two shares of the range."""
    # C has no literal for NaN; check.c makes one.
    rows = [f"    {{{int(row.what)}, {_hex(row.given)}, {_hex(row.answer)}}}" for row in trace.rows]
    macros = {call.name: int(call) for call in Call} | {
        "SIZE": len(rows),
        "LIMITED": f"{trace.clamps.limited}UL",
        "SLEWED": f"{trace.clamps.slewed}UL",
        "REFUSED": f"{trace.refused}UL",
        "VOLTS": trace.volts.hex(),
        "STROKE": trace.stroke.hex(),
        "LEAST": repr(least),
        "MOST": repr(most),
    }
    defined = "".join(f"#define TRACE_{name} {value}\n" for name, value in macros.items())
    return _HEADER.substitute(macros=defined, rows=",\n".join(rows))


def _hex(value: float) -> str:
    return value.hex() if math.isfinite(value) else "0"


def _path(compensator: Compensator) -> Array:
    """Return wanted displacements [m]: half cosines, slow enough for most slew rates, then jumps."""
    rng = np.random.default_rng(20)
    bottom, top = compensator.reach
    low, high = compensator.limits
    slew, period = compensator.slew_rate, compensator.period
    needed = 0.0 if slew is None or period is None else 4 * (high - low) / (slew * period)
    leg = int(np.clip(needed, _LEAST_LEG, _MOST_LEG))
    turns = rng.uniform(-_BEYOND, 1 + _BEYOND, _LEGS)
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, leg + 1) / leg)
    legs = [a + (b - a) * shape for a, b in pairwise(turns)]
    share = np.concatenate([*legs, rng.uniform(-_BEYOND, 1 + _BEYOND, _JUMPS)])
    return np.asarray(bottom + (top - bottom) * share)


def _voltages(low: float, high: float) -> Array:
    rng = np.random.default_rng(21)
    ramp = np.linspace(low, high, _VOLTAGES // 2)
    return np.concatenate([ramp, rng.uniform(low, high, _VOLTAGES // 2)])


def _played(loop: Compensator, path: Array) -> Iterable[TraceRow]:
    """Yield the rows of a path, with every kind of call mixed in."""
    low, high = loop.limits
    for t, wanted in enumerate(path.tolist()):
        if t % _OFFERED == 3:
            other = float(path[-1 - t])
            yield TraceRow(Call.OFFER, other, loop.offer(other))
        if t % _COMMITS in (5, 9):
            offered = loop.offer(wanted)
            yield TraceRow(Call.OFFER, wanted, offered)
            if t % _COMMITS == 9:
                loop.commit(offered)
                yield TraceRow(Call.ACCEPT, 0.0, _place(loop))
                continue
            # As a converter with few bits sends it.
            sent = low + (high - low) * round(_STEPS * (offered - low) / (high - low)) / _STEPS
            loop.commit(sent)
            yield TraceRow(Call.COMMIT, sent, _place(loop))
        elif t % _HELD == 7:
            loop.hold()
            yield TraceRow(Call.HOLD, 0.0, _place(loop))
        elif t % _NONSENSE == 11:
            yield TraceRow(Call.NONSENSE, math.nan, _refused(loop))
        else:
            yield TraceRow(Call.STEP, wanted, loop.step(wanted))


def _refused(loop: Compensator) -> float:
    """Return the voltage that acts on when the wanted displacement is not a number."""
    with suppress(ModelError):
        loop.offer(math.nan)
    loop.hold()
    return loop.voltage


def _place(loop: Compensator) -> float:
    """Return the displacement of the actuator [m]."""
    state = loop.state
    return float(state.motion[0]) if state.motion.size else state.displacement
