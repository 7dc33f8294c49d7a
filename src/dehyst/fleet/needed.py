"""The libraries of the extra `fleet`, imported when they are used; without one, an error names the extra."""

from __future__ import annotations

from typing import Any

from dehyst.records.formats.containers import library


def pyarrow() -> Any:
    """Return pyarrow."""
    return library("pyarrow", "A table of a fleet", "fleet")


def pyarrow_parquet() -> Any:
    """Return pyarrow.parquet."""
    return library("pyarrow.parquet", "A Parquet dataset or a table of a fleet", "fleet")


def zarr() -> Any:
    """Return zarr."""
    return library("zarr", "A Zarr dataset", "fleet")


def distributed() -> Any:
    """Return Dask's scheduler library."""
    return library("distributed", "--dask", "fleet")
