"""The voltages of all axes of a stage for a path that is known ahead."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst.control import Command, Compensator
from dehyst.stages.decoupling import apply, dot, reachable
from dehyst.stages.stage import Stage
from dehyst.stages.stage_trace import StageTrace

# Passes over the path in which clamped axes correct the free ones.
_PASSES = 12
# Of the stroke: changes that are rounding.
_SETTLED = 1e-12


def follow(
    stage: Stage, compensators: Sequence[Compensator], wanted: Array, time: ArrayLike | None, extrapolate: bool
) -> StageTrace:
    """Return the clamped voltages of a path of `wanted` displacements (n, axes) [m], by the compensator of each axis.

    The targets of free axes are corrected by what clamped ones reach, until they settle. Raise `ModelError` as
    `Compensator.trajectory`, the axis named.
    """
    targets = apply(stage.decoupling, wanted)
    commands = _commands(stage, compensators, targets, time, extrapolate)
    clamped = np.column_stack([one.clamped for one in commands])
    settled = _SETTLED * max(float(np.ptp(wanted)), np.finfo(np.float64).tiny)
    for _ in range(_PASSES if clamped.any() and len(commands) > 1 else 0):
        reached = np.column_stack([one.displacement for one in commands])
        corrected = _corrected(stage, targets, wanted, reached, clamped)
        if np.abs(corrected - targets).max() <= settled:
            break
        changed = (corrected != targets).any(axis=0)
        targets = corrected
        commands = _commands(stage, compensators, targets, time, extrapolate, commands, changed.tolist())
        clamped |= np.column_stack([one.clamped for one in commands])
    return _trace(stage, wanted, commands)


def _commands(
    stage: Stage,
    compensators: Sequence[Compensator],
    targets: Array,
    time: ArrayLike | None,
    extrapolate: bool,
    before: Sequence[Command] = (),
    changed: Sequence[bool] = (),
) -> list[Command]:
    """Return the command of each axis for its targets; those `before` where nothing has changed."""
    commands = []
    for j, (axis, one) in enumerate(zip(stage.axes, compensators, strict=True)):
        if before and not changed[j]:
            commands.append(before[j])
            continue
        # After the first pass the targets are in the neighbourhood of those that were checked.
        try:
            commands.append(one.trajectory(targets[:, j], time=time, extrapolate=extrapolate or bool(before)))
        except ModelError as error:
            raise ModelError(f"axis {axis}: {error}") from error
    return commands


def _corrected(stage: Stage, targets: Array, wanted: Array, reached: Array, clamped: Mask) -> Array:
    """Return targets with which the axes that are free reach what is wanted of them."""
    corrected, table = targets.copy(), stage.decoupling.tolist()
    for i in np.flatnonzero(clamped.any(axis=1)).tolist():
        known = {j: float(reached[i, j]) for j in np.flatnonzero(clamped[i]).tolist()}
        moved = reachable(table, wanted[i].tolist(), known)
        for j, row in enumerate(table):
            if j not in known:
                corrected[i, j] = dot(row, moved)
    return corrected


def _trace(stage: Stage, wanted: Array, commands: Sequence[Command]) -> StageTrace:
    reached = apply(stage.coupling, np.column_stack([one.displacement for one in commands]))
    exact = np.column_stack([one.followed for one in commands]).all()
    warnings = [f"{axis}: {w}" for axis, one in zip(stage.axes, commands, strict=True) for w in one.warnings]
    return StageTrace(
        voltage=np.column_stack([one.voltage for one in commands]),
        displacement=wanted if exact else reached,
        states=tuple(one.state for one in commands),
        clamped=np.column_stack([one.clamped for one in commands]),
        missed=np.zeros(len(commands)) if exact else np.abs(wanted - reached).max(axis=0, initial=0.0),
        warnings=tuple(warnings),
        followed=bool(exact),
    )
