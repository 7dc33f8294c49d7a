"""Findings in the table of a fleet: distributions, outliers, refused records with reasons, and duplicates."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.fleet.table import Fleet

# Deviations in robust standard deviations beyond which a record is listed: a normal distribution of all quantities
# would have one record in 200 000 there, one with heavy tails (Student's t, 5 degrees) 0.4 % a quantity.
THRESHOLD = 5.0
# A median absolute deviation of a normal distribution.
_MAD = 1.4826
# Fewer records have no distribution.
_FEWEST = 8
_QUANTILES = (0.01, 0.25, 0.5, 0.75, 0.99)
# Lines of a list, and characters of a reason.
_SHOWN, _REASON = 20, 110
_NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
# Why an inaccurate record is to be looked at.
MISSED = "the model misses the record"


class ScoredQuantity(NamedTuple):
    """A quantity: name, unit, column, whether its logarithm is used, and the least standard deviation to assume.

    The least deviation is in the unit, or for a logarithm a part of the value; `relative` columns are in % of the
    stroke.
    """

    name: str
    unit: str
    column: str
    logarithm: bool = False
    least: float = 0.0
    relative: bool = False

    @property
    def title(self) -> str:
        """Name and unit."""
        return f"{self.name} ({self.unit})"

    def values(self, rows: Sequence[Mapping[str, Any]]) -> Array:
        """Return the values (n,) of rows; NaN for rows without one."""
        values = np.array([np.nan if row[self.column] is None else float(row[self.column]) for row in rows])
        return 100 * values / np.array([float(row["stroke_um"]) for row in rows]) if self.relative else values

    def scores(self, values: Array) -> tuple[Array, float]:
        """Return scores (n,) of values (n,) and the median: distances in robust standard deviations of each side.

        Each side has its own deviation, because distributions of errors and widths are skewed. Unknown values score 0;
        with fewer than 8 values, all score 0.
        """
        known = np.flatnonzero(np.isfinite(values) & ((values > 0) | (not self.logarithm)))
        scores = np.zeros(values.size)
        if known.size < _FEWEST:
            return scores, float("nan")
        x = np.log(values[known]) if self.logarithm else values[known]
        centre = float(np.median(x))
        off = x - centre
        for side in (-1, 1):
            scale = max(_MAD * float(np.median(np.abs(off[side * off >= 0]))), self.least)
            scores[known[side * off > 0]] = off[side * off > 0] / scale
        return scores, float(np.exp(centre)) if self.logarithm else centre


QUANTITIES = (
    ScoredQuantity("RMS error", "% of the stroke", "rms_percent", logarithm=True, least=0.1),
    ScoredQuantity("noise", "% of the stroke", "noise_percent", logarithm=True, least=0.1),
    ScoredQuantity("stroke", "um", "stroke_um", logarithm=True, least=0.005),
    ScoredQuantity("width at 25 %", "% of the stroke", "width25_um", least=0.1, relative=True),
    ScoredQuantity("width at 50 %", "% of the stroke", "width50_um", least=0.1, relative=True),
    ScoredQuantity("width at 75 %", "% of the stroke", "width75_um", least=0.1, relative=True),
    ScoredQuantity("drift", "% of the stroke", "drift_percent", least=0.1),
)


@dataclass(frozen=True)
class Outlier:
    """A `record` whose `value` of a `quantity` is far from the `median`; `score` in robust standard deviations."""

    record: str
    quantity: ScoredQuantity
    value: float
    median: float
    score: float

    @property
    def words(self) -> str:
        """The quantity, and the fleet's median, as text."""
        name, unit = self.quantity.name, self.quantity.unit
        return f"{name} {self.value:.3g} {unit} (fleet {self.median:.3g}, z {self.score:+.1f})"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "record quantity=quantity.name unit=quantity.unit value median z=score")


