"""An emulated piezo controller with the GCS 2.0 protocol, from a command line to its answer, without sockets.

Each axis has an output channel and a wave generator; all axes share the wave tables and one data recorder. The table
`COMMANDS` has one row for each command.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from typing import NamedTuple, TypeAlias

import numpy as np

from dehyst._errors import DehystError, DeviceError
from dehyst._types import Array
from dehyst.virtual.bench import BenchAxis, VirtualBench

_LONGEST_LINE = 65536
_IDENTITY = "dehyst,emulated piezo controller"
_FIRMWARE = "0.1.0"
# Least number of wave tables, points that one command line may bring, and the largest number of most arguments.
_TABLES, _LONGEST_SEGMENT, _MOST = 4, 4096, 10**6
# Quantity of a recorder table, by the number of its option.
_NOTHING, _POSITION, _VOLTAGE = 0, 2, 16
_RECORDED = {_NOTHING: "Nothing is recorded", _POSITION: "Current Position of axis", _VOLTAGE: "Voltage of output chn"}

_Words: TypeAlias = Sequence[str]
_Limits: TypeAlias = tuple[float, float]


class GcsError(IntEnum):
    """The public error numbers of GCS 2.0 that ERR? returns."""

    NONE = 0
    SYNTAX = 1
    UNKNOWN_COMMAND = 2
    TOO_LONG = 3
    AXIS = 15
    PARAMETER_RANGE = 17
    PARAMETER_COUNT = 24
    NOT_A_NUMBER = 25
    MISSING = 26
    UNKNOWN_PARAMETER = 54
    RECORD_TABLE = 57
    RECORD_OPTION = 58
    WAVE_TOO_LARGE = 67
    WAVE_RUNNING = 73
    NO_WAVE_SELECTED = 75
    NOT_RECORDED = 77
    SERVO_ON = 79
    BROKEN_CABLE = 215
    VOLTAGE = 302
    WAVE_WITH_SERVO = 303


class CommandError(DehystError):
    """A refused command; its error number is latched until ERR?."""

    def __init__(self, error: GcsError) -> None:
        super().__init__(f"error {error.value}: {error.name.lower().replace('_', ' ')}")
        self.error = error


def _demand(holds: bool, error: GcsError) -> None:
    if not holds:
        raise CommandError(error)


def _real(word: str) -> float:
    """Read a finite number; stricter than Python, as a controller is."""
    try:
        value = float(word)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    _demand(math.isfinite(value) and word.isascii() and "_" not in word, GcsError.NOT_A_NUMBER)
    return value


def _whole(word: str, least: int = 0, most: int | None = None, error: GcsError = GcsError.PARAMETER_RANGE) -> int:
    """Read a whole number, decimal or with 0x, from `least` to `most`."""
    try:
        value = int(word, 16 if word.lower().startswith("0x") else 10)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    _demand(least <= value and (most is None or value <= most), error)
    return value


def _numeral(value: float | str) -> str:
    """Write a number as controllers do, with enough digits."""
    return value if isinstance(value, str) else f"{value:.12g}"


def _groups(words: _Words, size: int, most: int) -> list[_Words]:
    """Return arguments in groups of `size`: one group at least, `most` at most."""
    _demand(len(words) >= size, GcsError.MISSING)
    _demand(len(words) <= size * most, GcsError.PARAMETER_COUNT)
    _demand(len(words) % size == 0, GcsError.MISSING)
    return [words[first : first + size] for first in range(0, len(words), size)]


class ControllerAxis:
    """One axis: its name, its `bench`, the limits [V] it `reported`, and its wave generator.

    `table`: the generator's wave table (0: none). `cycles`, `divider`: its other settings. `monitor`: function that
    returns the voltage that is read [V] of the one that is put out.
    """

    def __init__(self, name: str, bench: BenchAxis, reported: _Limits) -> None:
        self.name, self.bench, self.reported = name, bench, reported
        self.table, self.cycles, self.divider = 0, 0, 1
        self.monitor: Callable[[float], float] = float


class Controller:
    """Axes 1, 2, ... with an output channel and a wave generator each, and one data recorder, around an `instrument`.

    `reported_limits`: limits [V] that the controller reports, for its only axis or for each; default: the actual
    limits. `error`: latched until ERR?. `tables`: the wave tables [V]. `rows_sent`: rows that DRR? has returned so far.
    """

    def __init__(self, instrument: VirtualBench, *, reported_limits: _Limits | Sequence[_Limits] | None = None) -> None:
        self.instrument, self.error, self.rows_sent = instrument, GcsError.NONE, 0
        count, own = len(instrument.axes), [axis.limits for axis in instrument.axes]
        limits = np.array(own if reported_limits is None else reported_limits).reshape(count, 2).tolist()
        self.axes = tuple(
            ControllerAxis(str(j + 1), bench, (low, high))
            for j, (bench, (low, high)) in enumerate(zip(instrument.axes, limits, strict=True))
        )
        self.named = {axis.name: axis for axis in self.axes}
        self.serial = instrument.serial.replace(",", " ")
        self.identity = ",".join((_IDENTITY, self.serial, _FIRMWARE))
        self.tables = {number: np.zeros(0) for number in range(1, max(_TABLES, count) + 1)}
        # Axis and quantity of each recorder table.
        kinds = [(name, kind) for name in self.named for kind in (_POSITION, _VOLTAGE)]
        self.records = dict(enumerate(kinds, 1))
        self.record_divider, self.stride = 1, 1
        self.record_period = instrument.servo_period
        # The read-only parameters by number: servo update time [s], and points of a wave and of the recorder.
        self.parameters = {
            0x0E000200: _numeral(instrument.servo_period),
            0x13000004: str(instrument.wave_points),
            0x16000200: str(instrument.record_points * count),
        }

    def answer(self, line: str) -> str | None:
        """Return the answer to a `line`: one line or several, or None; a command that fails latches its error."""
        words = line.split()
        if not words:
            return None
        self.instrument.advance()
        try:
            _demand(len(line) <= _LONGEST_LINE, GcsError.TOO_LONG)
            command = COMMANDS.get(words[0].upper())
            if command is None:
                raise CommandError(GcsError.UNKNOWN_COMMAND)
            least, most = command.arguments
            _demand(len(words) > least, GcsError.MISSING)
            _demand(most is None or len(words) <= most + 1, GcsError.PARAMETER_COUNT)
            lines = command.run(self, words[1:])
        except CommandError as refusal:
            self.error = refusal.error
        except DeviceError:
            self.error = GcsError.PARAMETER_RANGE
        else:
            # All lines but the last end with a space.
            return None if lines is None else " \n".join(lines) + "\n"
        return None

    @property
    def recorded(self) -> int:
        """Number of recorded rows."""
        return -(-self.instrument.recorded // self.stride)

    def chosen(self, words: _Words) -> Sequence[ControllerAxis]:
        """Return the axes whose names are `words`, or all of them."""
        _demand(all(word in self.named for word in words), GcsError.AXIS)
        return [self.named[word] for word in words] or self.axes

    def generator(self, word: str) -> ControllerAxis:
        """Return the axis whose wave generator has the number `word`."""
        return self.axes[_whole(word, 1, len(self.axes)) - 1]

    def record_tables(self, words: _Words) -> list[int]:
        """Return the numbers of recorder tables in `words`, by default of all."""
        return [_whole(word, 1, len(self.records), GcsError.RECORD_TABLE) for word in words] or list(self.records)


# Commands of axes and channels.


def _set_voltage(axis: ControllerAxis, voltage: float) -> None:
    _demand(not axis.bench.servo, GcsError.SERVO_ON)
    _demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    _demand(axis.bench.set_voltage(voltage), GcsError.VOLTAGE)


def _set_servo(axis: ControllerAxis, on: float) -> None:
    _demand(on in (0, 1), GcsError.PARAMETER_RANGE)
    _demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    axis.bench.servo = bool(on)


def _name_axes(controller: Controller, words: _Words) -> list[str]:
    _demand([word.upper() for word in words] in ([], ["ALL"]), GcsError.PARAMETER_COUNT)
    return list(controller.named)


def _take_error(controller: Controller, _: _Words) -> list[str]:
    error, controller.error = controller.error, GcsError.NONE
    return [str(error.value)]


def _read_parameters(controller: Controller, words: _Words) -> list[str]:
    _demand(len(words) % 2 == 0, GcsError.MISSING)
    _demand(all(item == "1" for item in words[::2]), GcsError.PARAMETER_RANGE)
    numbers = [_whole(word) for word in words[1::2]] or list(controller.parameters)
    _demand(all(number in controller.parameters for number in numbers), GcsError.UNKNOWN_PARAMETER)
    return [f"1 0x{number:08X}={controller.parameters[number]}" for number in numbers]


def _list_commands(_controller: Controller, _: _Words) -> list[str]:
    return [
        "The following commands are valid:",
        *(f"{word} {COMMANDS[word].words}" for word in sorted(COMMANDS)),
        "end of help",
    ]


# Wave tables and wave generators.


def _write_wave(controller: Controller, words: _Words) -> None:
    """Do WAV table X|& shape ...: write a table, or append to it."""
    number, how, kind = _whole(words[0], 1, len(controller.tables)), words[1].upper(), words[2].upper()
    _demand(how in ("X", "&") and kind in ("PNT", "SIN_P"), GcsError.PARAMETER_RANGE)
    for axis in controller.axes:
        _demand(axis.table != number or not axis.bench.playing, GcsError.WAVE_RUNNING)
    segment = _points(words[3:]) if kind == "PNT" else _cosine(words[3:])
    ranges = (axis.bench.limits for axis in controller.axes)
    if not any(low <= segment.min() and segment.max() <= high for low, high in ranges):
        controller.axes[0].bench.log.refused += 1
        raise CommandError(GcsError.VOLTAGE)
    table = segment if how == "X" else np.concatenate([controller.tables[number], segment])
    _demand(table.size <= controller.instrument.wave_points, GcsError.WAVE_TOO_LARGE)
    controller.tables[number] = table


def _points(words: _Words) -> Array:
    """Read the points of PNT first count point ...."""
    _demand(len(words) >= 3, GcsError.MISSING)
    _whole(words[0])
    size = _whole(words[1], 1, _LONGEST_SEGMENT)
    _demand(len(words) >= 2 + size, GcsError.MISSING)
    _demand(len(words) == 2 + size, GcsError.PARAMETER_COUNT)
    return np.array([_real(word) for word in words[2:]])


def _cosine(words: _Words) -> Array:
    """Read one raised cosine: SIN_P size amplitude offset length start centre."""
    _demand(len(words) >= 6, GcsError.MISSING)
    _demand(len(words) == 6, GcsError.PARAMETER_COUNT)
    size, amplitude, offset = _whole(words[0], 1, _MOST), _real(words[1]), _real(words[2])
    length = _whole(words[3], 1, size)
    start, centre = _whole(words[4], 0, size), _whole(words[5], 1, length - 1)
    point = np.clip(np.arange(size, dtype=np.float64) - start, 0, length)
    phase = np.interp(point, [0.0, centre, length], [0.0, 0.5, 1.0])
    return np.asarray(offset + amplitude * 0.5 * (1 - np.cos(2 * np.pi * phase)))


def _wave_lengths(controller: Controller, words: _Words) -> list[str]:
    """Answer WAV? [table [1]]: number of points of each table."""
    _demand(len(words) < 2 or _whole(words[1]) == 1, GcsError.PARAMETER_RANGE)
    numbers = [_whole(words[0], 1, len(controller.tables))] if words else list(controller.tables)
    return [f"{number} 1={controller.tables[number].size}" for number in numbers]


def _select_waves(controller: Controller, words: _Words) -> None:
    """Do WSL {generator table}, where 0 selects no table."""
    pairs = _groups(words, 2, len(controller.axes))
    chosen = [(controller.generator(number), _whole(table, 0, len(controller.tables))) for number, table in pairs]
    for axis, table in chosen:
        axis.table = table


def _repeat_waves(controller: Controller, words: _Words) -> None:
    """Do WGC {generator cycles}, where 0 is as many cycles as the generator takes."""
    pairs = _groups(words, 2, len(controller.axes))
    for axis, cycles in [(controller.generator(number), _whole(cycles)) for number, cycles in pairs]:
        axis.cycles = cycles


def _slow_waves(controller: Controller, words: _Words) -> None:
    """Do WTR {generator divider interpolation}; generator 0 is all of them."""
    given = []
    for number, rate, kind in _groups(words, 3, len(controller.axes)):
        axes = [controller.generator(number)] if _whole(number) else controller.axes
        given.append((axes, _whole(rate, 1, _MOST)))
        _whole(kind, 0, 1)
    for axes, divider in given:
        for axis in axes:
            axis.divider = divider


def _run_waves(controller: Controller, words: _Words) -> None:
    """Do WGO {generator mode}; generators that are started together begin at one instant."""
    pairs = _groups(words, 2, len(controller.axes))
    modes = {controller.generator(number): _whole(mode, 0, 1) for number, mode in pairs}
    for axis in (axis for axis, mode in modes.items() if not mode and axis.bench.playing):
        axis.bench.stop()
    started = [axis for axis, mode in modes.items() if mode]
    if not started:
        return
    _demand(not any(axis.bench.servo for axis in started), GcsError.WAVE_WITH_SERVO)
    _demand(not any(axis.bench.playing for axis in controller.axes), GcsError.WAVE_RUNNING)
    waves = {controller.axes.index(axis): _selected_wave(controller, axis) for axis in started}
    # One recorder records all axes, each sample or every nth.
    dividers = {axis.divider for axis in started}
    _demand(len(dividers) == 1, GcsError.PARAMETER_RANGE)
    (divider,) = dividers
    _demand(controller.record_divider % divider == 0, GcsError.PARAMETER_RANGE)
    controller.stride = controller.record_divider // divider
    controller.record_period = controller.record_divider * controller.instrument.servo_period
    controller.instrument.start(waves, divider)


def _selected_wave(controller: Controller, axis: ControllerAxis) -> Array:
    """Return the voltages (n,) [V] that a start of an axis' generator plays."""
    table = controller.tables.get(axis.table, np.zeros(0))
    _demand(table.size > 0, GcsError.NO_WAVE_SELECTED)
    most = controller.instrument.wave_points // table.size
    _demand(axis.cycles <= most, GcsError.WAVE_TOO_LARGE)
    return np.tile(table, axis.cycles or most)


