"""Clamped axes of a stage: the targets with which the other axes still reach their displacements."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence

from dehyst._types import Array
from dehyst.model import dot, reachable


def targets_and_clamped(
    table: Sequence[Sequence[float]], wanted: Sequence[float], offer: Callable[[int, float], float | None]
) -> tuple[list[float], dict[int, float]]:
    """Return the targets (axes,) [m] of the actuators, and the displacements [m] of those that are clamped, by axis.

    The free axes reach what is `wanted` (axes,) [m] of them, and no clamped axis moves past it. With a coupling whose
    principal minors are positive there is one such result. The search fixes and releases axes all at once; as this
    may repeat for a coupling of about 1, it releases none after twice as many passes as there are axes.

    `table`: (axes, axes), the inverse coupling. `offer` takes an axis and its target; it returns None, or if the axis
    is clamped, the displacement [m] that its actuator reaches.
    """
    count, moved, known = len(wanted), wanted, dict[int, float]()
    targets, beyond = [0.0] * count, [0.0] * count
    for passed in itertools.count():
        released = to_release(known, beyond, wanted, moved) if passed < 2 * count else []
        fresh = dict[int, float]()
        for j in range(count):
            if j in known:
                continue
            targets[j] = dot(table[j], moved)
            reached = offer(j, targets[j])
            if reached is not None:
                fresh[j], beyond[j] = reached, targets[j] - reached
        if not fresh and not released:
            break
        known = {j: w for j, w in known.items() if j not in released} | fresh
        moved = reachable(table, wanted, known)
    return targets, known


def to_release(
    known: Iterable[int], beyond: Sequence[float] | Array, wanted: Sequence[float], moved: Sequence[float]
) -> list[int]:
    """Return which of the clamped axes in `known` move past what is wanted of them: they need not be clamped.

    `beyond` (axes,): by how much the target of a clamped actuator lay beyond what it reaches [m]. `wanted`, `moved`
    (axes,): displacements [m].
    """
    return [j for j in known if beyond[j] * (wanted[j] - moved[j]) < 0]
