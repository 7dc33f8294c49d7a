"""The golden trace of a stage: what Python computes with its compensator, call by call, for its export to replay."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from enum import IntEnum
from itertools import pairwise
from string import Template
from typing import NamedTuple

import numpy as np

from dehyst._types import Array
from dehyst.control import ClampWarning
from dehyst.control.limits import Clamps
from dehyst.stages.compensator import StageCompensator
from dehyst.stages.stage import apply

# How far turning points may lie beyond the reach of each actuator, as a share of it: such displacements are clamped.
_BEYOND = 0.2
_LEGS, _LEG, _JUMPS, _VOLTAGES = 12, 45, 80, 60
# After how many rows a call of another kind comes.
_COMMITS, _NONSENSE, _HELD, _OFFERED, _STEPS = 13, 29, 17, 11, 255
_HEADER = Template("""/* What Python computed with this stage. */
#ifndef TRACE_H
#define TRACE_H

${macros}
typedef struct trace_row {
    int what;
    double given[$axes], answer[$axes];
} trace_row;

static const unsigned long trace_limited[$axes] = {$limited}, trace_slewed[$axes] = {$slewed};

static const trace_row trace[TRACE_SIZE] = {
$rows
};

#endif
""")


class StageCall(IntEnum):
    """A call of stage.h, in the order of `check.c`."""

    STEP = 0
    OFFER = 1
    COMMIT = 2
    HOLD = 3
    NONSENSE = 4
    SIMULATE = 5


class StageTraceRow(NamedTuple):
    """A call, its arguments [m or V] and its results: voltages [V], or displacements [m] after it; one an axis."""

    what: StageCall
    given: tuple[float, ...]
    answer: tuple[float, ...]


class StageGoldenTrace(NamedTuple):
    """A trace: its rows, and the counts of the steps of each axis."""

    rows: tuple[StageTraceRow, ...]
    clamps: tuple[Clamps, ...]


def stage_golden_trace(compensator: StageCompensator) -> StageGoldenTrace:
    """Play a trace on compensators like this one, from their start; this one does not change.

    Wanted displacements lie within the reach and beyond it, so that one axis, several and all are clamped, slow and in
    jumps, and some are no numbers; offers are dropped or committed with other voltages; at the end the body alone.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClampWarning)
        loop = compensator.afresh()
        rows = list(_played(loop, _path(loop)))
        body = compensator.afresh()
        for row in _voltages(body):
            body.commit(row)
            rows.append(StageTraceRow(StageCall.SIMULATE, tuple(row.tolist()), _place(body)))
    return StageGoldenTrace(tuple(rows), loop.clamps)


def stage_trace_header(trace: StageGoldenTrace) -> str:
    """Return the text of `trace.h`."""
    macros = {call.name: int(call) for call in StageCall} | {"SIZE": len(trace.rows)}
    rows = [f"    {{{int(row.what)}, {_braced(row.given)}, {_braced(row.answer)}}}" for row in trace.rows]
    return _HEADER.substitute(
        macros="".join(f"#define TRACE_{name} {value}\n" for name, value in macros.items()),
        axes=len(trace.clamps),
        limited=", ".join(f"{one.limited}UL" for one in trace.clamps),
        slewed=", ".join(f"{one.slewed}UL" for one in trace.clamps),
        rows=",\n".join(rows),
    )


def _braced(values: Sequence[float]) -> str:
    # C has no literal for NaN; check.c makes one.
    return "{" + ", ".join(value.hex() if math.isfinite(value) else "0" for value in values) + "}"


def _path(loop: StageCompensator) -> Array:
    """Return wanted displacements (n, axes) [m]: half cosines, then jumps; the axes beyond their reach at times."""
    rng, count = np.random.default_rng(18), len(loop.compensators)
    shape = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _LEG + 1) / _LEG)
    turns = rng.uniform(-_BEYOND, 1 + _BEYOND, (_LEGS, count))
    legs = [a + (b - a) * shape[:, None] for a, b in pairwise(turns)]
    share = np.vstack([*legs, rng.uniform(-_BEYOND, 1 + _BEYOND, (_JUMPS, count))])
    reach = np.array([one.reach for one in loop.compensators])
    return np.asarray(apply(loop.stage.coupling, reach[:, 0] + (reach[:, 1] - reach[:, 0]) * share))


def _voltages(loop: StageCompensator) -> Array:
    rng, limits = np.random.default_rng(19), np.array(loop.limits)
    return np.asarray(rng.uniform(limits[:, 0], limits[:, 1], (_VOLTAGES, len(limits))))


def _played(loop: StageCompensator, path: Array) -> Iterator[StageTraceRow]:
    """Yield the rows of a path, with every kind of call mixed in."""
    low, high = np.array(loop.limits).T
    for t, wanted in enumerate(path):
        given = tuple(wanted.tolist())
        if t % _OFFERED == 3:
            other = path[-1 - t]
            yield StageTraceRow(StageCall.OFFER, tuple(other.tolist()), tuple(loop.offer(other).tolist()))
        if t % _COMMITS == 5:
            offered = loop.offer(wanted)
            yield StageTraceRow(StageCall.OFFER, given, tuple(offered.tolist()))
            # As converters with few bits send it, but for the first axis.
            sent = low + (high - low) * np.round(_STEPS * (offered - low) / (high - low)) / _STEPS
            sent[0] = offered[0]
            loop.commit(sent)
            yield StageTraceRow(StageCall.COMMIT, tuple(sent.tolist()), _place(loop))
        elif t % _HELD == 7:
            loop.hold()
            yield StageTraceRow(StageCall.HOLD, given, _place(loop))
        elif t % _NONSENSE == 11:
            loop.hold()
            yield StageTraceRow(StageCall.NONSENSE, given, tuple(loop.voltage.tolist()))
        else:
            yield StageTraceRow(StageCall.STEP, given, tuple(loop.step(wanted).tolist()))


def _place(loop: StageCompensator) -> tuple[float, ...]:
    return tuple(loop.displacement.tolist())
