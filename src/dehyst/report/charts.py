"""Charts: their contents, independent of what draws them, and their numbers inside a page."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array

# Names of colours in web/style.css, where each has a light and a dark form.
Colour: TypeAlias = Literal["measured", "simulated", "rising", "falling", "without", "ink", "noise", "tested"]
Kind: TypeAlias = Literal["line", "points", "area", "cells"]
# Steps of a 16-bit column from its least to its largest value, and the code for a missing value.
_STEPS, _MISSING = 65534, 65535
# A line leaves out vertices that do not move by this part of its range.
_CELLS = 2000


@dataclass(frozen=True)
class Axis:
    """An axis: quantity, unit, and range, if not the data's. A `log` axis has positive numbers."""

    quantity: str
    unit: str = ""
    range: tuple[float, float] | None = None
    log: bool = False

    @property
    def label(self) -> str:
        """Quantity and unit."""
        return f"{self.quantity} ({self.unit})" if self.unit else self.quantity

    def scaled(self, values: ArrayLike) -> Array:
        """Return values as a page stores them: of a `log` axis their decimal exponents."""
        numbers = np.asarray(values, dtype=np.float64)
        return np.log10(numbers) if self.log else numbers


@dataclass(frozen=True, eq=False)
class Series:
    """A curve, points, an area or cells: x and y (n,), in the units of the axes; NaN breaks a curve.

    `top` (n,): the other edge of an area. `values` (m, k): values of cells between m + 1 edges y and k + 1 edges x;
    larger values are darker, up to `darkest`, by default the largest value. `names`: names of single points. An `exact`
    x needs more than 16 bits, as the time of a long record does.
    """

    name: str
    x: Array
    y: Array
    colour: Colour
    kind: Kind = "line"
    width: float = 1.4
    opacity: float = 1.0
    exact: bool = False
    names: tuple[str, ...] = ()
    dashed: bool = False
    hollow: bool = False
    top: Array | None = None
    values: Array | None = None
    darkest: float | None = None


def stems(name: str, x: Array, top: Array, colour: Colour, *, width: float = 1.4) -> tuple[Series, ...]:
    """Return upright lines from 0 to `top` at each x, as one curve; none without values."""
    ends = np.zeros(x.shape), top, np.full(x.shape, np.nan)
    line = Series(name, np.repeat(x, 3), np.column_stack(ends).ravel(), colour, width=width)
    return (line,) if x.size else ()


def steps(edges: Array, values: Array) -> tuple[Array, Array]:
    """Return x and y of a curve that is constant between edges."""
    return np.repeat(edges, 2)[1:-1], np.repeat(values, 2)


