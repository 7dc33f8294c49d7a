"""Files of operations: the text of --columns; models; written tables; paths of scans."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io import SCAN, demand_version, format_of
from dehyst._text import counted
from dehyst._types import Array
from dehyst._units import FACTORS
from dehyst.model import Actuator
from dehyst.operations.run import MODELS, Run
from dehyst.records import Record, read, read_table, write_columns
from dehyst.records.files import named_and_joined, record_of, time_of
from dehyst.records.formats.columns import Table, listed
from dehyst.records.formats.file_content import MOST
from dehyst.records.record import Channel
from dehyst.records.tables import RATE, Choice, axis_columns, chosen, entries_of, scaled, text_of, with_scale

_Read = TypeVar("_Read")
_SIGNS = {"point": ".", "comma": ","}
# Keys of what is read of a file: of a record, of a voltage, of a path, of a file of which only the text may be special.
TEXT = ("decimal", "max_size")
RECORD = ("time", "voltage", "displacement", "rate", "names", "join", *TEXT)
VOLTAGE = (*(key for key in RECORD if key != "displacement"), "temperature")
PATH = (*(key for key in RECORD if key != "voltage"), "temperature")
# Letters of a field.
_LONGEST_FIELD = 1000
# Of an axis that stays in the middle of its range.
MIDDLE = "middle"


@dataclass(frozen=True)
class Columns:
    """Columns of files, and how the files are read.

    As text: entries with commas between them, ``time=Time:ms, voltage=Ch1:mV*100, displacement=Sensor:V*10um/V``. An
    entry that holds a comma is in double quotes.

    Attributes
    ----------
    time, voltage, displacement : str, optional
        NAME or NAME:UNIT of the column; a "?" at the end marks a guess. Columns without a header are named 1, 2, 3.
    voltage_scale, displacement_scale : str, optional
        After a "*" in the text: the gain of the amplifier if the column is its monitor, or the displacement for one
        volt of the sensor. Without a name it holds for all of several axes: ``voltage=*100``.
    sample_rate : float, optional
        "rate" in the text: samples per second [Hz], instead of a time column.
    names : str, optional
        Names and units of all columns in their order, with "|" between them; "-" leaves one out.
    join : Path, optional
        Second file of the same measurement.
    decimal : str, optional
        Decimal sign; "point" or "comma" in the text.
    max_bytes : float
        "max_size" in the text [MB]: largest file to read, and largest memory for its numbers.
    wanted : str, optional
        Column of the displacement in a path file, if the columns of records are given too.
    temperature : str, optional
        Column of the temperature in a path file; those of records are found by their names.
    axes : dict
        Other keys: names of axes. Values: VOLTAGE:DISPLACEMENT for a record, DISPLACEMENT for a path, or "middle";
        units and scales as above: ``x=Ch1:mV*100:Sensor:um``.
    """

    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    voltage_scale: str | None = None
    displacement_scale: str | None = None
    sample_rate: float | None = None
    names: str | None = None
    join: Path | None = None
    decimal: str | None = None
    max_bytes: float = MOST
    wanted: str | None = None
    temperature: str | None = None
    axes: Mapping[str, str] = field(default_factory=dict)

    metavar: ClassVar[str] = "TEXT"
    about: ClassVar[str] = (
        "How files are read, as 'time=Time:ms, voltage=Ch1:mV*100, displacement=Sensor:um'. Other keys: rate=HZ, "
        "temperature=NAME:C of a path, "
        "join=FILE, names=A|B|-, decimal=point|comma, max_size=MB, and of several axes x=VOLTAGE:DISPLACEMENT; "
        "default: columns are found by their names."
    )

    @classmethod
    def parse(cls, text: str) -> Self:
        """Return the columns that a text declares; raise ValueError if it declares none."""
        found: dict[str, Any] = {"axes": {}}
        for entry in entries_of(text):
            key, equals, value = (part.strip() for part in entry.partition("="))
            if not equals or not key or not value:
                raise ValueError(f"got {entry!r}, need KEY=VALUE, as in 'time=Time:ms, voltage=Ch1:mV*100'")
            if key in found or key in found["axes"]:
                raise ValueError(f"got {key} twice; give it once")
            if key in ("voltage", "displacement"):
                name, scale = scaled(key, value)
                found |= {key: name or None, f"{key}_scale": scale}
            elif key in ("time", "wanted", "temperature"):
                found[key] = value
            elif key == "names":
                found[key] = ",".join(value.split("|"))
            elif key == "join":
                found[key] = Path(value)
            elif key == "decimal":
                if value not in _SIGNS:
                    raise ValueError(f"decimal: got {value!r}, need {' or '.join(_SIGNS)}")
                found[key] = _SIGNS[value]
            elif key in ("rate", "max_size"):
                found |= {"sample_rate": _number(value)} if key == "rate" else {"max_bytes": 1e6 * _number(value)}
            else:
                found["axes"][key] = value
        return cls(**found)

    def __str__(self) -> str:
        """Return the text."""
        return text_of(self._entries())

    @classmethod
    def of_options(cls, options: Mapping[str, Any], before: Columns | None = None) -> Columns:
        """Return a copy with only these keywords of `dehyst.read`, such as the suggestions of an error."""
        known = {**options}
        if names := known.pop("columns", None):
            # Only a file without a header needs names: its columns are numbered.
            entries = (name.strip().partition(":") for name in str(names).split(","))
            known |= {name: f"{k}:{unit}" for k, (name, _, unit) in enumerate(entries, 1) if name not in ("", "-")}
        return replace(before or cls(), **known)

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> Columns:
        """Return columns from form fields, keywords of `dehyst.read`; raise FileFormatError for other fields."""
        known = {*cls.__dataclass_fields__} - {"names", "wanted", "temperature"} | {"columns"}
        for name, value in fields.items():
            kind = {"sample_rate": float | int, "axes": dict}.get(name, str)
            fits = isinstance(value, kind) and not isinstance(value, bool) and len(str(value)) <= _LONGEST_FIELD
            if name not in known or not fits:
                raise FileFormatError(
                    argument="options", got=f"{name[:40]!r}", need=f"one of {', '.join(sorted(known))}"
                )
        return cls(**{"names" if name == "columns" else name: value for name, value in fields.items()})

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read in addition to those of the command."""
        return () if self.join is None else (self.join,)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that were given."""
        return tuple(entry.partition("=")[0] for entry in self._entries())

    def demand_axes(self, keys: Sequence[str], words: str) -> None:
        """Raise an error as `demand` does; columns are given by axis, but a scale may hold for all axes."""
        named = [key for key in ("voltage", "displacement") if getattr(self, key) is not None]
        self.demand([key for key in keys if key not in named], words, axes=True)

    def demand(self, keys: Sequence[str], words: str, *, axes: bool = False) -> None:
        """Raise an error for keys other than these, and for axes unless `axes`; `words`: where they have no effect."""
        known = (*keys, *self.axes) if axes else keys
        wrong = [key for key in self.keys if key not in known]
        if wrong:
            raise FileFormatError(
                f"{wrong[0]} has no effect {words}",
                argument="columns",
                hint=f"leave it out; known are {', '.join(keys)}",
            )

    def records(self, paths: Sequence[Path], *, axes: str | None = None, several: bool = False) -> list[Record]:
        """Read records; `axes`: as in `dehyst.read`; `several`: whether the command reads other files too."""
        several = several or len(paths) > 1
        return [self._with_sign(partial(read, path, **self._options(axes)), several) for path in paths]

    def table(self, path: Path, *, several: bool = False) -> Table:
        """Read the table of a file, with the names and the joined file of the text."""
        given: dict[str, Any] = {
            "columns": self.names,
            "join": self.join,
            "decimal": self.decimal,
            "max_bytes": self.max_bytes,
        }
        return named_and_joined(self.plain_table(path, several=several), self.choice, **given)

    def plain_table(self, path: Path, *, several: bool = True) -> Table:
        """Read the table of a file unchanged: only decimal sign and size have an effect."""
        return self._with_sign(partial(read_table, path, max_bytes=self.max_bytes), several)

    def record_in(self, table: Table, name: str) -> Record:
        """Return the record in a table."""
        return record_of(table, self.choice, name, axis_columns(self.pairs) if self.axes else ())

    def values(self, table: Table, quantity: str) -> Array:
        """Return the voltage or the displacement in a table."""
        scale = f"{quantity}_scale"
        selected = {quantity: getattr(self, quantity), scale: getattr(self, scale)}
        return chosen(table, Choice(**selected), (quantity,))[quantity].values

    def clock(self, table: Table, samples: int) -> dict[str, Array]:
        """Return the time column of a table, if it has one or a rate was given."""
        if self.time is None and self.sample_rate is None and not table.fitting("time"):
            return {}
        return {"time_s": time_of(table, samples, self.time, self.sample_rate)}

    def warmth(self, table: Table, samples: int) -> Array | None:
        """Return the temperatures (n,) [degC] in a table: the named column, or the only one that is a temperature.

        None if there is no such column. Raise an error if there are several, or one that cannot be used.
        """
        found = [column for column in table.columns if column.role == "temperature" and not column.foreign]
        if self.temperature is not None:
            if table.fitting("temperature", self.temperature) != 1:
                raise FileFormatError(
                    f"{table.source}: no column '{self.temperature}' for the temperature",
                    argument="columns",
                    hint=f"the file holds {listed(table.names)}",
                )
            named = table.select("temperature", self.temperature)
            if named.unit not in FACTORS["temperature"]:
                raise FileFormatError(
                    argument="columns",
                    got=f"a temperature in {named.unit or 'no unit'}",
                    need="C, K or F",
                    hint=f"give temperature={named.column.name}:C",
                )
            found = [replace(named.column, name="temperature", unit=named.unit, divided=False)]
        if len(found) > 1:
            raise FileFormatError(
                f"{table.source}: {listed(tuple(column.name for column in found))} are temperatures",
                argument="columns",
                hint=f"select one by temperature={found[0].name}",
            )
        if not found:
            return None
        channel, fault = Channel.of(found[0]), found[0].fault
        if not fault and channel.values.size != samples:
            fault = f"it has {counted(channel.values.size, 'value')} for {counted(samples, 'sample')}"
        if fault := fault or channel.fault:
            raise FileFormatError(f"{table.source}: column '{found[0].name}': {fault}")
        return channel.values

    @property
    def choice(self) -> Choice:
        """Selection of the columns of a record of one axis."""
        return Choice(**{name: getattr(self, name) for name in Choice._fields})

    @property
    def pairs(self) -> str:
        """The argument `axes` of `dehyst.read`; raise FileFormatError if there is only one axis."""
        if len(self.axes) == 1:
            keys = ", ".join(dict.fromkeys((*RECORD, *PATH, "wanted")))
            got = text_of(f"{name}={columns}" for name, columns in self.axes.items())
            need = 'two axes at least, as "x=vx_V:x_um, y=vy_V:y_um"'
            raise FileFormatError(argument="axes", got=got, need=need, hint=f"no axis can be called {keys}")
        return text_of(f"{name}={columns}" for name, columns in self.axes.items())

    def _options(self, axes: str | None) -> dict[str, Any]:
        """Return the keywords of `dehyst.read` except the decimal sign."""
        more = {
            "columns": self.names,
            "join": self.join,
            "max_bytes": self.max_bytes,
            "axes": axes or self.pairs or None,
        }
        return self.choice._asdict() | more

    def _with_sign(self, reading: Callable[..., _Read], several: bool) -> _Read:
        """Read a file with the given decimal sign; with several files, one may use another sign."""
        try:
            return reading(decimal=self.decimal)
        except FileFormatError:
            if self.decimal is not None and several:
                with suppress(FileFormatError):
                    return reading(decimal=None)
            raise

    def _entries(self) -> Iterator[str]:
        for name in ("time", "voltage", "displacement", "wanted", "temperature"):
            if value := with_scale(getattr(self, name), getattr(self, f"{name}_scale", None)):
                yield f"{name}={value}"
        if self.sample_rate is not None:
            yield f"rate={self.sample_rate if isinstance(self.sample_rate, str) else f'{self.sample_rate:.12g}'}"
        if self.names is not None:
            yield f"names={self.names.replace(',', '|')}"
        if self.join is not None:
            yield f"join={self.join}"
        if self.decimal is not None:
            yield f"decimal={next(word for word, sign in _SIGNS.items() if sign == self.decimal)}"
        if self.max_bytes != MOST:
            yield f"max_size={self.max_bytes / 1e6:.12g}"
        yield from (f"{name}={columns}" for name, columns in self.axes.items())


# Columns that are found by their names.
AS_FOUND = Columns()


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        number = f"replace {RATE} by the number of samples a second, as 1000" if text == RATE else "need a number"
        raise ValueError(f"got {text!r}, {number}") from error


# Significant digits of a table: 0.1 nV of 100 V.
_DIGITS = 12
# Part of the voltages of its records by which the limits of a model may be wider.
_BEYOND = 0.1
# A start that is farther from the limits by this multiple of their range is impossible.
_IMPOSSIBLE = 100.0
_LONGEST = 1_000_000


def is_model(path: Path, *formats: str) -> bool:
    """Return whether a file is a model, by its format alone; by default of one axis or several."""
    return path.is_file() and format_of(path) in (formats or MODELS)


def read_model(run: Run, path: Path) -> Actuator:
    """Read a model; warn if its identification was not usable, or did not end."""
    actuator = Actuator.load(path)
    low, high = actuator.voltage_range
    start = actuator.voltage(actuator.state)
    if not np.ptp(actuator.reach) > 0 or abs(start - low) > _IMPOSSIBLE * (high - low):
        raise FileFormatError(
            f"{path}: is no model of an actuator from {low:.6g} to {high:.6g} V: it moves by "
            f"{1e6 * float(np.ptp(actuator.reach)):.3g} um and begins at {start:.3g} V; was the file edited?"
        )
    known = actuator.identification
    if known is not None and known.outcome is not None and not known.outcome.good:
        run.note(f"{path}: when this model was identified: {known.outcome.value}")
    if known is not None and known.provisional:
        run.note(f"{path}: is provisional, because its identification did not end; it was not checked. Identify again")
    for sentence in edited(actuator):
        run.note(f"{path}: {sentence}")
    return actuator


def edited(actuator: Actuator) -> Iterator[str]:
    """Yield warnings of edited limits and delay in a model file, which its records cannot have shown."""
    tested = None if actuator.identification is None else actuator.identification.validity
    if tested is None:
        return
    low, high = tested.limits
    least, most = actuator.voltage_range
    if max(low - least, most - high) > _BEYOND * (high - low):
        yield (
            f"its limits, {least:.6g} to {most:.6g} V, are wider than the voltages of its records, {low:.6g} to "
            f"{high:.6g} V: nothing was measured there. Record these voltages and identify again"
        )
    elif least >= high or most <= low:
        yield f"its limits, {least:.6g} to {most:.6g} V, hold no voltage of its records, {low:.6g} to {high:.6g} V"
    lag = actuator.delay + actuator.lag
    if lag * tested.speeds[1] > high - low:
        yield f"its delay, {lag:.4g} s, is longer than its records took from {low:.6g} to {high:.6g} V: correct it"


def write_table(path: Path, columns: Mapping[str, Any], scan: Mapping[str, Any] | None = None) -> None:
    """Write a table with rounded numbers; the table of a `scan` begins with its declaration."""
    head = () if scan is None else (f"{SCAN}{json.dumps(scan)}",)
    write_columns(path, columns, digits=_DIGITS, head=head)


def scan_declared(path: Path) -> dict[str, Any] | None:
    """Return the declaration in the first line of a path file; None if there is none, or the file is a pipe."""
    if not path.is_file():
        return None
    found = None
    with path.open("rb") as stream, suppress(ValueError):
        line = stream.readline(_LONGEST).decode(errors="replace")
        found = json.loads(line.removeprefix(SCAN)) if line.startswith(SCAN) else None
    if not isinstance(found, dict):
        return None
    demand_version(found, f"{path}")
    return found
