"""Charts: their contents, independent of the drawing library, and their numbers inside a page."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._types import Array

Indices: TypeAlias = NDArray[np.intp]

# Names of colours in web/style.css, which has a light and a dark form of each.
Colour: TypeAlias = Literal["measured", "simulated", "rising", "falling", "without", "ink", "tested"]
Kind: TypeAlias = Literal["line", "points", "area", "cells"]
# A column of 16 bits: steps between its least and its largest value, and the code for a missing value.
_STEPS, _MISSING = 65534, 65535
# Samples of all long series of a page together, least samples of a series, and weight of a loop among other series.
_SAMPLES, _LEAST, _LOOP = 8000, 200, 3
# A line leaves out vertices this near to the line between their neighbours, in parts of the range. The first distance
# is invisible; the larger ones are used if too many vertices are left. Series are first cut to a multiple of `most`.
_NEAR, _ROUGH = (5e-4, 1e-3, 2e-3, 4e-3, 8e-3), 20


@dataclass(frozen=True)
class Axis:
    """An axis: quantity, unit, and range (None: that of the data). A `log` axis has positive numbers."""

    quantity: str
    unit: str = ""
    range: tuple[float, float] | None = None
    log: bool = False

    @property
    def label(self) -> str:
        """The quantity with its unit."""
        return f"{self.quantity} ({self.unit})" if self.unit else self.quantity

    def scaled(self, values: ArrayLike) -> Array:
        """Return values for the page: for a `log` axis their decimal exponents."""
        numbers = np.asarray(values, dtype=np.float64)
        return np.log10(numbers) if self.log else numbers


@dataclass(frozen=True, eq=False)
class Series:
    """A curve, points, an area or cells: x and y (n,), in the units of the axes; NaN breaks a curve.

    `top` (n,): the other edge of an area. `values` (m, k): values of cells between m + 1 edges y and k + 1 edges x;
    larger values are darker, up to `darkest`, by default the largest value. `names`: names of single points.
    """

    name: str
    x: Array
    y: Array
    colour: Colour
    kind: Kind = "line"
    width: float = 1.4
    opacity: float = 1.0
    names: tuple[str, ...] = ()
    dashed: bool = False
    top: Array | None = None
    values: Array | None = None
    darkest: float | None = None

    @property
    def rising(self) -> bool:
        """Whether the series is a line whose x rises."""
        return self.kind == "line" and self.x.size > 1 and bool((np.diff(self.x) > 0).all())

    @property
    def parts(self) -> int:
        """Weight in the samples of a page: loops need more samples than a curve over time, or dots."""
        return _LOOP if self.kind == "line" and not self.rising else 1


def stems(name: str, x: Array, top: Array, colour: Colour, *, width: float = 1.4) -> tuple[Series, ...]:
    """Return vertical lines from 0 to `top` at each x, as one curve; empty without values."""
    ends = np.zeros(x.shape), top, np.full(x.shape, np.nan)
    line = Series(name, np.repeat(x, 3), np.column_stack(ends).ravel(), colour, width=width)
    return (line,) if x.size else ()


def gaps(time: Array) -> Indices:
    """Return the last sample before each gap in time."""
    steps = np.diff(time)
    return np.flatnonzero(steps > 3 * np.median(steps)) if steps.size else np.zeros(0, np.intp)


def broken(time: Array, values: Array) -> Array:
    """Return values (n,) with NaN before each gap, so that no line crosses the gap."""
    out = np.array(values, dtype=np.float64)
    out[gaps(time)] = np.nan
    return out


def vertices(x: Array, y: Array, most: int) -> Indices:
    """Return the samples of a line (n,) to draw, about `most`; x and y are in units of their ranges."""
    at, place = _extremes(np.arange(x.size), y, _ROUGH * most), x + 1j * y
    for near, first in product(_NEAR, (1, 2) * 4):
        if at.size <= most and near > _NEAR[0]:
            break
        middle = np.arange(first, at.size - 1, 2)
        way, whole = (place[at[middle + k]] - place[at[middle - 1]] for k in (0, 1))
        part = np.clip(np.real(way * whole.conj()) / np.maximum(np.abs(whole) ** 2, 1e-300), 0, 1)
        # NaN interrupts a line, and is never near.
        at = np.delete(at, middle[np.abs(way - part * whole) < near])
    return _extremes(at, y, most)


def _range(values: Array) -> float:
    """Return the range of the finite values; 1 if they have none."""
    good = values[np.isfinite(values)]
    return float(np.ptp(good)) if good.size and np.ptp(good) else 1.0


def _extremes(at: Indices, y: Array, most: int) -> Indices:
    """Return the lowest and the highest of neighbouring samples, at most `most` in all."""
    if at.size <= most:
        return at
    each = -(-at.size // (most // 2))
    rows = at[np.minimum(np.arange(-(-at.size // each) * each), at.size - 1)].reshape(-1, each)
    picked = [np.take_along_axis(rows, pick(y[rows], axis=1)[:, None], 1) for pick in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([at[[0, -1]], *(column[:, 0] for column in picked)]))


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart under a title, such as a record, and its `role`.

    `right` is a second axis, of the numbers of y times a factor: (factor, quantity, unit). Parts of the abscissa are
    `shaded`, a part of the ordinate is the `band`, `zero` is marked if set; `notes` are words of the legend that belong
    to no series, with their colours.
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

    def shown(self, most: int) -> Chart:
        """Return the chart with the samples to draw, about `most` of a long series."""
        sides = [(self.x, [series.x for series in self.series]), (self.y, [series.y for series in self.series])]
        scales = [_range(axis.scaled(np.concatenate(values))) for axis, values in sides]
        return replace(self, series=[self._thinned(series, most, scales) for series in self.series])

    def _thinned(self, series: Series, most: int, scales: Sequence[float]) -> Series:
        """Return a series with the samples to draw in a picture whose axes have ranges `scales`."""
        most *= series.parts
        if series.x.size <= most or series.kind == "cells" or series.names:
            return series
        if series.kind == "points":
            at = np.unique(np.linspace(0, series.x.size - 1, most).astype(np.intp))
        else:
            x, edges = self.x.scaled(series.x) / scales[0], [series.y] if series.top is None else [series.y, series.top]
            each = [vertices(x, self.y.scaled(edge) / scales[1], most) for edge in edges]
            at = np.unique(np.concatenate(each))
        return replace(series, x=series.x[at], y=series.y[at], top=None if series.top is None else series.top[at])


@dataclass(eq=False)
class ChartData:
    """The charts of one page: long series share its samples, and equal columns are stored once."""

    _charts: list[Chart] = field(default_factory=list)
    _places: dict[bytes, int] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self._charts)

    def add(self, chart: Chart) -> int:
        """Add a chart, and return its number on the page."""
        self._charts.append(chart)
        return len(self._charts) - 1

    def json(self) -> str:
        """Return all charts as JSON inside a page."""
        long = (series.parts for chart in self._charts for series in chart.series if series.x.size > _LEAST)
        most = max(_LEAST, _SAMPLES // max(sum(long), 1))
        charts = [self._stored(chart.shown(most)) for chart in self._charts]
        columns = [_column(np.frombuffer(values)) for values in self._places]
        text = json.dumps({"columns": columns, "charts": charts}, separators=(",", ":"), allow_nan=False)
        # A name must not end the <script> element.
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")

    def _stored(self, chart: Chart) -> dict[str, Any]:
        stored: dict[str, Any] = {
            "title": chart.title,
            "role": chart.role,
            "label": f"{chart.title}: {chart.y.quantity} over {chart.x.quantity}",
            "x": _axis(chart.x),
            "y": _axis(chart.y),
            "series": [self._series(series, chart) for series in chart.series],
            "shaded": [list(ends) for ends in chart.shaded],
            "levels": [{"value": 0}] if chart.zero else [],
            "notes": [[colour, words] for words, colour in chart.notes],
        }
        if chart.right is not None:
            factor, quantity, unit = chart.right
            stored["right"] = {"factor": factor, "label": f"{quantity} ({unit})", "unit": unit}
        if chart.band is not None:
            stored["band"] = list(chart.band)
        return {key: value for key, value in stored.items() if value}

    def _series(self, series: Series, chart: Chart) -> dict[str, Any]:
        x, y = chart.x.scaled(series.x), chart.y.scaled(series.y)
        stored: dict[str, Any] = {
            "name": series.name,
            "x": self._place(x),
            "y": self._place(y),
            "colour": series.colour,
            "kind": series.kind,
            "width": series.width,
            "opacity": series.opacity,
        }
        if series.top is not None:
            stored["top"] = self._place(chart.y.scaled(series.top))
        if series.values is not None:
            stored["values"] = self._place(series.values.ravel())
        flags: dict[str, Any] = {"rising": series.rising, "darkest": series.darkest}
        flags |= {"names": list(series.names), "dash": [5, 4] * series.dashed}
        return stored | {key: value for key, value in flags.items() if value}

    def _place(self, values: Array) -> int:
        """Return the number of a column on the page."""
        return self._places.setdefault(np.asarray(values, dtype=np.float64).tobytes(), len(self._places))


def _axis(axis: Axis) -> dict[str, Any]:
    stored = {"label": axis.label, "unit": axis.unit, "log": axis.log}
    if axis.range is not None:
        stored["range"] = axis.scaled(axis.range).tolist()
    return {key: value for key, value in stored.items() if value or key == "unit"}


def _column(values: Array) -> dict[str, Any]:
    """Return a column as base64 of 16-bit steps above its least value."""
    good = np.isfinite(values)
    low, high = (float(values[good].min()), float(values[good].max())) if good.any() else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    codes = np.full(values.size, _MISSING, dtype="<u2")
    codes[good] = np.rint((values[good] - low) / step).astype("<u2")
    return {"low": low, "step": step, "steps": base64.b64encode(codes.tobytes()).decode()}