def thinned(time: Array, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the vertices of a line through samples, fewer where they are dense, broken where samples are missing."""
    gaps = np.diff(time)
    cuts = np.flatnonzero(gaps > 3 * np.median(gaps)) + 1 if gaps.size else np.empty(0, np.intp)
    cell = np.column_stack([(z - z.min()) * (_CELLS / (float(np.ptp(z)) or 1.0)) for z in (x, y)]).round()
    keep = np.ones(x.size, bool)
    keep[1:] = np.any(np.diff(cell, axis=0) != 0, axis=1)
    keep[-1:] = keep[cuts] = keep[cuts - 1] = True
    # A NaN interrupts the line.
    where = np.cumsum(keep)[cuts - 1] if cuts.size else cuts
    return np.insert(x[keep], where, np.nan), np.insert(y[keep], where, np.nan)


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart under a title, such as a record, and its `role`.

    `right` is a second axis, of the numbers of y times a factor: (factor, quantity, unit). Parts of the abscissa are
    `shaded`, a part of the ordinate is the `band`, `zero` is marked if set; `notes` are words of the legend that belong
    to no series, with their colours. `about` are further values for scripts of the page.
    """

    title: str
    x: Axis
    y: Axis
    series: Sequence[Series]
    role: str = ""
    right: tuple[float, str, str] | None = None
    shaded: Sequence[tuple[float, float]] = ()
    band: tuple[float, float] | None = None
    zero: bool = False
    notes: Sequence[tuple[str, str]] = ()
    about: Mapping[str, float] = field(default_factory=dict)


@dataclass(eq=False)
class ChartData:
    """The charts of one page: columns that several charts share are stored once."""

    _columns: list[Mapping[str, Any]] = field(default_factory=list)
    _charts: list[Mapping[str, Any]] = field(default_factory=list)
    _places: dict[tuple[bytes, bool], int] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self._charts)

    def add(self, chart: Chart) -> int:
        """Store a chart, and return its number on the page."""
        stored: dict[str, Any] = {
            "title": chart.title,
            "role": chart.role,
            "label": f"{chart.title}: {chart.y.quantity} over {chart.x.quantity}",
            "x": _axis(chart.x),
            "y": _axis(chart.y),
            "series": [self._series(one, chart) for one in chart.series],
            "shaded": [list(ends) for ends in chart.shaded],
            "levels": [{"value": 0}] if chart.zero else [],
            "notes": [[colour, words] for words, colour in chart.notes],
            "about": chart.about,
        }
        if chart.right is not None:
            factor, quantity, unit = chart.right
            stored["right"] = {"factor": factor, "label": f"{quantity} ({unit})", "unit": unit}
        if chart.band is not None:
            stored["band"] = list(chart.band)
        self._charts.append({key: value for key, value in stored.items() if value})
        return len(self._charts) - 1

    def json(self) -> str:
        """Return all charts as JSON for use inside a page."""
        return in_page({"columns": self._columns, "charts": self._charts})

    def _series(self, one: Series, chart: Chart) -> dict[str, Any]:
        x, y = chart.x.scaled(one.x), chart.y.scaled(one.y)
        rising = one.kind == "line" and x.size > 1 and bool((np.diff(x) > 0).all())
        stored: dict[str, Any] = {
            "name": one.name,
            "x": self._column(x, one.exact),
            "y": self._column(y, False),
            "colour": one.colour,
            "kind": one.kind,
            "width": one.width,
            "opacity": one.opacity,
        }
        if one.top is not None:
            stored["top"] = self._column(chart.y.scaled(one.top), False)
        if one.values is not None:
            stored["values"] = self._column(one.values.ravel(), False)
        flags: dict[str, Any] = {"rising": rising, "hollow": one.hollow, "darkest": one.darkest}
        flags |= {"names": list(one.names), "dash": [5, 4] * one.dashed}
        return stored | {key: value for key, value in flags.items() if value}

    def _column(self, values: Array, exact: bool) -> int:
        key = (np.ascontiguousarray(values, dtype=np.float64).tobytes(), exact)
        if key not in self._places:
            self._places[key] = len(self._columns)
            self._columns.append(_stored(np.asarray(values, dtype=np.float64), exact))
        return self._places[key]


def _axis(axis: Axis) -> dict[str, Any]:
    stored = {"label": axis.label, "unit": axis.unit, "log": axis.log}
    if axis.range is not None:
        stored["range"] = axis.scaled(axis.range).tolist()
    return {key: value for key, value in stored.items() if value or key == "unit"}


def in_page(data: Mapping[str, Any]) -> str:
    """Return data as JSON for use inside a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    # Nothing inside may end the element, whatever a name contains.
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _stored(values: Array, exact: bool) -> dict[str, Any]:
    """Return a column as base64: 32-bit floats, or 16-bit steps above its least value."""
    if exact:
        return {"floats": base64.b64encode(values.astype("<f4").tobytes()).decode()}
    good = np.isfinite(values)
    low, high = (float(values[good].min()), float(values[good].max())) if good.any() else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    codes = np.full(values.size, _MISSING, dtype="<u2")
    codes[good] = np.rint((values[good] - low) / step).astype("<u2")
    return {"low": low, "step": step, "steps": base64.b64encode(codes.tobytes()).decode()}
