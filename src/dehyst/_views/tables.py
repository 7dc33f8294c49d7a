"""The only door to pandas and xarray: columns to tables that these libraries understand, and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dehyst._errors import RecordError, library
from dehyst._text import escaped
from dehyst._types import Array

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


def frame(columns: Mapping[str, Any], **attributes: Any) -> DataFrame:
    """Return columns as a DataFrame with these attributes (`DataFrame.attrs`); arrays are copied.

    Raise `MissingExtraError` if pandas is not installed.
    """
    pandas = library("pandas", "A DataFrame", "tables")
    made = pandas.DataFrame({name: np.array(values) for name, values in columns.items()})
    made.attrs.update(attributes)
    return made


def dataset(time: Array, variables: Mapping[str, tuple[Array, dict[str, str]]], **attributes: Any) -> Dataset:
    """Return variables over time [s] as an xarray Dataset; each is an array and its attributes, such as `units`.

    Raise `MissingExtraError` if xarray is not installed.
    """
    xarray = library("xarray", "A Dataset", "tables")
    arrays = {name: ("time", np.array(values), own) for name, (values, own) in variables.items()}
    coordinates = {"time": ("time", np.array(time), {"units": "s"})}
    made: Dataset = xarray.Dataset(arrays, coords=coordinates, attrs=attributes)
    return made


class TableColumn(NamedTuple):
    """A column of a DataFrame: `data` (n,), in `unit` if it is known; `foreign` if any other column of time counts."""

    name: str
    data: Array
    unit: str = ""
    foreign: bool = False


def columns_of(table: Any) -> list[TableColumn]:
    """Return the numeric columns of a DataFrame, its index too if that has a name or holds dates or durations.

    Dates and durations become seconds; other columns have no unit beside their name.
    """
    if not hasattr(table, "columns") or not hasattr(table, "index"):
        raise RecordError(f"frame: got {type(table).__name__}, need a DataFrame; or try dehyst.Record.from_arrays")
    rows = table if table.index.name is None else table.reset_index()
    found = [_column(str(name), rows[name]) for name in rows.columns]
    if table.index.name is None and getattr(table.index.dtype, "kind", "") in "mM":
        found.append(_column("time", table.index.to_series())._replace(foreign=True))
    return [column for column in found if column.data.dtype.kind == "f"]


def _column(name: str, values: Any) -> TableColumn:
    """Return a Series as a column; with its own data if these are no numbers."""
    # A time zone makes objects of dates.
    zoned = getattr(values.dtype, "tz", None) is not None
    data = np.asarray(values.dt.tz_convert(None) if zoned else values)
    if data.dtype.kind not in "iufmM":
        return TableColumn(name, data)
    return TableColumn(name, np.asarray(seconds(data), dtype=np.float64), "s" if data.dtype.kind in "mM" else "")


def variable(container: Any, name: str) -> Any:
    """Return a variable of an xarray Dataset, with its unit; raise `RecordError` if there is none of that name."""
    try:
        found = container[name]
    except (KeyError, TypeError, IndexError) as error:
        known = ", ".join(f"'{escaped(one)}'" for one in getattr(container, "variables", ()))
        raise RecordError(
            argument="dataset",
            got=f"no variable '{name}'",
            need="one",
            hint=f"it holds {known or 'none'}. Rename yours with .rename(name='{name}')",
        ) from error
    return seconds(found.values) if found.values.dtype.kind in "mM" else found


def further_variables(container: Any, but: Iterable[str]) -> dict[str, tuple[Any, Mapping[str, Any]]]:
    """Return the variables of numbers in one dimension, but for those named, with their attributes."""
    found = getattr(container, "data_vars", {})
    return {
        str(name): (variable.values, variable.attrs)
        for name, variable in found.items()
        if name not in but and variable.ndim == 1 and variable.dtype.kind in "iuf"
    }


def seconds(values: Any) -> Any:
    """Return dates and durations as seconds since the first; anything else as it is."""
    kind = values.dtype.kind
    if kind not in "mM" or not values.size:
        return values
    elapsed = values - values[0] if kind == "M" else values
    return elapsed / np.timedelta64(1, "s")
