"""The only interface to pandas and xarray: conversion of columns to their tables, and back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import RecordError, library
from dehyst._text import escaped
from dehyst._types import Array

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset


def frame(columns: Mapping[str, Any], **attributes: Any) -> DataFrame:
    """Return columns as a DataFrame with given attributes (`DataFrame.attrs`); arrays are copied.

    Raise `MissingExtraError` if pandas is not installed.
    """
    pandas = library("pandas", "A DataFrame", "tables")
    made = pandas.DataFrame({name: np.array(values) for name, values in columns.items()})
    made.attrs.update(attributes)
    return made


def dataset(time: Array, variables: Mapping[str, tuple[Array, dict[str, str]]], **attributes: Any) -> Dataset:
    """Return variables over time [s] as an xarray Dataset; each variable is an array with attributes such as `units`.

    Raise `MissingExtraError` if xarray is not installed.
    """
    xarray = library("xarray", "A Dataset", "tables")
    arrays = {name: ("time", np.array(values), own) for name, (values, own) in variables.items()}
    coordinates = {"time": ("time", np.array(time), {"units": "s"})}
    made: Dataset = xarray.Dataset(arrays, coords=coordinates, attrs=attributes)
    return made


def columns_of(table: Any) -> Iterator[tuple[str, Array, str, bool]]:
    """Yield name, data (n,) and unit of the numeric columns of a DataFrame, and whether other times have priority.

    Dates and durations become seconds; other columns have no unit besides their name. An index is used if it has a
    name, or if it holds dates or durations. In the second case it is the time if there is no other time.
    """
    if not hasattr(table, "columns") or not hasattr(table, "index"):
        raise RecordError(f"frame: got {type(table).__name__}, need a DataFrame; or try dehyst.Record.from_arrays")
    rows = table if table.index.name is None else table.reset_index()
    series = [(str(name), rows[name], False) for name in rows.columns]
    if table.index.name is None and getattr(table.index.dtype, "kind", "") in "mM":
        series.append(("time", table.index.to_series(), True))
    for name, values, foreign in series:
        # A time zone makes objects of dates.
        zoned = getattr(values.dtype, "tz", None) is not None
        data = np.asarray(values.dt.tz_convert(None) if zoned else values)
        kind = data.dtype.kind
        if kind in "iufmM":
            yield name, np.asarray(seconds(data), dtype=np.float64), "s" if kind in "mM" else "", foreign


def variable(container: Any, name: str) -> Any:
    """Return a variable of an xarray Dataset with its unit; raise `RecordError` if this name is missing."""
    try:
        found = container[name]
    except (KeyError, TypeError, IndexError) as error:
        known = ", ".join(f"'{escaped(one)}'" for one in getattr(container, "variables", ()))
        got, hint = f"no variable '{name}'", f"it holds {known or 'none'}. Rename yours with .rename(name='{name}')"
        raise RecordError(argument="dataset", got=got, need="one", hint=hint) from error
    return seconds(found.values) if found.values.dtype.kind in "mM" else found


def further_variables(container: Any, but: Iterable[str]) -> dict[str, tuple[Any, Mapping[str, Any]]]:
    """Return the one-dimensional numeric variables, except the named ones, with their attributes."""
    found = getattr(container, "data_vars", {})
    return {
        str(name): (variable.values, variable.attrs)
        for name, variable in found.items()
        if name not in but and variable.ndim == 1 and variable.dtype.kind in "iuf"
    }


def seconds(values: Any) -> Any:
    """Return dates and durations as seconds since the first one; anything else unchanged."""
    kind = values.dtype.kind
    if kind not in "mM" or not values.size:
        return values
    elapsed = values - values[0] if kind == "M" else values
    return elapsed / np.timedelta64(1, "s")
