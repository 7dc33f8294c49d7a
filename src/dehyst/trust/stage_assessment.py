"""How far to trust a stage: the uncertainty of its coupling, and whether a new record agrees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.identification import BARELY, INSEPARABLE, PlayColumns, coupling_by_plays, refuse_still, separate_motion
from dehyst.model import Stage, by_axis, matrix_lines
from dehyst.records import Record
from dehyst.trust.assessment import insight
from dehyst.trust.insight_result import Insight
from dehyst.trust.recheck import Recheck, check

# Half the width of a 90 % interval, in standard errors.
_DEVIATIONS = 1.6448536269514722
# Of the range of a voltage in a hundredth of the record: it moves if it moves by more.
_MOVING, _WINDOWS = 0.02, 200
# An axis moved alone if it did so for this share of the record.
_ALONE = 0.03
# Periods repeat together after so few of the slowest one.
_MOST_TURNS, _SAME = 3, 0.01
# A coupling that differs by more than this, and by so many standard errors, has changed.
_CHANGED, _ERRORS = 0.005, 3.0


@dataclass(frozen=True, eq=False)
class StageInsight:
    """How far to trust a stage.

    Attributes
    ----------
    axes : tuple of str
    coupling, low, high : (axes, axes) array
        The coupling matrix of the stage, and the ends of the 90 % confidence interval of each entry.
    own_motion : (axes,) array
        Share of each voltage's motion that no other voltage explains, 0 to 1.
    insights : tuple of Insight
        Assessment of each actuator.
    remarks : tuple of str
        Sentences on what the records leave open, and what to record next.
    """

    axes: tuple[str, ...]
    coupling: Array
    low: Array
    high: Array
    own_motion: Array
    insights: tuple[Insight, ...]
    remarks: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the assessment of the coupling in lines."""
        half = (self.high - self.low) / 2
        head = "Coupling, with half the interval of each entry that the records allow (90 %):"
        return [head, *matrix_lines(self.axes, self.coupling, half), *(f"  - {remark}" for remark in self.remarks)]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "axes coupling lowest=low highest=high own_motion remarks"
        return json_values(self, keys) | {"insights": by_axis(self.axes, self.insights)}


def stage_insight(stage: Stage, records: Sequence[Record], **options: Any) -> StageInsight:
    """Assess a stage by the records it was identified from.

    Parameters
    ----------
    stage : Stage
    records : sequence of Record
    **options
        Options of `dehyst.insight`, for each actuator.
    """
    _refuse_other_axes(stage, records)
    columns = PlayColumns.of(records)
    found, own = coupling_by_plays(columns), separate_motion(columns)
    half = _DEVIATIONS * found.uncertainty
    # The models follow the records closer than plays do: the interval is laid around their matrix.
    low, high = stage.coupling - half, stage.coupling + half
    insights = tuple(
        insight(one, [stage.alone(record, j) for record in records], **options) for j, one in enumerate(stage.actuators)
    )
    remarks = [*_alone(records), *_repeating(records), *_unknown(stage, half, own)]
    return StageInsight(stage.axes, stage.coupling, low, high, own, insights, tuple(remarks))