# The data recorder.


def _set_record(controller: Controller, words: _Words) -> None:
    """Do DRC table source option."""
    (table,) = controller.record_tables(words[:1])
    _demand(words[1] in controller.named, GcsError.AXIS)
    option = _whole(words[2])
    _demand(option in _RECORDED, GcsError.RECORD_OPTION)
    controller.records[table] = words[1], option


def _set_trigger(controller: Controller, words: _Words) -> None:
    """Do DRT table trigger value; a wave triggers the recorder in any case."""
    _whole(words[0], 0, len(controller.records), GcsError.RECORD_TABLE)
    _whole(words[1], 0, 4)


def _slow_recorder(controller: Controller, words: _Words) -> None:
    controller.record_divider = _whole(words[0], 1, _MOST)


def _recorder_help(controller: Controller, _: _Words) -> list[str]:
    return [
        "#RecordOptions",
        *(f"{option}={name}" for option, name in _RECORDED.items()),
        "#TriggerOptions",
        "0=default setting",
        "1=any command that changes the output, and the start of a wave",
        "#Additional information",
        f"{len(controller.records)} record tables",
        f"{controller.instrument.record_points} datapoints per table",
        "end of help",
    ]


def _recorded_array(controller: Controller, words: _Words) -> list[str]:
    """Answer DRR? [first [count [table ...]]]: recorded rows from `first`, which is 1 or more."""
    available = controller.recorded
    first = _whole(words[0], 1) if words else 1
    count = _whole(words[1], 1) if len(words) > 1 else available
    tables = controller.record_tables(words[2:])
    _demand(first <= available, GcsError.NOT_RECORDED)
    names, columns = [], []
    for axis, option in (controller.records[table] for table in tables):
        index = controller.axes.index(controller.named[axis])
        time, voltage, displacement = (
            column[:: controller.stride] for column in controller.instrument.samples(axis=index)
        )
        found = {_POSITION: displacement * 1e6, _VOLTAGE: voltage, _NOTHING: time * 0.0}[option]
        columns.append(found[first - 1 : min(available, first - 1 + count)].tolist())
        names.append(_RECORDED[option] + (axis if option else ""))
    rows = [" ".join(map(_numeral, row)) for row in zip(*columns, strict=True)]
    controller.rows_sent += len(rows)
    return [
        "# REM Recorded by an emulated controller of dehyst",
        "# VERSION = 1",
        "# TYPE = 1",
        "# SEPARATOR = 32",
        f"# DIM = {len(tables)}",
        f"# SAMPLE_TIME = {_numeral(controller.record_period)}",
        f"# NDATA = {len(rows)}",
        *(f"# NAME{index} = {name}" for index, name in enumerate(names)),
        "# END_HEADER",
        *rows,
    ]


