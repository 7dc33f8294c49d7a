"""What Python does with a compensator, call by call, as a trace that its export replays."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable
from contextlib import suppress
from enum import IntEnum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import ClampWarning, Compensator
from dehyst.control.clamping import Clamps

# Shares of the reach that turning points may lie beyond it: such wishes are clamped.
_BEYOND = 0.25
_LEGS, _JUMPS, _VOLTAGES = 14, 80, 80
_LEAST_LEG, _MOST_LEG = 25, 400
_COMMITS, _NONSENSE, _HELD, _OFFERED, _STEPS = 13, 29, 17, 11, 255


class Call(IntEnum):
    """A call of `piezo.h`, in the order of `check.c`; from COMMIT on but for NONSENSE a displacement is compared."""

    STEP = 0
    OFFER = 1
    COMMIT = 2
    ACCEPT = 3
    HOLD = 4
    NONSENSE = 5
    SIMULATE = 6


class TraceRow(NamedTuple):
    """A call, what it is given [m or V] and what it answers: a voltage [V], or where the actuator then is [m]."""

    what: Call
    given: float
    answer: float


class GoldenTrace(NamedTuple):
    """A trace.

    Attributes
    ----------
    rows : tuple of TraceRow
    clamps : Clamps
        Of the steps.
    refused : int
        Displacements that were no number.
    volts, stroke : float
        What errors are told of: the width of the limits [V] and of the reach [m].
    """

    rows: tuple[TraceRow, ...]
    clamps: Clamps
    refused: int
    volts: float
    stroke: float


def golden_trace(compensator: Compensator) -> GoldenTrace:
    """Play a trace on compensators like this one, at their start; this one stays as it is.

    Wishes within the reach and beyond it, slow and in jumps; offers that are not taken, taken, or sent as another
    voltage; periods in which nothing is sent; wishes that are no numbers. At last the actuator alone, under voltages.
    """
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
    """Text of `trace.h`; a float's error is to lie between two shares of the range."""
    # C has no NaN to write down; check.c makes one.
    rows = [f"    {{{int(row.what)}, {_hex(row.given)}, {_hex(row.answer)}}}" for row in trace.rows]
    return "\n".join(
        [
            "/* What Python did with this model. */",
            "#ifndef TRACE_H",
            "#define TRACE_H",
            "",
            *(f"#define TRACE_{call.name} {int(call)}" for call in Call),
            f"#define TRACE_SIZE {len(rows)}",
            f"#define TRACE_LIMITED {trace.clamps.limited}UL",
            f"#define TRACE_SLEWED {trace.clamps.slewed}UL",
            f"#define TRACE_REFUSED {trace.refused}UL",
            f"#define TRACE_VOLTS {trace.volts.hex()}",
            f"#define TRACE_STROKE {trace.stroke.hex()}",
            f"#define TRACE_LEAST {least!r}",
            f"#define TRACE_MOST {most!r}",
            "",
            "typedef struct trace_row {",
            "    int what;",
            "    double given, answer;",
            "} trace_row;",
            "",
            "static const trace_row trace[TRACE_SIZE] = {",
            ",\n".join(rows),
            "};",
            "",
            "#endif",
            "",
        ]
    )


def _hex(value: float) -> str:
    return value.hex() if math.isfinite(value) else "0"


def _path(compensator: Compensator) -> Array:
    """Wishes [m]: half cosines between turning points, slow enough for most slew rates, then jumps."""
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
    """The rows of a path, with every kind of call mixed in."""
    low, high = loop.limits
    for t, wish in enumerate(path.tolist()):
        if t % _OFFERED == 3:
            other = float(path[-1 - t])
            yield TraceRow(Call.OFFER, other, loop.offer(other))
        if t % _COMMITS in (5, 9):
            offered = loop.offer(wish)
            yield TraceRow(Call.OFFER, wish, offered)
            if t % _COMMITS == 9:
                loop.commit(offered)
                yield TraceRow(Call.ACCEPT, 0.0, _place(loop))
                continue
            # As a converter of few bits sends it.
            sent = low + (high - low) * round(_STEPS * (offered - low) / (high - low)) / _STEPS
            loop.commit(sent)
            yield TraceRow(Call.COMMIT, sent, _place(loop))
        elif t % _HELD == 7:
            loop.hold()
            yield TraceRow(Call.HOLD, 0.0, _place(loop))
        elif t % _NONSENSE == 11:
            yield TraceRow(Call.NONSENSE, math.nan, _refused(loop))
        else:
            yield TraceRow(Call.STEP, wish, loop.step(wish))


def _refused(loop: Compensator) -> float:
    """The voltage that acts on when a firmware, which must send something, is asked for no number."""
    with suppress(ModelError):
        loop.offer(math.nan)
    loop.hold()
    return loop.voltage


def _place(loop: Compensator) -> float:
    """Where its actuator is [m]."""
    state = loop.state
    return float(state.motion[0]) if state.motion.size else state.displacement