@dataclass(frozen=True, eq=False)
class Findings:
    """Findings in the table of a `fleet`.

    `outliers`: the farthest first; a record may be there several times. `refused`: reasons and names of records without
    a model, the most frequent reason first. `inaccurate`: records whose model misses them. `duplicates`: names of
    records with the same samples.
    """

    fleet: Fleet
    outliers: tuple[Outlier, ...]
    refused: tuple[tuple[str, tuple[str, ...]], ...]
    inaccurate: tuple[str, ...]
    duplicates: tuple[tuple[str, ...], ...]

    @property
    def listed(self) -> tuple[str, ...]:
        """Names of the records to inspect: outliers and inaccurate ones, each once."""
        return tuple(dict.fromkeys([*(one.record for one in self.outliers), *self.inaccurate]))

    @property
    def counts(self) -> dict[str, int]:
        """Number of records of each outcome."""
        return dict(Counter(str(row["outcome"]) for row in self.fleet.rows).most_common())

    def distributions(self) -> dict[ScoredQuantity, Array]:
        """Return the known values (n,) of each quantity that has any."""
        rows = modelled(self.fleet)
        found = {quantity: quantity.values(rows) for quantity in QUANTITIES}
        return {quantity: x[np.isfinite(x)] for quantity, x in found.items() if np.isfinite(x).any()}

    def lines(self) -> list[str]:
        """Return a text to read."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.counts.items())
        table = [
            f"{quantity.title:32}" + "".join(f"{x:>10.4g}" for x in np.quantile(values, _QUANTILES))
            for quantity, values in self.distributions().items()
        ]
        head = [f"{'':32}" + "".join(f"{f'{100 * q:g} %':>10}" for q in _QUANTILES)] if table else []
        words: dict[str, list[str]] = defaultdict(list)
        for one in self.outliers:
            words[one.record].append(one.words)
        return [
            f"{counted(len(self.fleet), 'record')}: {counts}",
            *head,
            *table,
            *_some("Look at", [f"{name}: {'; '.join(words.get(name, [MISSED]))}" for name in self.listed]),
            *_some(
                "Without a model",
                [f"{len(names)}: {why} ({names[0]}{', ...' if len(names) > 1 else ''})" for why, names in self.refused],
                sum(len(names) for _, names in self.refused),
            ),
            *_some("Same samples", [" = ".join(group) for group in self.duplicates]),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = [f"q{100 * q:02.0f}" for q in _QUANTILES]
        return {
            "records": len(self.fleet),
            "outcomes": self.counts,
            "distributions": {
                one.name: {"unit": one.unit, **dict(zip(keys, np.quantile(x, _QUANTILES).tolist(), strict=True))}
                for one, x in self.distributions().items()
            },
            "refused": [{"reason": reason, "records": list(names)} for reason, names in self.refused],
            **json_values(self, "listed outliers inaccurate duplicates"),
        }


def _some(title: str, texts: list[str], records: int | None = None) -> list[str]:
    """Return a title with the number of records (default: one for each text), the first texts, and how many remain."""
    if not texts:
        return []
    more = [f"  and {len(texts) - _SHOWN} more, see --json"] if len(texts) > _SHOWN else []
    return [f"{title} ({records or len(texts)}):", *(f"  {text}" for text in texts[:_SHOWN]), *more]


def findings_of(fleet: Fleet, *, threshold: float = THRESHOLD) -> Findings:
    """Return the findings in the table of a `fleet`.

    `threshold`: robust standard deviations beyond which a record is listed. Raise `IdentifyError` if it is not a finite
    number above 0, `FileFormatError` if the table is empty.
    """
    if not (isfinite(threshold) and threshold > 0):
        raise IdentifyError(
            argument="threshold", got=f"{threshold:g}", need=f"a finite number above 0, as {THRESHOLD:g}"
        )
    if not fleet.rows:
        raise FileFormatError(f"{fleet.path}: holds no rows; identify a dataset with records first")
    rows, outliers = modelled(fleet), list[Outlier]()
    for quantity in QUANTITIES:
        values = quantity.values(rows)
        scores, median = quantity.scores(values)
        for k in np.flatnonzero(np.abs(scores) > threshold).tolist():
            outliers.append(Outlier(fleet.name(rows[k]), quantity, float(values[k]), median, float(scores[k])))
    inaccurate = tuple(fleet.name(row) for row in fleet.rows if row["outcome"] == "inaccurate")
    same: dict[str, list[str]] = defaultdict(list)
    for row in fleet.rows:
        if row["sha256"]:
            same[row["sha256"]].append(fleet.name(row))
    return Findings(
        fleet,
        tuple(sorted(outliers, key=lambda one: -abs(one.score))),
        _reasons(fleet),
        inaccurate,
        tuple(tuple(names) for names in same.values() if len(names) > 1),
    )


def modelled(fleet: Fleet) -> list[Mapping[str, Any]]:
    """Return the rows that have a model."""
    return [row for row in fleet.rows if row["rms_percent"] is not None]


def _reasons(fleet: Fleet) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return reasons with the names of their records; reasons that differ in numbers only share the first one's."""
    groups: dict[tuple[str, ...], list[tuple[str, str]]] = defaultdict(list)
    for row in fleet.rows:
        if row["outcome"] in ("refused", "lost"):
            name, reason = fleet.name(row), str(row["reason"])
            reason = reason.removeprefix(f"record '{name}': ").removeprefix(f"{name}: ")
            groups[row["outcome"], row["detail"], _NUMBER.sub("0", reason)].append((name, reason))
    return tuple(
        (group[0][1][:_REASON], tuple(name for name, _ in group))
        for group in sorted(groups.values(), key=lambda group: -len(group))
    )