class GcsCommand(NamedTuple):
    """A row of `COMMANDS`: its description in HLP?, what it does, and its least and largest number of arguments.

    `run` returns the lines of the answer, or None where there is none.
    """

    words: str
    run: Callable[[Controller, _Words], Iterable[str] | None]
    arguments: tuple[int, int | None] = (0, 0)


def _of_axes(words: str, value: Callable[[ControllerAxis], float | str]) -> GcsCommand:
    """Return a query of axes or channels, by default of all."""
    return GcsCommand(
        words, lambda c, given: [f"{axis.name}={_numeral(value(axis))}" for axis in c.chosen(given)], (0, None)
    )


def _of_generators(words: str, value: Callable[[ControllerAxis], float | str]) -> GcsCommand:
    """Return a query of wave generators by their numbers, by default of all."""

    def run(controller: Controller, given: _Words) -> list[str]:
        axes = [controller.generator(word) for word in given] or controller.axes
        return [f"{controller.axes.index(axis) + 1}={_numeral(value(axis))}" for axis in axes]

    return GcsCommand(words, run, (0, None))


def _to_axes(words: str, act: Callable[[ControllerAxis, float], None]) -> GcsCommand:
    """Return a command {axis value}; its axes are done in order, or none if an argument is wrong."""

    def run(controller: Controller, given: _Words) -> None:
        pairs = _groups(given, 2, len(controller.axes))
        axes = controller.chosen([name for name, _ in pairs])
        for axis, value in list(zip(axes, [_real(word) for _, word in pairs], strict=True)):
            act(axis, value)

    return GcsCommand(words, run, (2, None))


