"""What the table of a fleet shows: distributions, outliers, refused records with reasons, and duplicates."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError, IdentifyError
from dehyst._text import counted
from dehyst._types import Array
from dehyst.fleet.outliers import QUANTITIES, THRESHOLD, Outlier, outliers
from dehyst.fleet.table import Fleet

_QUANTILES = (0.01, 0.25, 0.5, 0.75, 0.99)
_SHOWN = 20
# Reasons are one if they differ in the record's name and in numbers only.
_NAME, _NUMBER = re.compile(r"^record '[^']*': |^[^:']{1,80}: "), re.compile(r"\d[\d.e+-]*")
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
            "listed": list(self.listed),
            "outliers": [one.as_dict() for one in self.outliers],
            "refused": [{"reason": reason, "records": list(names)} for reason, names in self.refused],
            "inaccurate": list(self.inaccurate),
            "duplicates": [list(group) for group in self.duplicates],
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
        raise IdentifyError(f"threshold: got {threshold:g}, need a finite number above 0, as {THRESHOLD:g}")
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
    groups: dict[str, list[int]] = defaultdict(list)
    for k, row in enumerate(rows):
        if row["outcome"] in ("refused", "lost"):
            groups[_NUMBER.sub("#", _NAME.sub("", str(row["reason"])))].append(k)
    ordered = sorted(groups.values(), key=lambda group: -len(group))
    return tuple(
        (_NAME.sub("", str(rows[group[0]]["reason"]))[:_REASON], tuple(names[k] for k in group)) for group in ordered
    )


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
