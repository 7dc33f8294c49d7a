"""What the table of a fleet shows: distributions, outliers, refused records with reasons, and duplicates."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.fleet.shards import CAUSE
from dehyst.fleet.table import Fleet

# Deviations in robust standard deviations beyond which a record is listed: a normal distribution of all quantities
# would have one record in 200 000 there, one with heavy tails (Student's t, 5 degrees) 0.4 % a quantity.
THRESHOLD = 5.0
# A median absolute deviation of a normal distribution.
_MAD = 1.4826
# Fewer records have no distribution.
FEWEST = 8


class ScoredQuantity(NamedTuple):
    """A quantity: name, unit, column, whether its logarithm is taken, and the least deviation that counts as one.

    The least is in the unit, or a part of the value for a logarithm; `relative` columns are in % of the stroke.
    """

    name: str
    unit: str
    column: str
    logarithm: bool = False
    least: float = 0.0
    relative: bool = False

    def value(self, row: Mapping[str, Any]) -> float:
        """Return the value of a row; NaN without one."""
        value = row[self.column]
        if value is None:
            return float("nan")
        return 100 * float(value) / float(row["stroke_um"]) if self.relative else float(value)


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
    """A record with a quantity far from the fleet's median.

    `row`: the number of the `record` among those with a model. `quantity`: its name. `value` and `median` in `unit`;
    `score` in robust standard deviations.
    """

    row: int
    record: str
    quantity: str
    unit: str
    value: float
    median: float
    score: float

    @property
    def words(self) -> str:
        """The quantity beside that of the fleet."""
        return f"{self.quantity} {self.value:.3g} {self.unit} (fleet {self.median:.3g}, z {self.score:+.1f})"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return json_values(self, "record quantity unit value median z=score")


def outliers(
    rows: Sequence[Mapping[str, Any]], names: Sequence[str], threshold: float = THRESHOLD
) -> tuple[Outlier, ...]:
    """Return what is far from the median of the fleet, the farthest first; none of a fleet of fewer than 8 records."""
    found: list[Outlier] = []
    for quantity in QUANTITIES:
        values = np.array([quantity.value(row) for row in rows])
        scores, median = robust_scores(values, quantity)
        found += [
            Outlier(k, names[k], quantity.name, quantity.unit, float(values[k]), median, float(scores[k]))
            for k in np.flatnonzero(np.abs(scores) > threshold).tolist()
        ]
    return tuple(sorted(found, key=lambda one: -abs(one.score)))


def robust_scores(values: Array, quantity: ScoredQuantity) -> tuple[Array, float]:
    """Return scores (n,) and the median: distances from it in robust standard deviations of its own side.

    Two sides, because distributions of errors and widths are skewed. A value that is not known scores 0.
    """
    known = np.isfinite(values) & ((values > 0) | (not quantity.logarithm))
    scores = np.zeros(values.size)
    if np.count_nonzero(known) < FEWEST:
        return scores, float("nan")
    x = np.log(values[known]) if quantity.logarithm else values[known]
    centre = float(np.median(x))
    off = x - centre
    for side in (-1, 1):
        distances = side * off[side * off >= 0]
        scale = max(_MAD * float(np.median(distances)), quantity.least)
        scores[np.flatnonzero(known)[side * off > 0]] = off[side * off > 0] / scale
    return scores, float(np.exp(centre)) if quantity.logarithm else centre


_QUANTILES = (0.01, 0.25, 0.5, 0.75, 0.99)
_SHOWN = 20
_REASON = 110


@dataclass(frozen=True, eq=False)
class Findings:
    """What a table shows.

    Attributes
    ----------
    fleet : Fleet
    outliers : tuple of Outlier
        The farthest first; a record may be there several times.
    refused : tuple of (reason, names)
        Records without a model, the most frequent reason first.
    inaccurate : tuple of str
        Records whose model misses them.
    duplicates : tuple of tuple of str
        Names of records with the same samples.
    """

    fleet: Fleet
    outliers: tuple[Outlier, ...]
    refused: tuple[tuple[str, tuple[str, ...]], ...]
    inaccurate: tuple[str, ...]
    duplicates: tuple[tuple[str, ...], ...]

    @property
    def listed(self) -> tuple[str, ...]:
        """Names of the records to look at: outliers and inaccurate ones, each once."""
        return tuple(dict.fromkeys([*(one.record for one in self.outliers), *self.inaccurate]))

    @property
    def counts(self) -> dict[str, int]:
        """Number of records of each outcome."""
        return dict(Counter(str(row["outcome"]) for row in self.fleet.rows).most_common())

    def values(self, column: int) -> Array:
        """Return the known values (n,) of one of `QUANTITIES`; `column`: its number."""
        values = np.array([QUANTITIES[column].value(row) for row in identified(self.fleet)])
        return np.asarray(values[np.isfinite(values)])

    def distributions(self) -> Iterator[tuple[str, str, list[float]]]:
        """Yield name, unit and quantiles 1, 25, 50, 75 and 99 % of each quantity."""
        for k, quantity in enumerate(QUANTITIES):
            if (values := self.values(k)).size:
                yield quantity.name, quantity.unit, list(np.quantile(values, _QUANTILES).tolist())

    def lines(self) -> list[str]:
        """Return a text to read."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.counts.items())
        return [
            f"{counted(len(self.fleet), 'record')}: {counts}",
            *self._table(),
            *self._listed(),
            *self._without_model(),
            *_some("Same samples", [" = ".join(group) for group in self.duplicates]),
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "records": len(self.fleet),
            "outcomes": self.counts,
            "distributions": {
                name: {"unit": unit, **{f"q{100 * q:02.0f}": x for q, x in zip(_QUANTILES, values, strict=True)}}
                for name, unit, values in self.distributions()
            },
            "refused": [{"reason": reason, "records": list(names)} for reason, names in self.refused],
            **json_values(self, "listed outliers inaccurate duplicates"),
        }

    def _table(self) -> list[str]:
        rows = [(f"{name} ({unit})", *(f"{x:.4g}" for x in values)) for name, unit, values in self.distributions()]
        head = ("", *(f"{100 * q:g} %" for q in _QUANTILES))
        return [f"{row[0]:32}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in ([head, *rows] if rows else [])]

    def _listed(self) -> list[str]:
        words: dict[str, list[str]] = defaultdict(list)
        for one in self.outliers:
            words[one.record].append(one.words)
        texts = [f"{name}: {'; '.join(words.get(name, ['the model misses the record']))}" for name in self.listed]
        return _some("Look at", texts)

    def _without_model(self) -> list[str]:
        return _some("Without a model", [f"{len(names)}: {reason} ({names[0]}, ...)" for reason, names in self.refused])


def findings_of(fleet: Fleet, *, threshold: float = THRESHOLD) -> Findings:
    """Return what the table of a `fleet` shows.

    `threshold`: robust standard deviations beyond which a record is listed. Raise `IdentifyError` if it is no finite
    number above 0, `FileFormatError` if the table is empty.
    """
    if not (isfinite(threshold) and threshold > 0):
        raise IdentifyError(
            argument="threshold", got=f"{threshold:g}", need=f"a finite number above 0, as {THRESHOLD:g}"
        )
    if not fleet.rows:
        raise FileFormatError(f"{fleet.path}: holds no rows; identify a dataset with records first")
    rows, names = fleet.rows, [fleet.name(row) for row in fleet.rows]
    modelled = [k for k, row in enumerate(rows) if row["stroke_um"] is not None and row["rms_percent"] is not None]
    far = outliers([rows[k] for k in modelled], [names[k] for k in modelled], threshold)
    inaccurate = tuple(names[k] for k, row in enumerate(rows) if row["outcome"] == "inaccurate")
    return Findings(fleet, far, _reasons(rows, names), inaccurate, _copies(rows, names))


def identified(fleet: Fleet) -> list[Mapping[str, Any]]:
    """Return the rows that have a model."""
    return [row for row in fleet.rows if row["rms_percent"] is not None]


def _reasons(rows: tuple[Mapping[str, Any], ...], names: list[str]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Return the reasons, each as the first of its records has it, and the names: one if their causes are the same."""
    groups: dict[tuple[Any, ...], list[int]] = defaultdict(list)
    for k, row in enumerate(rows):
        if row["outcome"] in ("refused", "lost"):
            groups[row["outcome"], row["detail"], row.get(CAUSE)].append(k)
    ordered = sorted(groups.values(), key=lambda group: -len(group))
    return tuple(
        (_unnamed(str(rows[group[0]]["reason"]), names[group[0]]), tuple(names[k] for k in group)) for group in ordered
    )


def _unnamed(reason: str, name: str) -> str:
    return reason.removeprefix(f"record '{name}': ").removeprefix(f"{name}: ")[:_REASON]


def _copies(rows: tuple[Mapping[str, Any], ...], names: list[str]) -> tuple[tuple[str, ...], ...]:
    groups: dict[str, list[str]] = defaultdict(list)
    for row, name in zip(rows, names, strict=True):
        if row["sha256"]:
            groups[str(row["sha256"])].append(name)
    return tuple(tuple(group) for group in groups.values() if len(group) > 1)


def _some(title: str, texts: list[str]) -> list[str]:
    """Return a title and the first texts, and how many there are."""
    if not texts:
        return []
    more = [f"  and {len(texts) - _SHOWN} more, see --json"] if len(texts) > _SHOWN else []
    return [f"{title} ({len(texts)}):", *(f"  {text}" for text in texts[:_SHOWN]), *more]
