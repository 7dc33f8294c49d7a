"""The formats: bytes on disk to a `Table` of columns, with the units that the file states."""

from __future__ import annotations

import csv
import importlib
import io
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError, MissingExtraError
from dehyst.signals import FloatArray

UNITS: dict[str, dict[str, float]] = {
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
TEXT = (".csv", ".tsv", ".txt", ".dat")


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
        known = any(self.unit in units for units in UNITS.values())
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
        factor = UNITS[quantity].get(unit)
        if factor is None:
            said = f"the unit '{unit}', unknown for {quantity}" if unit else "no unit"
            raise FileFormatError(
                f"{self.source}: column '{found.name}' has {said}; known are {', '.join(UNITS[quantity])}. Name it "
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
        count = f"{len(fits)} columns fit: {listed(tuple(c.name for c in fits))}" if fits else f"no {asked}"
        hint = f" A name like '{_EXAMPLES[quantity]}' is found by itself." if wanted is None else ""
        rate = " Without one, give sample_rate= in Hz." if quantity == "time" else ""
        raise FileFormatError(
            f"{self.source}: {count}{f' as {asked}' if fits else ''}; the file holds {listed(self.names)}. "
            f"Say which with {_option(quantity, 'NAME')}.{hint}{rate}"
        )

    def _candidates(self, quantity: str) -> list[Column]:
        fits = [c for c in self.columns if {c.leaf.lower(), c.parts[0].lower()} & set(_WORDS[quantity])]
        return [c for c in fits if c.parts[1] in UNITS[quantity]] or fits

    def _named(self, name: str) -> list[Column]:
        name = name.strip().strip("/")
        exact = [c for c in self.columns if c.name == name]
        leaf = [c for c in self.columns if c.leaf == name]
        return exact or leaf or [c for c in self.columns if c.parts[0] == name]


def _option(quantity: str, value: str) -> str:
    return f'{quantity}="{value}"'


def listed(names: tuple[str, ...]) -> str:
    """Quote names for a message, the first twenty of them."""
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
    columns: list[Column] = []
    increments: set[tuple[int, float]] = set()
    for group in file.groups():
        for channel in group.channels():
            unit = str(channel.properties.get("unit_string", "")).strip()
            columns += [Column(f"{group.name}/{channel.name}", c.data, unit) for c in _vectors({"x": channel[:]})]
            increments.add((len(channel), float(channel.properties.get("wf_increment", 0.0))))
    # A waveform has no time channel: its sampling stands in a property, the same for every channel of a run.
    timed = any(column.parts[0].lower() in ("time", "t") for column in columns)
    if not timed and len(increments) == 1 and (run := increments.pop())[1] > 0:
        columns.append(Column("time", np.arange(float(run[0])) * run[1], "s"))
    return columns


def _read_npz(path: Path) -> list[Column]:
    with np.load(path, allow_pickle=False) as archive:
        return _vectors({name: archive[name] for name in archive.files})


LOADERS: dict[str, Callable[[Path], list[Column]]] = {
    **dict.fromkeys(TEXT, _read_text),
    ".mat": _read_mat,
    ".h5": _read_hdf5,
    ".hdf5": _read_hdf5,
    ".parquet": _read_parquet,
    ".tdms": _read_tdms,
    ".npz": _read_npz,
}
