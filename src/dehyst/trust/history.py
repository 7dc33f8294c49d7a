"""Checks of one model over time, one JSON file each in a folder, and their control charts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._io import PathLike, demand_own_folder, demand_version, format_of, make_own_folder, read_json, write_json
from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst._views.fields import json_values
from dehyst.trust.changes import SLOW
from dehyst.trust.recheck import Recheck

# Marker of a folder and the format of its marker; format of a check.
OWN = ("history.json", "dehyst-history")
_CHECK = "dehyst-check"
# Weight of the last check in the moving average, and its limits in standard deviations (Roberts 1959).
WEIGHT, LIMIT = 0.2, 3.0
# Allowance and decision interval of the cumulative sums, in the same unit (Page 1954).
ALLOWANCE, DECISION = 1.0, 4.0
# The slow changes share a chart: a check finds one of them.
_SLOW = " or ".join(SLOW)
CHARTED = ("gain", "width", "offset", "delay", _SLOW)


@dataclass(frozen=True)
class PastCheck:
    """One check of a history.

    Attributes
    ----------
    checked : datetime
    record : str
    model_id, record_id : str
    error, goal : float
        Largest error without the sensor's noise, and the goal [% of the stroke].
    before : float or None
        Largest error at the identification [% of the stroke].
    standing : str
        Name of the `Standing`.
    effects, scores : Mapping
        By name of the change: its displacement [% of the stroke], and its score, 3 at the smallest change that counts.
    """

    checked: datetime
    record: str
    model_id: str
    record_id: str
    error: float
    goal: float
    before: float | None
    standing: str
    effects: Mapping[str, float]
    scores: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class ControlChart:
    """Control chart of one kind of change, over the checks that looked for it.

    Attributes
    ----------
    name : str
        One of `CHARTED`.
    places : (n,) array
        Numbers of the checks, from 0.
    effects : (n,) array
        Displacement due to the change [% of the stroke].
    scores : (n,) array
        Changes in standard deviations; a change counts from 3 on.
    average : (n,) array
        Their exponentially weighted moving average.
    limits : (n,) array
        Its limits, on both sides of 0.
    above, below : (n,) array
        Cumulative sums (CUSUM) of the excess over the allowance, upwards and downwards; both positive.
    """

    name: str
    places: Array
    effects: Array
    scores: Array
    average: Array
    limits: Array
    above: Array
    below: Array

    @classmethod
    def of(cls, name: str, places: Array, effects: Array, scores: Array) -> ControlChart:
        """Compute the averages and sums of scores."""
        average, above, below = np.zeros((3, scores.size))
        mean = up = down = 0.0
        for k, score in enumerate(scores.tolist()):
            mean += WEIGHT * (score - mean)
            up, down = max(0.0, up + score - ALLOWANCE), max(0.0, down - score - ALLOWANCE)
            average[k], above[k], below[k] = mean, up, down
        kept = (1 - WEIGHT) ** (2 * np.arange(1, scores.size + 1))
        limits = LIMIT * np.sqrt(WEIGHT / (2 - WEIGHT) * (1 - kept))
        return cls(name, places, effects, scores, average, limits, above, below)

    @property
    def alarms(self) -> Mask:
        """Whether the average or a sum is outside of its limits, at each check (n,)."""
        return np.asarray((np.abs(self.average) > self.limits) | (np.maximum(self.above, self.below) > DECISION))

    @property
    def outside(self) -> bool:
        """Whether the average or a sum is outside of its limits at the last check."""
        return bool(self.alarms[-1])

    @property
    def since(self) -> int:
        """First check, from 0, of the present run of alarms; the last check if there is no alarm now."""
        inside = np.flatnonzero(~self.alarms)
        first = inside[-1] + 1 if inside.size else 0
        return int(self.places[min(first, self.places.size - 1)])


@dataclass(frozen=True, eq=False)
class CheckHistory:
    """The checks of one model that a folder holds.

    Attributes
    ----------
    folder : Path
    checks : tuple of PastCheck
        In the order in which they were done.
    others : int
        Number of checks of other models in the folder.
    damaged : tuple of str
        A sentence for each file that is left out because it is not a valid check.
    """

    folder: Path
    checks: tuple[PastCheck, ...]
    others: int = 0
    damaged: tuple[str, ...] = ()

    @classmethod
    def read(cls, folder: PathLike, model_id: str, *, throw: bool = True) -> CheckHistory:
        """Read the checks of the model with this `model_id` from a `folder`.

        Raise `FileFormatError` if the folder has other files or, with `throw`, a file is not a valid check. Without
        `throw` such a file is left out, see `damaged`.
        """
        demand_folder(folder)
        every, damaged = [], []
        for path in sorted(Path(folder).glob("check-*.json")):
            try:
                every.append(_past(path))
            except FileFormatError as error:
                if throw:
                    raise
                damaged.append(f"left out of the history: {error}")
        every.sort(key=lambda one: one.checked)
        own = tuple(one for one in every if one.model_id == model_id)
        return cls(Path(folder), own, len(every) - len(own), tuple(damaged))

    @classmethod
    def keep(cls, folder: PathLike, recheck: Recheck, *, moment: datetime | None = None) -> CheckHistory:
        """Write a check to a folder, made if it does not exist, and read the history.

        A record that was checked before with the same model keeps its place and gets the new result. A file that is not
        a valid check is left out, see `damaged`; a damaged file of the same record and model is replaced.

        Parameters
        ----------
        folder : path-like
            New, empty or the folder of a history.
        recheck : Recheck
        moment : datetime, optional
            Time of the check, with a time zone; default: now.

        Raises
        ------
        FileFormatError
            If the folder holds other files or cannot be written, or `moment` has no zone.
        IdentifyError
            If the record clearly belongs to another actuator, see `Recheck.mismatch`.
        """
        if recheck.mismatch:
            raise IdentifyError(f"{recheck.mismatch}. It is not kept in the history")
        if moment is not None and moment.tzinfo is None:
            raise FileFormatError(argument="moment", got=f"{moment} without a time zone", hint="try datetime.now(UTC)")
        demand_folder(folder)
        target = make_own_folder(folder, *OWN, option="--history")
        path = target / f"check-{recheck.model_id}-{recheck.record_id}.json"
        done = moment or _moment_of(path) or datetime.now(UTC)
        write_json(target / OWN[0], {"format": OWN[1], "version": 1})
        write_json(path, {"format": _CHECK, "version": 1, "checked": done.isoformat(), **recheck.as_dict()})
        return cls.read(target, recheck.model_id, throw=False)

    def charts(self) -> tuple[ControlChart, ...]:
        """Return a chart of each kind of change that a check looked for."""
        charts = []
        for name in CHARTED:
            rows = [(k, one.effects[name], one.scores[name]) for k, one in enumerate(self.checks) if name in one.scores]
            if rows:
                charts.append(ControlChart.of(name, *np.array(rows, dtype=np.float64).T))
        return tuple(charts)

    def average_error(self) -> Array:
        """Return the exponentially weighted moving average of the errors (n,) [% of the stroke], from the first on."""
        means: list[float] = []
        for one in self.checks:
            last = means[-1] if means else one.error
            means.append(last + WEIGHT * (one.error - last))
        return np.array(means)

    def sentences(self) -> tuple[str, ...]:
        """Return a sentence for each kind of change whose control chart is outside of its limits now."""
        return tuple(
            f"{chart.name.capitalize()}: average or cumulative sum of the checks has been outside of its limits "
            f"since check {chart.since + 1} ({self.checks[chart.since].checked:%Y-%m-%d}): a lasting change, now "
            f"{chart.effects[-1]:+.2g} % of the stroke."
            for chart in self.charts()
            if chart.outside
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "name effect_percent=effects score=scores average limit=limits above below outside"
        return {
            "checks": len(self.checks),
            "others": self.others,
            "average_error_percent": self.average_error().tolist(),
            "charts": [json_values(chart, keys) for chart in self.charts()],
            "sentences": list(self.sentences()),
        }


def demand_folder(folder: PathLike) -> None:
    """Raise `FileFormatError` if a folder is neither new, nor empty, nor the folder of a history."""
    marker = Path(folder) / OWN[0]
    checks = [path.name for path in Path(folder).glob("check-*.json") if format_of(path) == _CHECK]
    if checks and format_of(marker) != OWN[1]:
        what = "is damaged" if marker.exists() else "is missing"
        raise FileFormatError(
            f"{marker}: {what}, but the folder holds {counted(len(checks), 'check')}; write "
            f'{{"format": "{OWN[1]}", "version": 1}} into that file, or give another folder with --history'
        )
    demand_own_folder(folder, *OWN, option="--history")


def _moment_of(path: Path) -> datetime | None:
    """Return the time of a check; None if there is no such check, or its file is damaged."""
    try:
        return _past(path).checked
    except FileFormatError:
        return None


def _past(path: Path) -> PastCheck:
    """Read one check."""
    data = read_json(path)
    if data.get("format") == _CHECK:
        demand_version(data, f"{path}")
    try:
        if data["format"] != _CHECK:
            raise ValueError(f"format {data['format']!r}")
        checked = datetime.fromisoformat(data["checked"])
        if checked.tzinfo is None:
            raise ValueError("checked: has no time zone")
        changes = [(_SLOW if one["name"] in SLOW else str(one["name"]), one) for one in data["changes"]]
        before = data["before_percent"]
        return PastCheck(
            checked=checked,
            record=str(data["record"]),
            model_id=str(data["model_id"]),
            record_id=str(data["record_id"]),
            error=float(data["without_noise_percent"]),
            goal=float(data["goal_percent"]),
            before=None if before is None else float(before),
            standing=str(data["standing"]),
            effects={name: float(one["effect_percent"]) for name, one in changes},
            scores={name: float(one["score"]) for name, one in changes},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: is not a check written by dehyst ({type(error).__name__}: {error}); remove it from the folder"
        ) from error
