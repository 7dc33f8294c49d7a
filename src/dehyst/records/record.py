"""A measured record: voltage sent and displacement measured over time, always in seconds, volts and metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeGuard

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError, RecordError
from dehyst._text import counted, escaped
from dehyst._types import Array
from dehyst._units import per_metre, plain
from dehyst._views import html, tables
from dehyst._views.pictures import plotted
from dehyst.records.formats.columns import Column, Table, without_groups
from dehyst.records.quality import problems, refuse_implausible, refuse_not_finite, refuse_not_rising, refuse_unusable
from dehyst.records.signals import interpolate, noise_span, outer_extreme, turning_points, white_noise

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import ArrayLike
    from pandas import DataFrame
    from xarray import Dataset

__all__ = ["Array", "Record", "Span", "white_noise"]

Span: TypeAlias = "slice[int, int, None]"

_COLUMNS = {"time": "s", "voltage": "V", "displacement": "m"}


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Record:
    """One measurement of an actuator; wrong input is refused at construction.

    Parameters
    ----------
    time, voltage, displacement : (n,) array_like
        Seconds (strictly rising), volts and metres, n >= 2, all finite and at most 1e30; kept as read-only
        float64 copies (read-only arrays, as another record's, are shared). Quantities with units are converted.
    name : str
        Used in messages.
    meta : mapping
        Origin of the record: source file, sha256, columns.

    Raises
    ------
    RecordError
        Not one-dimensional, not numbers, masked, of another unit, of different lengths, fewer than 2 samples, NaN, inf
        or beyond 1e30, or the time does not rise.
    """

    time: Array
    voltage: Array
    displacement: Array
    name: str = "record"
    meta: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for column in _COLUMNS:
            object.__setattr__(self, column, _frozen_column(getattr(self, column), column, self.name))
        object.__setattr__(self, "meta", dict(self.meta))
        sizes = {column: len(getattr(self, column)) for column in _COLUMNS}
        if len(set(sizes.values())) > 1:
            got = ", ".join(f"{column} {size}" for column, size in sizes.items())
            raise RecordError(f"record '{self.name}': columns differ in length ({got}); give one value each per sample")
        if len(self) < 2:
            raise RecordError(
                f"record '{self.name}': {counted(len(self), 'sample')}, at least 2 are needed; check the row range"
            )
        for column, unit in _COLUMNS.items():
            refuse_not_finite(getattr(self, column), column, unit, self.name)
            refuse_implausible(getattr(self, column), column, unit, self.name)
        refuse_not_rising(self.time, self.name)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        (v0, v1), (y0, y1) = self.voltage_range, self.displacement_range
        return (
            f"<Record '{escaped(self.name)}': {len(self)} samples, {self.time[-1] - self.time[0]:.6g} s, "
            f"{v0:.4g} to {v1:.4g} V, {y0 * 1e6:.6g} to {y1 * 1e6:.6g} um>"
        )

    def _repr_html_(self) -> str:
        (v0, v1), (y0, y1) = self.voltage_range, self.displacement_range
        rows = [
            ("samples", len(self)),
            ("time", f"{self.time[-1] - self.time[0]:.6g} s, every {self.sample_time:.4g} s"),
            ("voltage", f"{v0:.4g} to {v1:.4g} V"),
            ("displacement", f"{y0 * 1e6:.6g} to {y1 * 1e6:.6g} µm"),
        ]
        return html.block(f"Record '{self.name}'", html.facts(rows), html.folded("Problems", self.problems()))

    def __getitem__(self, span: Span) -> Record:
        if not isinstance(span, slice) or span.step not in (None, 1):
            raise RecordError(
                f"record '{self.name}': got [{span!r}]; a record takes slices of step 1, try record[10:200]"
            )
        return self.slice(span.start, span.stop)

    @classmethod
    def from_arrays(
        cls,
        time: ArrayLike,
        voltage: ArrayLike,
        displacement: ArrayLike,
        *,
        units: str = "um",
        name: str = "record",
    ) -> Record:
        """Make a record from arrays whose displacement is in `units`, by default micrometres.

        Parameters
        ----------
        time, voltage : (n,) array_like
            [s] and [V].
        displacement : (n,) array_like
            In `units`; quantities with units of their own are converted.
        units : str
            "m", "mm", "um", "nm" or "pm".
        name : str

        Raises
        ------
        RecordError
            If the unit is not known, or the arrays make no record.
        """
        counts = per_metre(units, error=RecordError)
        try:
            lengths = np.asarray(plain(displacement, "displacement", units, error=RecordError), dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise RecordError(f"record '{name}': displacement is no array of numbers ({error})") from error
        return cls(time, voltage, lengths / counts, name)  # type: ignore[arg-type]

    @classmethod
    def from_dataframe(
        cls,
        frame: DataFrame,
        *,
        time: str | None = None,
        voltage: str | None = None,
        displacement: str | None = None,
        name: str | None = None,
    ) -> Record:
        """Make a record from a pandas DataFrame, whose columns are found as those of a file are.

        Parameters
        ----------
        frame : pandas.DataFrame
            With units in the names of its columns, such as those of `to_dataframe`; an index with a name counts as a
            column. Dates and durations are seconds.
        time, voltage, displacement : str, optional
            Columns, as in `dehyst.read`: "NAME" or "NAME:UNIT".
        name : str, optional
            The record's name; default: that of `DataFrame.attrs`, else "record".

        Raises
        ------
        FileFormatError
            If a column is missing or has no unit.
        RecordError
            If it is no DataFrame, or the columns make no record.
        """
        found = Table("DataFrame", "", tuple(without_groups(Column(*column)) for column in tables.columns_of(frame)))
        chosen = {"time": time, "voltage": voltage, "displacement": displacement}
        numbers = {quantity: found.column(quantity, wanted) for quantity, wanted in chosen.items()}
        return cls(name=name or str(frame.attrs.get("name", "record")), **numbers)  # type: ignore[arg-type]

    @classmethod
    def from_xarray(cls, dataset: Dataset, *, name: str | None = None) -> Record:
        """Make a record from an xarray `dataset` with the variables time, voltage and displacement.

        Attributes `units` are converted: "um", "ms", "kV" and the like. Without one, values are in s, V and m. `name`:
        the record's; default: that of the attributes, else "record".

        Raise `RecordError` if a variable is missing, has another unit, or they make no record.
        """
        numbers = {column: tables.variable(dataset, column) for column in _COLUMNS}
        return cls(**numbers, name=name or str(dataset.attrs.get("name", "record")))

    def to_dataframe(self) -> DataFrame:
        """Return the columns time_s, voltage_V and displacement_um as a pandas DataFrame.

        Raise `MissingExtraError` if pandas is not installed.
        """
        columns = {"time_s": self.time, "voltage_V": self.voltage, "displacement_um": self.displacement * 1e6}
        return tables.frame(columns, name=self.name)

    def to_xarray(self, units: str = "um") -> Dataset:
        """Return voltage [V] and displacement over time [s] as an xarray Dataset, with their units as attributes.

        `units`: of the displacement. Raise `MissingExtraError` if xarray is not installed.
        """
        lengths = self.displacement * per_metre(units, error=RecordError)
        variables = {"voltage": (self.voltage, "V"), "displacement": (lengths, units)}
        return tables.dataset(self.time, variables, name=self.name)

    def plot(self, kind: Literal["loop", "time"] = "loop", *, ax: Axes | None = None) -> Axes:
        """Draw the record: displacement over voltage ("loop"), or both over time ("time").

        `kind`: which picture. `ax`: where to draw; default: the axes of a new figure. Return the axes. Raise
        `MissingExtraError` if matplotlib is not installed.
        """
        return plotted("record", self, kind, ax)

    @property
    def sample_time(self) -> float:
        """Median time from one sample to the next [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def voltage_range(self) -> tuple[float, float]:
        """Lowest and highest voltage [V]."""
        return float(self.voltage.min()), float(self.voltage.max())

    @property
    def displacement_range(self) -> tuple[float, float]:
        """Lowest and highest displacement [m]."""
        return float(self.displacement.min()), float(self.displacement.max())

    @property
    def stroke(self) -> float:
        """Displacement peak to peak [m]."""
        return float(np.ptp(self.displacement))

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's white noise [m]."""
        return white_noise(self.displacement)

    def gaps(self) -> list[tuple[int, float]]:
        """Return the places of missing samples: index i and time[i + 1] - time[i] [s], if above 1.5 sample times."""
        steps = np.diff(self.time)
        return [(int(i), float(steps[i])) for i in np.flatnonzero(steps > 1.5 * np.median(steps))]

    def reversals(self, signal: str = "voltage", band: float | None = None) -> NDArray[np.intp]:
        """Find the turning points of a `signal`, "voltage" or "displacement", by a hysteresis band.

        `band`: way back [V or m] after which an extreme counts as a turning point; by default the larger of 2 % of the
        signal's range and the range of its noise: 6 standard deviations, more in a long record.

        Returns
        -------
        (k,) int array
            The extremes themselves (the last sample of a plateau), minima and maxima in turn; never the record's ends.

        Raises
        ------
        RecordError
            Unknown signal; band negative or not finite.
        """
        if signal not in ("voltage", "displacement"):
            raise RecordError(f"record '{self.name}': no signal '{signal}'; try 'voltage' or 'displacement'")
        values: Array = getattr(self, signal)
        if band is None:
            band = max(0.02 * float(np.ptp(values)), noise_span(values))
        if not (isfinite(band) and band >= 0.0):
            raise RecordError(f"record '{self.name}': band is {band}; give a number >= 0 in the signal's unit")
        return turning_points(values, band)

    def cycles(self, band: float | None = None) -> list[Span]:
        """Return the full cycles between successive voltage minima, or maxima if these give more.

        The record's start and end count as extremes when their leg covers 0.9 of the leg next to it, so that one
        excursion up and down is one cycle. A slice includes both its turning points: neighbours share one sample.
        `band` [V] is the smallest change of voltage that counts as a turn; default: by the range and the noise.
        """
        turns = self.reversals("voltage", band)
        if not len(turns):
            return []
        before, after = outer_extreme(self.voltage[turns[0] :: -1]), outer_extreme(self.voltage[turns[-1] :])
        points = np.concatenate(([turns[0] - before], turns, [turns[-1] + after]))
        legs = np.abs(np.diff(self.voltage[points]))
        points = points[int(legs[0] < 0.9 * legs[1]) : len(points) - int(legs[-1] < 0.9 * legs[-2])]
        # An odd number has one more of the outer kind; otherwise there are as many minima as maxima, and minima count.
        first = int(len(points) % 2 == 0 and self.voltage[points[0]] > self.voltage[points[1]])
        ends = points[first::2]
        return [slice(int(a), int(b) + 1) for a, b in pairwise(ends)]

    def slice(self, start: int | None, stop: int | None) -> Record:
        """Return samples `start` to `stop` - 1, counted as Python slices are."""
        rows = slice(start, stop)
        return replace(self, time=self.time[rows], voltage=self.voltage[rows], displacement=self.displacement[rows])

    def between(self, t0: float, t1: float) -> Record:
        """Return the samples with `t0` <= time <= `t1` [s]."""
        return self.slice(int(np.searchsorted(self.time, t0)), int(np.searchsorted(self.time, t1, side="right")))

    def with_name(self, name: str) -> Record:
        """Return the same record under another `name`."""
        return replace(self, name=name)

    def resample(self, dt: float, kind: str = "linear") -> Record:
        """Resample on a uniform grid of step `dt` [s] from the first sample; `kind` is "linear" or "pchip"."""
        span = float(self.time[-1] - self.time[0])
        if not 0.0 < dt <= span:
            raise RecordError(
                f"record '{self.name}': dt is {dt} s; give a step above 0 and at most the record's {span:.6g} s"
            )
        if kind not in ("linear", "pchip"):
            raise RecordError(f"record '{self.name}': no interpolation '{kind}'; try 'linear' or 'pchip'")
        grid = np.minimum(self.time[0] + dt * np.arange(int(span / dt + 1e-9) + 1), self.time[-1])
        v = interpolate(self.time, self.voltage, grid, kind)
        return replace(self, time=grid, voltage=v, displacement=interpolate(self.time, self.displacement, grid, kind))

    def delayed(self, delay: float) -> Record:
        """Return the record with voltage(t - `delay`), delay in s: shape-preserving, constant beyond the ends."""
        if not isfinite(delay):
            raise RecordError(f"record '{self.name}': delay is {delay} s; give a finite number of seconds")
        times = np.clip(self.time - delay, self.time[0], self.time[-1])
        return replace(self, voltage=interpolate(self.time, self.voltage, times, "pchip"))

    def problems(self) -> tuple[str, ...]:
        """Return sentences about everything suspicious that does not prevent the record's use; empty if nothing is."""
        return problems(self)

    def check_usable(self, min_samples: int = 20, min_cycles: int = 1) -> None:
        """Refuse a record from which no hysteresis loop can be identified.

        `min_samples`, `min_cycles`: least number of samples and of full voltage cycles.

        Raises
        ------
        RecordError
            Too few samples or cycles, constant voltage or displacement, inverted or clipped sensor, swapped columns.
        """
        refuse_unusable(self, min_samples, min_cycles)


def _frozen_column(raw: object, column: str, name: str) -> Array:
    try:
        bare = plain(raw, column)
    except ModelError as error:
        raise RecordError(f"record '{name}': {error}") from error
    try:
        values = bare if _is_frozen(bare) else np.array(bare, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise RecordError(f"record '{name}': {column} is no array of numbers ({error}); give (n,) floats") from error
    if values.ndim != 1:
        raise RecordError(f"record '{name}': {column} has shape {values.shape}; give one dimension, try .ravel()")
    values.flags.writeable = False
    return values


def _is_frozen(raw: object) -> TypeGuard[Array]:
    """Return whether an array is read-only, as another record's: then a slice of a long record needs no copy."""
    if not isinstance(raw, np.ndarray) or raw.dtype != np.float64 or raw.flags.writeable:
        return False
    return raw.base is None or (isinstance(raw.base, np.ndarray) and not raw.base.flags.writeable)
