"""The table of a fleet: one Parquet file, one row a record, written from shards with a bounded memory."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from dehyst._errors import DehystError, FileFormatError
from dehyst._io import PathLike, demand_alike, draft_of, named, reading_errors, settle_file, settle_folder, unwritten
from dehyst._version import __version__
from dehyst.fleet.dataset import pyarrow, pyarrow_parquet, text_of
from dehyst.fleet.shards import CAUSE, COLUMNS, MODEL, NUMBERS, PLACE, PRIORS, TEXTS
from dehyst.model import Actuator

# Name of the metadata, and rows in memory at a time.
MARK, _AT_A_TIME = b"dehyst-fleet", 1000


@dataclass(frozen=True, eq=False)
class Fleet:
    """The table of a fleet.

    Attributes
    ----------
    path : Path
    by : tuple of str
        Names of the keys.
    rows : tuple of mapping
        Columns by name, keys among them, without the models.
    about : mapping
        Program, options and digest of the run.
    """

    path: Path
    by: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]
    about: Mapping[str, Any]

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        good = sum(row["outcome"] == "identified" for row in self.rows)
        return f"<Fleet '{self.path.name}': {len(self)} records, {good} identified>"

    def name(self, row: Mapping[str, Any]) -> str:
        """Return the name of a `row`: its keys."""
        return "/".join(str(row[key]) for key in self.by)

    def actuators(self, where: Callable[[Mapping[str, Any]], bool] | None = None) -> list[Actuator]:
        """Return the identified actuators, in the order of the rows; with `where`, those of rows for which it holds."""
        return [actuator for _, actuator in self.models(where)]

    def models(
        self, where: Callable[[Mapping[str, Any]], bool] | None = None
    ) -> Iterator[tuple[Mapping[str, Any], Actuator]]:
        """Yield row and actuator of each identified record; with `where`, of rows for which it holds."""
        for k, (row, text) in enumerate(self.texts()):
            if row["outcome"] == "identified" and (where is None or where(row)):
                yield row, self._actuator(k, row, text)

    def texts(self) -> Iterator[tuple[Mapping[str, Any], str | None]]:
        """Yield each row and its model as JSON, None without one."""
        with closing(pyarrow_parquet().ParquetFile(self.path)) as file:
            texts = (text for batch in file.iter_batches(100, columns=[MODEL]) for text in batch.column(0).to_pylist())
            yield from zip(self.rows, texts, strict=True)

    def _actuator(self, number: int, row: Mapping[str, Any], text: str | None) -> Actuator:
        try:
            return Actuator.from_dict(json.loads(text or ""))
        except (DehystError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
            raise FileFormatError(
                f"{self.path}: row {number} ({self.name(row)}): the column '{MODEL}' holds no model ({error}); "
                "identify the record again"
            ) from error


def load(path: PathLike) -> Fleet:
    """Read the table that `dehyst fleet identify` wrote to `path`; models are read when they are asked for.

    Raise `FileFormatError` if it is no such table, `MissingExtraError` without pyarrow.
    """
    target = named(path)
    with reading_errors(target, "Parquet"), closing(pyarrow_parquet().ParquetFile(target)) as file:
        marked = (file.schema_arrow.metadata or {}).get(MARK)
        if marked is None:
            raise FileFormatError(f"{path}: is no table of a fleet; give one that dehyst fleet identify wrote")
        about = json.loads(marked)
        _demand_columns(target, file.schema_arrow, about["by"])
        names = [name for name in file.schema_arrow.names if name != MODEL]
        rows = tuple(file.read(columns=names, use_threads=False).to_pylist())
    return Fleet(target, tuple(about["by"]), rows, about)


def _demand_columns(path: Path, schema: Any, by: Sequence[str]) -> None:
    """Raise `FileFormatError` if another program has removed a column or changed its kind."""
    known = _kinds()
    # Tables of version 0.1 have neither places nor causes.
    if missing := [name for name in (*by, *known) if name not in (*schema.names, PLACE, CAUSE)]:
        raise FileFormatError(
            f"{path}: has no column '{missing[0]}', which dehyst fleet identify wrote; was the table edited? Keep all "
            "its columns, or identify the dataset again"
        )
    types = pyarrow().types
    for name in (*NUMBERS, MODEL):
        kind = schema.field(name).type
        fits = types.is_string(kind) or types.is_large_string(kind) if name == MODEL else _is_number(types, kind)
        if not (fits or types.is_null(kind)):
            raise FileFormatError(
                f"{path}: column '{name}' is of kind {kind}, need {known[name]}; was the table edited?"
            )


def _is_number(types: Any, kind: Any) -> bool:
    return bool(types.is_floating(kind) or types.is_integer(kind))


def actuators(path: PathLike, where: Callable[[Mapping[str, Any]], bool] | None = None) -> list[Actuator]:
    """Return the identified actuators of the table at `path`; with `where`, those of rows for which it holds.

    Raise as `load` does.
    """
    return load(path).actuators(where)


def write_table(
    path: Path,
    keys: Mapping[str, Iterable[Any]],
    rows: Iterable[Mapping[str, Any]],
    about: Mapping[str, Any],
    folder: Path,
) -> None:
    """Write rows, as shards hold them, to a table: completely or not at all.

    `keys`: values of all rows by name. `folder`: that of the draft, which the next run removes if this one is killed.
    """
    arrow, parquet = pyarrow(), pyarrow_parquet()
    remaining, draft = iter(rows), draft_of(folder / path.name)
    words = {"program": f"dehyst {__version__}", "by": list(keys), **about}
    kinds = {name: _kind(list(values)) for name, values in keys.items()}
    schema = arrow.schema({**kinds, **_kinds()}).with_metadata({MARK: json.dumps(words).encode()})
    # Keys of different kinds are text.
    mixed = [name for name, kind in kinds.items() if kind == arrow.string()]
    try:
        with parquet.ParquetWriter(draft, schema, compression="zstd") as writer:
            while block := list(islice(remaining, _AT_A_TIME)):
                writer.write_table(arrow.Table.from_pylist([_flat(row, mixed) for row in block], schema=schema))
        settle_file(draft)
        demand_alike(path, b"PAR1" + MARK)
        draft.replace(path)
        settle_folder(path.parent)
    except OSError as error:
        raise unwritten(path, error) from error
    finally:
        draft.unlink(missing_ok=True)


def _flat(row: Mapping[str, Any], mixed: Sequence[str]) -> dict[str, Any]:
    model = row.get(MODEL)
    texts = {name: text_of(row.get(name)) for name in TEXTS} | {name: str(row["keys"][name]) for name in mixed}
    return {**row, **row["keys"], **texts, MODEL: None if model is None else json.dumps(model)}


def _kinds() -> dict[str, Any]:
    """Return the columns beside the keys, in their order, and the kind of each."""
    arrow = pyarrow()
    kinds: dict[str, Any] = dict.fromkeys(NUMBERS, arrow.float64()) | dict.fromkeys(PRIORS[1:], arrow.float64())
    kinds |= dict.fromkeys((*TEXTS, "prior", "version", "sha256", PLACE, CAUSE), arrow.string())
    kinds |= dict.fromkeys(("cpu_s", "wall_s", "memory_MB"), arrow.float64())
    kinds |= {"samples": arrow.int64(), "coefficients": arrow.list_(arrow.float64())}
    return {name: kinds[name] for name in COLUMNS} | {MODEL: arrow.string()}


def _kind(values: Sequence[Any]) -> Any:
    arrow = pyarrow()
    if any(isinstance(value, int) and abs(value) >= 2**63 for value in values):
        return arrow.string()
    for kind, column in ((bool, arrow.bool_()), (int, arrow.int64()), ((int, float), arrow.float64())):
        if all(isinstance(value, kind) and (kind is bool or not isinstance(value, bool)) for value in values):
            return column
    return arrow.string()
