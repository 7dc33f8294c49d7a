"""How far to trust a stage: the uncertainty of its coupling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.control import PathPlan
from dehyst.identification import Plays, refuse_still
from dehyst.model import Stage, by_axis, matrix_lines
from dehyst.records import Record
from dehyst.trust.assessment import Insight, insight
from dehyst.trust.recheck import refuse_other_axes

# Half the width of a 90 % interval, in standard errors.
_DEVIATIONS = 1.6448536269514722
# Of the range of a voltage in a hundredth of the record: it moves if it moves by more.
_MOVING, _WINDOWS = 0.02, 200
# An axis moved alone if it did so for this share of the record.
_ALONE = 0.03
# Periods repeat together after so few of the slowest one.
_MOST_TURNS, _SAME = 3, 0.01
# A coupling that is known to less than this may differ.
_CHANGED = 0.005


@dataclass(frozen=True, eq=False)
class StageInsight:
    """How far to trust a stage.

    Attributes
    ----------
    axes : tuple of str
    coupling, low, high : (axes, axes) array
        The coupling matrix of the stage, and the ends of the 90 % confidence interval of each entry.
    insights : tuple of Insight
        Assessment of each actuator.
    remarks : tuple of str
        Sentences on what the records leave open, and what to record next.
    """

    axes: tuple[str, ...]
    coupling: Array
    low: Array
    high: Array
    insights: tuple[Insight, ...]
    remarks: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the assessment of the coupling in lines."""
        half = (self.high - self.low) / 2
        head = "Coupling, with half the interval of each entry that the records allow (90 %):"
        return [head, *matrix_lines(self.axes, self.coupling, half), *(f"  - {remark}" for remark in self.remarks)]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "axes coupling lowest=low highest=high remarks"
        return json_values(self, keys) | {"insights": by_axis(self.axes, self.insights)}


def stage_insight(
    stage: Stage, records: Sequence[Record], plan: PathPlan | None = None, **options: Any
) -> StageInsight:
    """Assess a stage by the records it was identified from; `options`: of `insight`, for each actuator."""
    for record in records:
        refuse_other_axes(stage, record)
    refuse_still(records)
    _, uncertainty = Plays.of(records).coupling()
    half = _DEVIATIONS * uncertainty
    low, high = stage.coupling - half, stage.coupling + half
    insights = tuple(
        insight(one, [stage.alone(record, j) for record in records], plan=plan and plan.each[j], **options)
        for j, one in enumerate(stage.actuators)
    )
    unknown = [
        f"coupling of {stage.axes[j]} into {stage.axes[i]} is known to ±{half[i, j]:.2g} only"
        for i, j in np.argwhere(half > _CHANGED).tolist()
    ]
    remarks = (*_alone(records), *_repeating(records), *unknown)
    return StageInsight(stage.axes, stage.coupling, low, high, insights, remarks)


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
