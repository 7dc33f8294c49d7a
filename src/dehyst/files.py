"""Files that hold measurements: text, MAT, HDF5, Parquet, TDMS and NPZ are read, CSV is written."""

from __future__ import annotations

import csv
import hashlib
import importlib
import io
import os
import re
import secrets
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ._errors import DehystError, FileFormatError, MissingExtraError
from .record import FloatArray, Record

PathLike: TypeAlias = str | os.PathLike[str]

_UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60},
    "voltage": {"V": 1, "mV": 1e-3, "kV": 1e3},
    "displacement": {"m": 1, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "nm": 1e-9, "pm": 1e-12},
}
_WORDS = {
    "time": ("time", "t"),
    "voltage": ("voltage", "v", "drive"),
    "displacement": ("displacement", "position", "y", "pos"),
}
_EXAMPLES = {"time": "time_s", "voltage": "voltage_V", "displacement": "displacement_um"}
_TEXT = (".csv", ".tsv", ".txt", ".dat")


@dataclass(frozen=True, eq=False, slots=True)
class Column:
    """One named column: data (n,), the unit if the file states one apart from the name, why it is not numeric if so."""

    name: str
    data: FloatArray
    unit: str = ""
    fault: str = ""

    @property
    def leaf(self) -> str:
        """The name without the groups it lies in."""
        return self.name.rsplit("/", 1)[-1]

    @property
    def parts(self) -> tuple[str, str]:
        """What the column says it is, and its unit: ('drive', 'V') of 'drive_V' or 'drive [V]'."""
        if match := re.fullmatch(r"\s*(.*?)[\s_]*[\[(]\s*(.*?)\s*[\])]\s*", self.leaf):
            word, unit = match[1], match[2]
        else:
            word, _, unit = self.leaf.rpartition("_") if "_" in self.leaf else (self.leaf, "", "")
        known = any(self.unit in units for units in _UNITS.values())
        return word.strip(), self.unit if known or not unit else unit.strip()


