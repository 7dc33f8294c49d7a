"""A homing of all axes before a path: whatever the stage did before, its state is known then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.control import HomedPath, StartError, home_before
from dehyst.stages.compensator import StageCompensator
from dehyst.stages.decoupling import apply
from dehyst.stages.stage_trace import StageTrace


@dataclass(frozen=True, eq=False)
class HomedStage:
    """Voltages that home all axes side by side and lead to a path, and the path.

    Attributes
    ----------
    time : (k + n,) array or None
        [s] from the first sample of the homing; None if the path has no time. Between rows the voltages are linear.
    voltage : (k, axes) array
        Of the homing and the way to the path [V].
    expected : (k, axes) array
        Displacements of the model meanwhile [m].
    path : StageTrace
        The path, n samples.
    warnings : tuple of str
        Remarks on the homing of an axis, and on what was clamped.
    errors : tuple of StartError
        What the unknown start of each actuator leaves open along its path.
    certified : bool
        Whether the state of every actuator is known, as `HomedPath.certified`.
    """

    time: Array | None
    voltage: Array
    expected: Array
    path: StageTrace
    warnings: tuple[str, ...]
    errors: tuple[StartError, ...]
    certified: bool


def home_stage_before(
    compensator: StageCompensator, displacement: ArrayLike, *, time: ArrayLike | None = None
) -> HomedStage:
    """Compute the voltages of a path of all axes, with the shortest homing of each before it.

    Parameters
    ----------
    compensator : StageCompensator
        Its stage, limits and slew rates; its states do not count.
    displacement : (n, axes) array_like
        Wanted displacements [m].
    time : (n,) array_like, optional
        [s].

    Raises
    ------
    ModelError, RecordError
        As `home_before` and `StageCompensator.trajectory`.
    """
    stage = compensator.stage
    wanted = stage.columns(displacement, "displacement", "m")
    targets = apply(stage.decoupling, wanted)
    homed = [home_before(one, targets[:, j], time=time) for j, one in enumerate(compensator.compensators)]
    before = [_before(one) for one in homed]
    # All paths begin at one time: an axis with a shorter homing waits. No row of any axis is left out.
    ahead = np.unique(np.concatenate([own for own, _ in before]))
    voltage = np.column_stack([np.interp(ahead, own, values) for own, values in before])
    moved = stage.simulate(voltage, time=None if time is None else ahead - ahead[0], extrapolate=True)
    follower = StageCompensator(
        stage,
        period=compensator.period,
        limits=compensator.limits,
        slew_rate=compensator.slew_rate,
        states=moved.states,
    )
    path = follower.trajectory(wanted, time=time)
    when = None
    if time is not None:
        given = np.asarray(time, dtype=np.float64)
        when = np.concatenate([ahead - ahead[0], given - given[0] - ahead[0]])
    # What a homing leaves open is told where this path depends on it.
    left = {axis: () if one.certified else one.homing.remarks for axis, one in zip(stage.axes, homed, strict=True)}
    remarks = [f"{axis}: {words}" for axis, words_of in left.items() for words in words_of]
    return HomedStage(
        when,
        voltage,
        moved.displacement,
        path,
        (*remarks, *path.warnings),
        tuple(one.error for one in homed),
        all(one.certified for one in homed),
    )


def _before(one: HomedPath) -> tuple[Array, Array]:
    """Return times and voltages of the rows before the path; times [s], or rows, up to its first sample."""
    time = np.arange(one.voltage.size, dtype=np.float64) if one.time is None else one.time
    return time[: one.first] - time[one.first], one.voltage[: one.first]