def _of_record_tables(words: str, value: Callable[[Controller, int], str]) -> GcsCommand:
    """Return a query of recorder tables, by default of all."""
    return GcsCommand(words, lambda c, given: [f"{n}={value(c, n)}" for n in c.record_tables(given)], (0, None))


COMMANDS: dict[str, GcsCommand] = {
    "*IDN?": GcsCommand("Get device identification", lambda c, _: [c.identity]),
    "DRC": GcsCommand("Set data recorder configuration {table source option}", _set_record, (3, 3)),
    "DRL?": _of_record_tables("Get number of recorded points", lambda c, _: str(c.recorded)),
    "DRR?": GcsCommand("Get recorded data {[first [count [table]]]}", _recorded_array, (0, None)),
    "DRT": GcsCommand("Set data recorder trigger source {table trigger value}", _set_trigger, (3, 3)),
    "ERR?": GcsCommand("Get error number", _take_error),
    "HDR?": GcsCommand("Get help for data recording", _recorder_help),
    "HLP?": GcsCommand("Get list of commands", _list_commands),
    "POS?": _of_axes("Get real position", lambda axis: 1e6 * axis.bench.displacement()),
    "RTR": GcsCommand("Set record table rate {divider}", _slow_recorder, (1, 1)),
    "SAI?": GcsCommand("Get list of axes {[ALL]}", _name_axes, (0, None)),
    "SPA?": GcsCommand("Get parameters {[item parameter]}", _read_parameters, (0, None)),
    "SVA": _to_axes("Set open-loop value {axis voltage}", _set_voltage),
    "SVO": _to_axes("Set servo mode {axis state}", _set_servo),
    "SVO?": _of_axes("Get servo mode", lambda axis: int(axis.bench.servo)),
    "TNR?": GcsCommand("Get number of record tables", lambda c, _: [str(len(c.records))]),
    "VMA?": _of_axes("Get highest voltage", lambda axis: axis.reported[1]),
    "VMI?": _of_axes("Get lowest voltage", lambda axis: axis.reported[0]),
    "VOL?": _of_axes("Get voltage of output channel", lambda axis: axis.monitor(axis.bench.voltage)),
    "WAV": GcsCommand("Set waveform {table X|& shape ...}", _write_wave, (4, None)),
    "WAV?": GcsCommand("Get wave tables", _wave_lengths, (0, 2)),
    "WGC": GcsCommand("Set number of cycles {generator cycles}", _repeat_waves, (2, None)),
    "WGO": GcsCommand("Start or stop wave generator {generator mode}", _run_waves, (2, None)),
    "WGO?": _of_generators("Get wave generator state", lambda axis: int(axis.bench.playing)),
    "WSL": GcsCommand("Set connection of wave table {generator table}", _select_waves, (2, None)),
    "WTR": GcsCommand("Set wave generator rate {generator divider interpolation}", _slow_waves, (3, None)),
}