@dataclass(frozen=True, eq=False)
class StageRecheck:
    """Whether a stage is still true: a `Recheck` of each axis, and changes of the coupling.

    Attributes
    ----------
    axes : tuple of str
    rechecks : tuple of Recheck
        Check of each actuator.
    coupling, uncertainty : (axes, axes) array
        The coupling matrix estimated from the new record, and its standard errors.
    changes : tuple of str
        Sentences on entries of the coupling matrix that have changed.
    """

    axes: tuple[str, ...]
    rechecks: tuple[Recheck, ...]
    coupling: Array
    uncertainty: Array
    changes: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the model of each actuator and the coupling are still true."""
        return all(one.good for one in self.rechecks) and not self.changes

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "good coupling uncertainty changes") | {"axes": by_axis(self.axes, self.rechecks)}


def check_stage(stage: Stage, record: Record, *, goal: float | None = None) -> StageRecheck:
    """Check each actuator and the coupling of a stage against a new record.

    The coupling is estimated from the new record with play operators. An entry counts as changed if it differs by more
    than 0.005 and by more than three standard errors.

    Parameters
    ----------
    stage : Stage
    record : Record
    goal : float, optional
        As in `dehyst.check`.
    """
    _refuse_other_axes(stage, [record])
    refuse_still([record])
    rechecks = tuple(check(one, stage.alone(record, j), goal=goal) for j, one in enumerate(stage.actuators))
    columns, changes = PlayColumns.of([record]), list[str]()
    if separate_motion(columns).min() < INSEPARABLE:
        return StageRecheck(stage.axes, rechecks, stage.coupling, np.full_like(stage.coupling, np.inf), ())
    found = coupling_by_plays(columns)
    away = found.matrix - stage.coupling
    for i, j in np.argwhere((np.abs(away) > _CHANGED) & (np.abs(away) > _ERRORS * found.uncertainty)).tolist():
        changes.append(
            f"coupling of {stage.axes[j]} into {stage.axes[i]}: {found.matrix[i, j]:+.4f} now, "
            f"{stage.coupling[i, j]:+.4f} in the model; identify the stage again"
        )
    return StageRecheck(stage.axes, rechecks, found.matrix, found.uncertainty, tuple(changes))


def _refuse_other_axes(stage: Stage, records: Sequence[Record]) -> None:
    for one in records:
        if one.axes != stage.axes:
            raise RecordError(
                f"record '{one.name}': has the axes {', '.join(one.axes)}, the stage has {', '.join(stage.axes)}"
            )


def _alone(records: Sequence[Record]) -> list[str]:
    """Return which axes never moved while all others stood still."""
    alone, count = np.zeros(len(records[0].axes)), 0
    for record in records:
        moving = np.array(
            [
                np.ptp(part, axis=0) > _MOVING * np.ptp(record.voltage, axis=0)
                for part in np.array_split(record.voltage, min(_WINDOWS, len(record) // 2))
            ]
        )
        alone += (moving & (moving.sum(axis=1) == 1)[:, None]).sum(axis=0)
        count += len(moving)
    return [
        f"axis {axis} never moved alone: only the motions of the others distinguish its own error from its coupling; "
        "dehyst excite stage moves each axis alone first"
        for axis, windows in zip(records[0].axes, alone, strict=True)
        if windows < _ALONE * count
    ]


def _repeating(records: Sequence[Record]) -> list[str]:
    """Return the axes whose common period is only a few of their own periods."""
    remarks = []
    for record in records:
        periods = [_period(record.voltage[:, j]) for j in range(len(record.axes))]
        for i in range(len(periods)):
            for j in range(i):
                ratio = max(periods[i], periods[j]) / max(min(periods[i], periods[j]), 1e-9)
                turns = [q for q in range(1, _MOST_TURNS + 1) if abs(q * ratio - round(q * ratio)) < _SAME * q * ratio]
                if turns and _together(record, i, j):
                    remarks.append(
                        f"record '{record.name}': axes {record.axes[j]} and {record.axes[i]} repeat together after "
                        f"{turns[0]} periods of the slower axis; choose periods whose ratio is not a simple fraction"
                    )
    return remarks


def _period(voltage: Array) -> float:
    """Return the strongest period in samples."""
    power = np.abs(np.fft.rfft((voltage - voltage.mean()) * np.hanning(len(voltage)))) ** 2
    return len(voltage) / max(int(np.argmax(power[1:])) + 1, 1)


def _together(record: Record, i: int, j: int) -> bool:
    """Return whether two axes move simultaneously during most of their motion."""
    moving = np.abs(np.diff(record.voltage[:, [i, j]], axis=0)) > 1e-6 * np.ptp(record.voltage[:, [i, j]], axis=0)
    return float(moving.all(axis=1).sum()) > 0.8 * float(moving.any(axis=1).sum())


def _unknown(stage: Stage, half: Array, own: Array) -> list[str]:
    remarks = [
        f"coupling of {stage.axes[j]} into {stage.axes[i]} is known to ±{half[i, j]:.2g} only"
        for i, j in np.argwhere(half > _CHANGED).tolist()
    ]
    return remarks + [
        f"axis {axis}: only {100 * share:.2g} % of the motion of its voltage is independent of the other voltages; "
        "record this axis alone"
        for axis, share in zip(stage.axes, own, strict=True)
        if share < BARELY
    ]