@dataclass(frozen=True, eq=False, slots=True)
class Table:
    """The columns of one file, still in the file's units."""

    source: str
    sha256: str
    columns: tuple[Column, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Column names as the file has them, with their groups."""
        return tuple(column.name for column in self.columns)

    def has(self, quantity: str) -> bool:
        """Tell whether exactly one column is the `quantity` by its name and unit."""
        return len(self._candidates(quantity)) == 1

    def column(self, quantity: str, wanted: str | None = None) -> FloatArray:
        """Return one column in SI units.

        Parameters
        ----------
        quantity : {"time", "voltage", "displacement"}
        wanted : str, optional
            Name, unique last part of the name, or "name:unit"; by default the one column named like the quantity.

        Returns
        -------
        (n,) float array
            Seconds, volts or metres.

        Raises
        ------
        FileFormatError
            No such column, several of them, an unknown unit, or cells that are no numbers.
        """
        found, unit = self.find(quantity, wanted)
        factor = _UNITS[quantity].get(unit)
        if factor is None:
            said = f"the unit '{unit}', unknown for {quantity}" if unit else "no unit"
            raise FileFormatError(
                f"{self.source}: column '{found.name}' has {said}; known are {', '.join(_UNITS[quantity])}. Name it "
                f"like '{_EXAMPLES[quantity]}' or '{_EXAMPLES[quantity].replace('_', ' [')}]', or give "
                f"{_option(quantity, found.name + ':' + _EXAMPLES[quantity].rsplit('_')[-1])}"
            )
        if found.fault:
            raise FileFormatError(f"{self.source}: column '{found.name}': {found.fault}; correct or remove that row")
        # Dividing by 1e6 rounds once, multiplying by 1e-6 twice.
        return found.data * factor if factor >= 1 else found.data / round(1 / factor)

    def find(self, quantity: str, wanted: str | None = None) -> tuple[Column, str]:
        """Return the column that `column` would take, and its unit."""
        unit = ""
        fits = self._candidates(quantity) if wanted is None else self._named(wanted)
        if wanted is not None and not fits and ":" in wanted:
            name, unit = (part.strip() for part in wanted.rsplit(":", 1))
            fits = self._named(name)
        if len(fits) == 1:
            return fits[0], unit or fits[0].parts[1]
        asked = f"column '{wanted}' for {quantity}" if wanted is not None else f"{quantity} column"
        count = f"{len(fits)} columns fit: {_listed(tuple(c.name for c in fits))}" if fits else f"no {asked}"
        hint = f" A name like '{_EXAMPLES[quantity]}' is found by itself." if wanted is None else ""
        rate = " Without one, give sample_rate= in Hz." if quantity == "time" else ""
        raise FileFormatError(
            f"{self.source}: {count}{f' as {asked}' if fits else ''}; the file holds {_listed(self.names)}. "
            f"Say which with {_option(quantity, 'NAME')}.{hint}{rate}"
        )

    def _candidates(self, quantity: str) -> list[Column]:
        fits = [c for c in self.columns if {c.leaf.lower(), c.parts[0].lower()} & set(_WORDS[quantity])]
        return [c for c in fits if c.parts[1] in _UNITS[quantity]] or fits

    def _named(self, name: str) -> list[Column]:
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        return exact or leaf or [c for c in self.columns if c.parts[0] == name]


def read(
    path: PathLike,
    *,
    time: str | None = None,
    voltage: str | None = None,
    displacement: str | None = None,
    sample_rate: float | None = None,
    name: str | None = None,
) -> Record:
    """Read a record from a file whose kind follows from its suffix.

    Parameters
    ----------
    path : path
        .csv .tsv .txt .dat .mat .h5 .hdf5 .parquet .tdms or .npz.
    time, voltage, displacement : str, optional
        Columns, see `Table.column`.
    sample_rate : float, optional
        Samples a second [Hz], for a file without a time column.
    name : str, optional
        The record's name; by default the file's, without suffix.

    Raises
    ------
    FileFormatError
        The file or a column cannot be read, or both a time column and a sample rate are there.
    RecordError
        The columns make no record.
    MissingExtraError
        The library for this kind of file is not installed.
    """
    table = read_table(path)
    v, y = table.column("voltage", voltage), table.column("displacement", displacement)
    meta: dict[str, Any] = {"source": table.source, "sha256": table.sha256}
    meta["columns"] = {"voltage": table.find("voltage", voltage)[0].name}
    meta["columns"]["displacement"] = table.find("displacement", displacement)[0].name
    meta["columns"]["time"] = (
        table.find("time", time)[0].name if sample_rate is None else f"index / {sample_rate:.9g} Hz"
    )
    return Record(time_of(table, len(v), time, sample_rate), v, y, name or Path(path).stem, meta)


def time_of(table: Table, samples: int, wanted: str | None, sample_rate: float | None) -> FloatArray:
    """Return the time [s] of each sample: the table's column, or the index over the sample rate [Hz]."""
    if sample_rate is None:
        return table.column("time", wanted)
    if wanted is not None or (table.has("time") and table.find("time")[1] in _UNITS["time"]):
        which = wanted or table.find("time")[0].name
        raise FileFormatError(f"{table.source}: got sample_rate= and the time column '{which}'; leave one of them out")
    if not 0 < sample_rate < float("inf"):
        raise FileFormatError(f"{table.source}: sample_rate is {sample_rate} Hz; give a number above 0")
    return np.arange(samples) / sample_rate


def read_table(path: PathLike) -> Table:
    """Read all numeric columns of a file whose kind follows from its suffix; raises as `read` does."""
    path = Path(path)
    load = _LOADERS.get(path.suffix.lower())
    if load is None:
        raise FileFormatError(f"{path}: unknown kind of file '{path.suffix}'; dehyst reads {' '.join(_LOADERS)}")
    try:
        if path.stat().st_size == 0 and path.is_file():
            raise FileFormatError(f"{path}: the file is empty; export the measurement again")
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        columns = tuple(load(path))
    except DehystError:
        raise
    except FileNotFoundError as error:
        raise FileFormatError(f"{path}: no such file; check the name and the folder") from error
    except IsADirectoryError as error:
        raise FileFormatError(f"{path}: this is a folder; give one of the files in it") from error
    except PermissionError as error:
        raise FileFormatError(f"{path}: no permission to read it; check the file's mode") from error
    except Exception as error:  # every library has its own errors for broken content
        raise FileFormatError(
            f"{path}: not a readable {path.suffix} file ({type(error).__name__}: {error}); check that the suffix fits"
        ) from error
    if not columns:
        raise FileFormatError(f"{path}: no numeric columns found; store time, voltage and displacement as 1-D arrays")
    return Table(path.name, digest, columns)


def write_record(path: PathLike, record: Record) -> None:
    """Write a record as CSV with the columns time_s, voltage_V and displacement_um, at full precision."""
    columns = {"time_s": record.time, "voltage_V": record.voltage, "displacement_um": record.displacement * 1e6}
    write_columns(path, columns)


def write_columns(path: PathLike, columns: Mapping[str, ArrayLike]) -> None:
    """Write named (n,) arrays as CSV, at full precision; raises FileFormatError for other suffixes or lengths."""
    if Path(path).suffix.lower() not in _TEXT:
        raise FileFormatError(f"{path}: dehyst writes text only; try the suffix .csv")
    if any(set(name) & set(',;\t\n"') for name in columns):
        raise FileFormatError(
            f"{path}: column names {_listed(tuple(columns))} hold a separator or a quote; rename them"
        )
    arrays = [np.asarray(values, dtype=np.float64) for values in columns.values()]
    if not arrays or any(array.ndim != 1 or array.shape != arrays[0].shape for array in arrays):
        shapes = ", ".join(f"{name} {array.shape}" for name, array in zip(columns, arrays, strict=True))
        raise FileFormatError(f"{path}: columns must be one-dimensional and of one length, got {shapes or 'none'}")
    delimiter = "\t" if Path(path).suffix.lower() == ".tsv" else ","
    rows = zip(*(map(repr, array.tolist()) for array in arrays), strict=True)
    write_atomically(path, "\n".join([delimiter.join(columns), *map(delimiter.join, rows), ""]))


def write_atomically(path: PathLike, data: str | bytes) -> None:
    """Write a file wholly or not at all: under another name in its folder first, then renamed.

    Raises
    ------
    FileFormatError
        The folder is missing or not writable, or the path is a folder.
    """
    # A link keeps pointing at its file, and a device such as /dev/null is written to, never replaced.
    target = Path(os.path.realpath(path))
    content = data.encode() if isinstance(data, str) else data
    if target.is_dir():
        raise FileFormatError(f"{path}: this is a folder; add a file name")
    if not target.parent.is_dir():
        raise FileFormatError(f"{path}: the folder {Path(path).parent} does not exist; create it first")
    special = target.exists() and not target.is_file()
    draft = target if special else target.with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        draft.write_bytes(content)
        if not special:
            draft.replace(target)
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be written ({error.strerror}); check the folder's rights") from error
    finally:
        if not special:
            draft.unlink(missing_ok=True)


def _option(quantity: str, value: str) -> str:
    return f'{quantity}="{value}" (on the command line --{quantity} "{value}")'


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f"'{name}'" for name in names[:20]) + (f" and {len(names) - 20} more" if len(names) > 20 else "")


