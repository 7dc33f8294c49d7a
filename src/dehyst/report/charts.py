"""Charts that a page's own script draws: zoom and read-out, with data inside the page."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

import numpy as np

from dehyst._types import Array

# Names of colours in page.css, where each has a light and a dark form.
Colour: TypeAlias = Literal["measured", "simulated", "rising", "falling", "without", "ink"]
# A 16-bit column has so many steps from its least to its largest value, and one code for a missing value.
_STEPS, _MISSING = 65534, 65535


@dataclass(frozen=True)
class Axis:
    """An axis: its quantity, the unit of its numbers if they have one, and its range if it is not that of the data."""

    quantity: str
    unit: str
    range: tuple[float, float] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return what the script needs."""
        ends = {} if self.range is None else {"range": list(self.range)}
        label = f"{self.quantity} ({self.unit})" if self.unit else self.quantity
        return {"label": label, "unit": self.unit, **ends}


@dataclass(frozen=True, eq=False)
class Series:
    """A curve or a cloud of points: x and y (n,), in the units of the axes; NaN breaks a curve.

    `exact`: whether x needs more than 16 bits, as the time of a long record does. `names`: those of single points.
    """

    name: str
    x: Array
    y: Array
    colour: Colour
    kind: Literal["line", "points"] = "line"
    width: float = 1.4
    opacity: float = 1.0
    exact: bool = False
    names: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart.

    Attributes
    ----------
    title, role : str
        Above it: a record, and what it is.
    label : str
        For readers that do not see it.
    x, y : Axis
    series : tuple of Series
    right : (factor, quantity, unit), optional
        A second axis at the right: numbers of y times the factor.
    shaded : sequence of (from, to)
        Parts of the abscissa.
    band : (low, high), optional
        Part of the ordinate.
    zero : bool
        Whether zero is marked.
    keys : tuple of str
        Words in the legend that belong to no series.
    """

    title: str
    role: str
    label: str
    x: Axis
    y: Axis
    series: tuple[Series, ...]
    right: tuple[float, str, str] | None = None
    shaded: Sequence[tuple[float, float]] = ()
    band: tuple[float, float] | None = None
    zero: bool = False
    keys: tuple[tuple[str, str], ...] = ()


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
            "x": chart.x.as_dict(),
            "y": chart.y.as_dict(),
            "series": [self._series(one) for one in chart.series],
        }
        if chart.right is not None:
            factor, quantity, unit = chart.right
            stored["y2"] = {"factor": factor, "label": f"{quantity} ({unit})", "unit": unit}
        if chart.shaded:
            stored["shaded"] = [list(ends) for ends in chart.shaded]
        if chart.band is not None:
            stored["band"] = list(chart.band)
        if chart.zero:
            stored["zero"] = True
        self._charts.append(stored)
        return len(self._charts) - 1

    def json(self) -> str:
        """Return all of it as JSON that can stand inside a page."""
        return in_page({"columns": self._columns, "charts": self._charts})

    def _series(self, one: Series) -> dict[str, Any]:
        stored = {
            "name": one.name,
            "x": self._column(one.x, one.exact),
            "y": self._column(one.y, False),
            "colour": one.colour,
            "kind": one.kind,
            "width": one.width,
            "opacity": one.opacity,
        }
        return stored | ({"names": list(one.names)} if one.names else {})

    def _column(self, values: Array, exact: bool) -> int:
        key = (np.ascontiguousarray(values, dtype=np.float64).tobytes(), exact)
        if key not in self._places:
            self._places[key] = len(self._columns)
            self._columns.append(_stored(np.asarray(values, dtype=np.float64), exact))
        return self._places[key]


def in_page(data: Mapping[str, Any]) -> str:
    """Return data as JSON that can stand inside a page."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    # Nothing inside may end the element, whatever a name contains.
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _stored(values: Array, exact: bool) -> dict[str, Any]:
    """Return a column as base64: 32-bit floats, or 16-bit steps above its least value."""
    if exact:
        return {"floats": _base64(values.astype("<f4"))}
    good = np.isfinite(values)
    low, high = (float(values[good].min()), float(values[good].max())) if good.any() else (0.0, 0.0)
    step = (high - low) / _STEPS or 1.0
    codes = np.full(values.size, _MISSING, dtype="<u2")
    codes[good] = np.rint((values[good] - low) / step).astype("<u2")
    return {"low": low, "step": step, "steps": _base64(codes)}


def _base64(codes: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(codes.tobytes()).decode("ascii")


def legend(chart: Chart) -> list[tuple[str, str]]:
    """Return name and colour of each entry of a chart's legend: of series in one colour, the first."""
    colours: dict[str, str] = {}
    for name, colour in [*((one.name, one.colour) for one in chart.series), *chart.keys]:
        if name:
            colours.setdefault(colour, name)
    return [(name, colour) for colour, name in colours.items()]
