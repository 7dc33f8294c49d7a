"""Ageing of a fleet: the cost (error) of keeping the oldest model of a serial at its later sessions."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst._views.fields import json_values
from dehyst.fleet.table import Fleet
from dehyst.model import Actuator
from dehyst.trust import DECISION, ControlChart

# A goal [% of the stroke] by default, and the part of it that is the least standard deviation of the charts.
GOAL, _LEAST = 1.0, 0.1
_SHOWN = 30
# Samples of a rise or a fall of the path that models are played on.
_SAMPLES = 200
# Parts of the voltages' range at which the width of the loop is taken, and tops of the falling loops of the path.
PLACES, _TOPS = (0.25, 0.5, 0.75), (1.0, 1.0, 0.75, 0.5, 0.25)
_NUMBER = re.compile(r"[+-]?[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]{1,3})?")
_DIGITS = re.compile(r"([0-9]+)")


@dataclass(frozen=True, eq=False)
class Ageing:
    """One actuator, its `serial`, over its `sessions` with a model, the oldest first.

    `costs` (n - 1,): largest difference [% of the stroke] between the oldest model and each later one, on the same
    path. `signed` (n - 1,): change of the stroke on this path [%]. `chart`: averages (EWMA) and cumulative sums (CUSUM)
    of the costs in excess of what is usual in the fleet.

    `goal` [% of the stroke]. `usual`: largest usual cost in the fleet [% of the stroke], three deviations above the
    median. `own`: sum of the expected errors of the oldest and the last model [% of the stroke], by which two models of
    one actuator may differ.
    """

    serial: Any
    sessions: tuple[Any, ...]
    costs: Array
    signed: Array
    chart: ControlChart
    goal: float
    usual: float
    own: float

    @property
    def alarms(self) -> Mask:
        """Whether average or sum of the costs is above its limit, at each later session (n - 1,), except low costs."""
        return np.asarray((self.chart.average > self.chart.limits) | (self.chart.above > DECISION))

    @property
    def outside(self) -> bool:
        """Whether the last session has an alarm, and its cost exceeds the usual one and the models' own errors.

        A single bad record in the past is not ageing.
        """
        return bool(self.alarms[-1]) and float(self.costs[-1]) > max(self.usual, self.own)

    @property
    def recalibrate(self) -> bool:
        """Whether the last cost is above the goal, or the costs are outside of their limits."""
        return float(self.costs[-1]) > self.goal or self.outside

    @property
    def words(self) -> str:
        """The finding as a sentence."""
        inside = np.flatnonzero(~self.alarms)
        since = self.sessions[2 + int(inside[-1]) if inside.size else 1] if self.outside else None
        chart = f"; out of its limits since {since}" if self.outside else ""
        return (
            f"{self.serial}: keeping the model of {self.sessions[0]} costs {self.costs[-1]:.2g} % of the stroke at "
            f"{self.sessions[-1]}, stroke {self.signed[-1]:+.2g} %{chart}"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        changes = "cost_percent=costs stroke_change_percent=signed"
        charts = "ewma=chart.average limit=chart.limits cusum=chart.above"
        return json_values(self, f"serial sessions {changes} {charts} own_errors_percent=own outside recalibrate")


@dataclass(frozen=True, eq=False)
class Drifts:
    """All serials with two sessions or more.

    `ageing`: one entry for each serial. `goal`, `usual` [% of the stroke]: allowed cost, and median of the first costs.
    `measured`, `spread` [% of the stroke]: robust deviation of the first costs, and deviation for the charts, at least
    a tenth of the goal. `over`: key of the sessions; `order`: how they are sorted; `ends`: the oldest and the newest.
    `remarks`: sentences about models that are left out.
    """

    ageing: tuple[Ageing, ...]
    goal: float
    usual: float
    measured: float
    spread: float
    over: str
    order: str
    ends: tuple[Any, Any]
    remarks: tuple[str, ...]

    @property
    def recalibrate(self) -> tuple[Ageing, ...]:
        """Serials to recalibrate, the largest cost first."""
        return tuple(sorted((one for one in self.ageing if one.recalibrate), key=lambda one: -one.costs[-1]))

    def lines(self) -> list[str]:
        """Return a text to read."""
        due, origin = self.recalibrate, "that of the fleet"
        if self.spread > self.measured:
            origin = f"a tenth of the goal; that of the fleet is {self.measured:.2g} %"
        more = [f"  and {len(due) - _SHOWN} more, see --json"] if len(due) > _SHOWN else []
        return [
            f"{counted(len(self.ageing), 'serial')} with two sessions or more: keeping the oldest model usually costs "
            f"{self.usual:.2g} % of the stroke",
            f"order of {self.over}: {self.order}; oldest {self.ends[0]}, newest {self.ends[1]}",
            f"limits: from a deviation of {self.spread:.2g} % ({origin})",
            f"to recalibrate: {len(due)} (above the goal of {self.goal:g} %, or out of limits)",
            *(f"  {one.words}" for one in due[:_SHOWN]),
            *more,
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        percents = "goal_percent=goal usual_percent=usual measured_spread_percent=measured spread_percent=spread"
        return {
            **json_values(self, f"{percents} over order warnings=remarks serials=ageing"),
            **dict(zip(("oldest", "newest"), self.ends, strict=True)),
            "recalibrate": [one.serial for one in self.recalibrate],
        }


def drifts_of(fleet: Fleet, *, by: str, over: str, goal: float = GOAL) -> Drifts:
    """Compare the models of each serial of a `fleet` over its sessions.

    `by`, `over`: columns that identify an actuator, and that order its sessions: numbers by value, text in natural
    order. If several models have the same two values, the last one in the table counts. `goal`: cost [% of the stroke]
    above which a serial needs recalibration.

    Raise `FileFormatError` if the table has no rows or no such columns, or no serial has two sessions with a model;
    `IdentifyError` if `by` and `over` are the same, or the goal is no finite number above 0.
    """
    if not (isfinite(goal) and goal > 0):
        raise IdentifyError(argument="goal", got=f"{goal:g} %", need=f"a finite number above 0, as {GOAL:g}")
    if by == over:
        raise IdentifyError(
            f"got '{over}', as by", argument="over", hint=f"need another key, that of the sessions of one '{by}'"
        )
    if not fleet.rows:
        raise FileFormatError(f"{fleet.path}: holds no rows; identify a dataset with records first")
    if missing := [name for name in (by, over) if name not in fleet.rows[0]]:
        raise FileFormatError(f"{fleet.path}: has no column '{missing[0]}'; its keys are {', '.join(fleet.by)}")
    pairs = Counter((row[by], row[over]) for row in fleet.rows if row["outcome"] == "identified")
    sessions = [session for _, session in pairs]
    order, key = natural_order(sessions)
    found = list(_compared(fleet, by, over, key))
    remarks = _repeated(by, over, pairs)
    if not found:
        words = "; ".join(("nothing to compare", *remarks))
        raise FileFormatError(f"{fleet.path}: no '{by}' has two values of '{over}' with a model; {words}")
    # What noise and repeatability cost: the first comparison of each serial, most of which have not aged.
    first = np.array([costs[0] for _, _, costs, _, _ in found])
    usual = float(np.median(first))
    measured = 1.4826 * float(np.median(np.abs(first - usual)))
    spread = max(measured, _LEAST * goal)
    ageing = tuple(
        Ageing(serial, dates, costs, signed, chart_of(costs, usual, spread), goal, usual + 3 * spread, own)
        for serial, dates, costs, signed, own in found
    )
    ends = min(sessions, key=key), max(sessions, key=key)
    return Drifts(ageing, goal, usual, measured, spread, over, order, ends, remarks)


def natural_order(values: Iterable[Any]) -> tuple[str, Callable[[Any], Any]]:
    """Return the name of the order of a key's values, and its sort key.

    The order is numeric if all values are numbers, else natural: 2 is before 10, 2026-02 before 2026-10.
    """
    if all(_NUMBER.fullmatch(str(value)) for value in values):
        return "numbers by value", lambda value: Decimal(str(value))
    # Text and digits alternate, so that only like is compared with like.
    return "text, the numbers in it by value", lambda value: [
        int(piece) if k % 2 else piece for k, piece in enumerate(_DIGITS.split(str(value)))
    ]


def chart_of(costs: Array, usual: float, spread: float) -> ControlChart:
    """Return the control chart of costs (n,) [% of the stroke], in deviations `spread` above the usual cost."""
    return ControlChart.of("cost", np.arange(float(costs.size)), costs, (costs - usual) / spread)


def _repeated(by: str, over: str, pairs: Counter[tuple[Any, Any]]) -> tuple[str, ...]:
    """Return a sentence if models share actuator and session."""
    repeated = {pair: count for pair, count in pairs.items() if count > 1}
    if not repeated:
        return ()
    (serial, session), count = next(iter(repeated.items()))
    return (
        f"{sum(repeated.values())} models share {by} and {over} with another, as {serial}/{session} ({count} models); "
        "of each such session the last one of the table is taken",
    )


class _Model(NamedTuple):
    """A model of one session: duration of a cycle of its record [s], and its largest error [% of the stroke].

    The error is the larger one of the error on its record and the expected error on other paths.
    """

    actuator: Actuator
    seconds: float
    error: float


def _compared(
    fleet: Fleet, by: str, over: str, key: Callable[[Any], Any]
) -> Iterator[tuple[Any, tuple[Any, ...], Array, Array, float]]:
    """Yield serial, sessions, costs, changes of the stroke [%] and own errors of each serial with two sessions.

    Models are compared at the rate of the oldest record; at another rate, creep that no record shows would count.
    """
    counts = Counter(row[by] for row in fleet.rows if row["outcome"] == "identified")
    groups: dict[Any, dict[Any, _Model]] = defaultdict(dict)
    for row, actuator in fleet.models():
        serial = row[by]
        error = max(row["largest_percent"], row["expected_percent"] or 0.0)
        groups[serial][row[over]] = _Model(actuator, row["cycle_s"], error)
        counts[serial] -= 1
        # The models of a serial are dropped once it is complete.
        if not counts[serial] and len(group := groups.pop(serial)) > 1:
            sessions = tuple(sorted(group, key=key))
            models = [group[session] for session in sessions]
            changes = np.array([_change(models[0], later) for later in models[1:]])
            yield serial, sessions, changes[:, 0], changes[:, 1], models[0].error + models[-1].error


def _change(oldest: _Model, later: _Model) -> tuple[float, float]:
    """Return the cost of keeping the oldest model [% of the stroke], and the change of the stroke [%]."""
    (a, b), (c, d) = oldest.actuator.voltage_range, later.actuator.voltage_range
    kept, now = (played(one.actuator, (max(a, c), min(b, d)), oldest.seconds) for one in (oldest, later))
    stroke = float(np.ptp(now))
    # The zero of the sensor is no part of the cost.
    return 100 * float(np.ptp(now - kept)) / 2 / stroke, 100 * (stroke - float(np.ptp(kept))) / stroke


def played(actuator: Actuator, limits: tuple[float, float], seconds: float) -> Array:
    """Return the displacement [m] along `path` after one cycle through the limits, 0 at the path's first sample.

    A cycle of a model that depends on time takes `seconds` [s].
    """
    voltage = path(limits)
    time = seconds / (2 * _SAMPLES) * np.arange(voltage.size) if actuator.needs_time else None
    start = actuator.turned(float(actuator.spring.displacement[0]), rising=False, extrapolate=True)
    y = actuator.simulate(voltage, time=time, state=start, extrapolate=True).displacement[2 * _SAMPLES :]
    return np.asarray(y - y[0])


def path(limits: tuple[float, float]) -> Array:
    """Return cycles from the lower limit [V]: two through both limits, then three smaller ones."""
    low, high = limits
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, _SAMPLES + 1) / _SAMPLES)
    parts = [np.zeros(1), *(part for top in _TOPS for part in (top * rise, top * (1 - rise)))]
    return np.asarray(low + (high - low) * np.concatenate(parts))


def widths(actuator: Actuator, limits: tuple[float, float], seconds: float) -> list[float]:
    """Return falling minus rising displacement [m] on the major loop at the voltages `PLACES`."""
    y, v = played(actuator, limits, seconds)[: 2 * _SAMPLES + 1], path(limits)[: 2 * _SAMPLES + 1]
    rising, falling = slice(0, _SAMPLES + 1), slice(2 * _SAMPLES, _SAMPLES - 1, -1)
    at = limits[0] + (limits[1] - limits[0]) * np.array(PLACES)
    return list((np.interp(at, v[falling], y[falling]) - np.interp(at, v[rising], y[rising])).tolist())