def _library(module: str, purpose: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError.of(module.split(".", maxsplit=1)[0], "files", purpose) from error


def _read_text(path: Path) -> list[Column]:
    text, encoding = _decoded(path)
    start, first, header = _header(text, path)
    delimiter = next((d for d in ";\t," if d in re.sub(r'"[^"]*"', "", header)), None)
    names = _cells(re.sub(r"\s+(?=[\[(])", "", header) if delimiter is None else header, delimiter)
    if len(names) > 1 and not names[-1]:
        names.pop()
    if all(_is_number(name.replace(",", ".") if delimiter != "," else name) for name in names):
        raise FileFormatError(
            f"{path}: line {first} is '{header.strip()[:60]}', but a header line with names and units is needed first, "
            "not behind a # or %; try time_s,voltage_V,displacement_um"
        )
    body = text[start:]
    decimal_comma = delimiter in (";", "\t") and "," in body
    if decimal_comma:
        body = body.replace(",", ".")
    plain = not decimal_comma and "%" not in body
    source: Path | io.StringIO = path if plain else io.StringIO(re.sub(r"(?m)^\s*%", "#", body))
    try:
        with warnings.catch_warnings(action="ignore"):
            skipped = first if plain else 0
            data = np.loadtxt(source, delimiter=delimiter, skiprows=skipped, encoding=encoding, ndmin=2)
    except ValueError:
        data = np.empty((0, 0))
    if data.shape[1] == len(names) and len(data):
        return [Column(name, column) for name, column in zip(names, data.T.copy(), strict=True)]
    return _read_rows(body, first, names, delimiter, path)


def _decoded(path: Path) -> tuple[str, str]:
    raw = path.read_bytes()
    if b"\0" in raw:
        raise FileFormatError(
            f"{path}: not a text file (it holds NUL bytes); save it as UTF-8 text or correct its suffix"
        )
    try:
        text, encoding = raw.decode("utf-8-sig"), "utf-8-sig"
    except UnicodeDecodeError:
        text, encoding = raw.decode("latin-1"), "latin-1"  # instruments write the micro sign so
    return text.replace("\r\n", "\n").replace("\r", "\n") if "\r" in text else text, encoding


def _header(text: str, path: Path) -> tuple[int, int, str]:
    """Return where the rows start, the header's line number and the header."""
    start = number = 0
    while start < len(text):
        end = text.find("\n", start)
        end, begin, number = (len(text) if end < 0 else end), start, number + 1
        start, line = end + 1, text[begin:end]
        if line.strip() and line.lstrip()[0] not in "#%":
            return start, number, line
    raise FileFormatError(f"{path}: nothing but blank and comment lines; a header line and rows are needed")


def _cells(line: str, delimiter: str | None) -> list[str]:
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [
        cell.strip() for cell in next(csv.reader([line.strip(" ")], delimiter=delimiter or " ", skipinitialspace=True))
    ]


def _is_number(cell: str) -> bool:
    try:
        float(cell or "nan")
    except ValueError:
        return False
    return True


def _read_rows(body: str, first: int, names: list[str], delimiter: str | None, path: Path) -> list[Column]:
    """Read row by row: slow, but it knows the line of what is wrong and lets text columns be."""
    rows, lines = [], []
    for number, line in enumerate(body.split("\n"), first + 1):
        if not line.strip(f"{delimiter or ''} \t") or line.lstrip()[0] in "#%":
            continue
        cells = _cells(line, delimiter)
        if len(cells) == len(names) + 1 and not cells[-1]:
            cells.pop()
        if len(cells) != len(names):
            raise FileFormatError(
                f"{path}: line {number} has {len(cells)} cells where the header has {len(names)}: '{line.strip()[:60]}'"
                "; correct or remove that line"
            )
        rows.append(cells)
        lines.append(number)
    if not rows:
        raise FileFormatError(f"{path}: a header but no rows; export the measurement again")
    return [_column(name, cells, lines) for name, cells in zip(names, zip(*rows, strict=True), strict=True)]


def _column(name: str, cells: tuple[str, ...], lines: list[int]) -> Column:
    try:
        return Column(name, np.array([float(cell or "nan") for cell in cells]))
    except ValueError:
        line, cell = next(pair for pair in zip(lines, cells, strict=True) if not _is_number(pair[1]))
        return Column(name, np.empty(0), fault=f"line {line} holds '{cell}', which is no number")


def _vectors(items: Mapping[str, Any]) -> list[Column]:
    """Keep the real numeric arrays that are 1-D, or 2-D with one row or column, as MATLAB has them."""
    arrays = {name: np.asarray(values) for name, values in items.items() if not name.startswith("__")}
    return [
        Column(name, array.ravel().astype(np.float64))
        for name, array in arrays.items()
        if array.dtype.kind in "fiu" and array.size > 1 and array.size == max(array.shape)
    ]


def _read_mat(path: Path) -> list[Column]:
    from scipy.io import loadmat

    try:
        return _vectors(loadmat(path))
    except NotImplementedError:  # version 7.3 is HDF5
        return _read_hdf5(path)


def _read_hdf5(path: Path) -> list[Column]:
    h5py = _library("h5py", f"Reading {path.suffix} files")
    columns: list[Column] = []

    def visit(name: str, node: Any) -> None:
        if isinstance(node, h5py.Dataset) and not name.startswith("#"):
            unit = node.attrs.get("unit", node.attrs.get("units", ""))
            text = unit.decode() if isinstance(unit, bytes) else str(unit)
            columns.extend(Column(name, c.data, text.strip()) for c in _vectors({"x": node[()]}))

    with h5py.File(path, "r") as file:
        file.visititems(visit)
    return columns


def _read_parquet(path: Path) -> list[Column]:
    table = _library("pyarrow.parquet", "Reading Parquet files").read_table(path)
    return _vectors({name: table[name].to_numpy() for name in table.column_names})


def _read_tdms(path: Path) -> list[Column]:
    file = _library("nptdms", "Reading TDMS files").TdmsFile.read(path)
    columns = []
    for group in file.groups():
        for channel in group.channels():
            unit = str(channel.properties.get("unit_string", "")).strip()
            columns += [Column(f"{group.name}/{channel.name}", c.data, unit) for c in _vectors({"x": channel[:]})]
    return columns


def _read_npz(path: Path) -> list[Column]:
    with np.load(path, allow_pickle=False) as archive:
        return _vectors({name: archive[name] for name in archive.files})


_LOADERS: dict[str, Callable[[Path], list[Column]]] = {
    **dict.fromkeys(_TEXT, _read_text),
    ".mat": _read_mat,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".parquet": _read_parquet,
    ".tdms": _read_tdms,
    ".npz": _read_npz,
}
