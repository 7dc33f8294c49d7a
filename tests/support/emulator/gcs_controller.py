"""An emulated piezo controller with the GCS 2.0 protocol, from a command line to its answer, without sockets.

Each axis has an output channel and a wave generator; all axes share the wave tables and one data recorder. The table
`COMMANDS` has one row for each command.
"""

import math
from collections.abc import Callable
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from dehyst._errors import DeviceError

_IDENTITY = "dehyst,emulated piezo controller"
_FIRMWARE = "0.1.0"
# Least number of wave tables, points that one command line may bring, and the largest number of most arguments.
_TABLES, _LONGEST_SEGMENT, _MOST = 4, 4096, 10**6
# Quantity of a recorder table, by the number of its option.
_POSITION, _VOLTAGE = 2, 16
_RECORDED = {_POSITION: "Current Position of axis", _VOLTAGE: "Voltage of output chn"}


class GcsError(IntEnum):
    """The public error numbers of GCS 2.0 that ERR? returns here."""

    NONE = 0
    UNKNOWN_COMMAND = 2
    AXIS = 15
    PARAMETER_RANGE = 17
    PARAMETER_COUNT = 24
    NOT_A_NUMBER = 25
    WAVE_TOO_LARGE = 67
    WAVE_RUNNING = 73
    SERVO_ON = 79
    BROKEN_CABLE = 215
    VOLTAGE = 302


class CommandError(Exception):
    """A refused command; its error number is latched until ERR?."""


def _demand(holds, error):
    if not holds:
        raise CommandError(error)


def _real(word):
    """Read a finite number; stricter than Python, as a controller is."""
    try:
        value = float(word)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    _demand(math.isfinite(value) and word.isascii() and "_" not in word, GcsError.NOT_A_NUMBER)
    return value


def _whole(word, least=0, most=math.inf):
    """Read a whole number, decimal or with 0x, from `least` to `most`."""
    try:
        value = int(word, 16 if word.lower().startswith("0x") else 10)
    except ValueError:
        raise CommandError(GcsError.NOT_A_NUMBER) from None
    _demand(least <= value <= most, GcsError.PARAMETER_RANGE)
    return value


def _numeral(value):
    """Write a number as controllers do, with enough digits."""
    return value if isinstance(value, str) else f"{value:.12g}"


def _groups(words, size, most):
    """Return arguments in groups of `size`: one group at least, `most` at most."""
    _demand(0 < len(words) <= size * most and len(words) % size == 0, GcsError.PARAMETER_COUNT)
    return [words[first : first + size] for first in range(0, len(words), size)]


class ControllerAxis:
    """One axis: its name, its `bench`, the limits [V] it `reported`, and its wave generator.

    `table`: the generator's wave table (0: none). `cycles`, `divider`: its other settings. `monitor`: function that
    returns the voltage that is read [V] of the one that is put out.
    """

    def __init__(self, name, bench, reported):
        self.name, self.bench, self.reported, self.monitor = name, bench, reported, float
        self.table, self.cycles, self.divider = 0, 0, 1


class Controller:
    """Axes 1, 2, ... with an output channel and a wave generator each, and one data recorder, around an `instrument`.

    `reported_limits`: limits [V] that the controller reports, for its only axis or for each; default: the actual
    limits. `error`: latched until ERR?. `tables`: the wave tables [V]. `rows_sent`: rows that DRR? has returned so far.
    """

    def __init__(self, instrument, *, reported_limits=None):
        self.instrument, self.error, self.rows_sent = instrument, GcsError.NONE, 0
        count, own = len(instrument.axes), [axis.limits for axis in instrument.axes]
        limits = np.array(own if reported_limits is None else reported_limits).reshape(count, 2).tolist()
        self.axes = [
            ControllerAxis(str(j + 1), bench, (low, high))
            for j, (bench, (low, high)) in enumerate(zip(instrument.axes, limits, strict=True))
        ]
        self.named = {axis.name: axis for axis in self.axes}
        self.identity = ",".join((_IDENTITY, instrument.serial.replace(",", " "), _FIRMWARE))
        self.tables = {number: np.zeros(0) for number in range(1, max(_TABLES, count) + 1)}
        # Axis and quantity of each recorder table.
        kinds = [(name, kind) for name in self.named for kind in (_POSITION, _VOLTAGE)]
        self.records = dict(enumerate(kinds, 1))
        self.record_divider = 1
        # The read-only parameters by number: servo update time [s], and points of a wave and of the recorder.
        self.parameters = {
            0x0E000200: _numeral(instrument.servo_period),
            0x13000004: str(instrument.wave_points),
            0x16000200: str(instrument.record_points * count),
        }

    def answer(self, line):
        """Return the answer to a `line`: one line or several, or None; a command that fails latches its error."""
        words = line.split()
        if not words:
            return None
        self.instrument.advance()
        try:
            command = COMMANDS.get(words[0].upper())
            _demand(command is not None, GcsError.UNKNOWN_COMMAND)
            least, most = command.arguments
            _demand(least < len(words) <= most + 1, GcsError.PARAMETER_COUNT)
            lines = command.run(self, words[1:])
        except CommandError as refusal:
            (self.error,) = refusal.args
        except DeviceError:
            self.error = GcsError.PARAMETER_RANGE
        else:
            # All lines but the last end with a space.
            return None if lines is None else " \n".join(lines) + "\n"
        return None

    def chosen(self, words):
        """Return the axes whose names are `words`, or all of them."""
        _demand(all(word in self.named for word in words), GcsError.AXIS)
        return [self.named[word] for word in words] or self.axes

    def generator(self, word):
        """Return the axis whose wave generator has the number `word`."""
        return self.axes[_whole(word, 1, len(self.axes)) - 1]

    def record_tables(self, words):
        """Return the numbers of recorder tables in `words`, by default of all."""
        return [_whole(word, 1, len(self.records)) for word in words] or list(self.records)


# Commands of axes and channels.


def _set_voltage(axis, voltage):
    _demand(not axis.bench.servo, GcsError.SERVO_ON)
    _demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    _demand(axis.bench.set_voltage(voltage), GcsError.VOLTAGE)


def _set_servo(axis, on):
    _demand(on in (0, 1), GcsError.PARAMETER_RANGE)
    _demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    axis.bench.servo = bool(on)


def _take_error(controller, _):
    error, controller.error = controller.error, GcsError.NONE
    return [str(error.value)]


def _read_parameter(controller, words):
    number = _whole(words[1])
    _demand(words[0] == "1" and number in controller.parameters, GcsError.PARAMETER_RANGE)
    return [f"1 0x{number:08X}={controller.parameters[number]}"]


def _list_commands(*_):
    return [
        "The following commands are valid:",
        *(f"{word} does something" for word in sorted(COMMANDS)),
        "end of help",
    ]


# Wave tables and wave generators.


def _write_wave(controller, words):
    """Do WAV table X|& shape ...: write a table, or append to it."""
    number, how, kind = _whole(words[0], 1, len(controller.tables)), words[1].upper(), words[2].upper()
    _demand(how in ("X", "&") and kind == "PNT", GcsError.PARAMETER_RANGE)
    for axis in controller.axes:
        _demand(axis.table != number or not axis.bench.playing, GcsError.WAVE_RUNNING)
    segment = _points(words[3:])
    ranges = (axis.bench.limits for axis in controller.axes)
    if not any(low <= segment.min() and segment.max() <= high for low, high in ranges):
        controller.axes[0].bench.log.refused += 1
        raise CommandError(GcsError.VOLTAGE)
    table = segment if how == "X" else np.concatenate([controller.tables[number], segment])
    _demand(table.size <= controller.instrument.wave_points, GcsError.WAVE_TOO_LARGE)
    controller.tables[number] = table


def _points(words):
    """Read the points of PNT first count point ...."""
    _demand(len(words) >= 3 and _whole(words[0]) >= 0, GcsError.PARAMETER_COUNT)
    _demand(len(words) == 2 + _whole(words[1], 1, _LONGEST_SEGMENT), GcsError.PARAMETER_COUNT)
    return np.array([_real(word) for word in words[2:]])


def _wave_length(controller, words):
    """Answer WAV? table 1: number of points of a table."""
    number = _whole(words[0], 1, len(controller.tables))
    return [f"{number} {_whole(words[1], 1, 1)}={controller.tables[number].size}"]


def _run_waves(controller, words):
    """Do WGO {generator mode}; generators that are started together begin at one instant."""
    pairs = _groups(words, 2, len(controller.axes))
    modes = [(controller.generator(number), _whole(mode, 0, 1)) for number, mode in pairs]
    for axis in (axis for axis, mode in modes if not mode and axis.bench.playing):
        axis.bench.stop()
    started = [axis for axis, mode in modes if mode]
    if not started:
        return
    _demand(not any(axis.bench.servo for axis in started), GcsError.SERVO_ON)
    _demand(not any(axis.bench.playing for axis in controller.axes), GcsError.WAVE_RUNNING)
    waves = {controller.axes.index(axis): _selected_wave(controller, axis) for axis in started}
    # One recorder records each sample of all axes.
    _demand({axis.divider for axis in started} == {controller.record_divider}, GcsError.PARAMETER_RANGE)
    controller.instrument.start(waves, controller.record_divider)


def _selected_wave(controller, axis):
    """Return the voltages (n,) [V] that a start of an axis' generator plays; 0 cycles are as many as it takes."""
    table = controller.tables.get(axis.table, np.zeros(0))
    most = controller.instrument.wave_points // max(table.size, 1)
    _demand(table.size > 0 and axis.cycles <= most, GcsError.WAVE_TOO_LARGE)
    return np.tile(table, axis.cycles or most)


# The data recorder.


def _set_record(controller, words):
    """Do DRC table source option."""
    (table,) = controller.record_tables(words[:1])
    _demand(words[1] in controller.named, GcsError.AXIS)
    _demand(_whole(words[2]) in _RECORDED, GcsError.PARAMETER_RANGE)
    controller.records[table] = words[1], _whole(words[2])


def _set_trigger(controller, words):
    """Do DRT table trigger value; a wave triggers the recorder in any case."""
    _whole(words[0], 0, len(controller.records))
    _whole(words[1], 0, 4)


def _slow_recorder(controller, words):
    controller.record_divider = _whole(words[0], 1, _MOST)


def _recorder_help(*_):
    options = (f"{option}={name}" for option, name in _RECORDED.items())
    return ["#RecordOptions", *options, "#TriggerOptions", "0=default setting", "end of help"]


def _recorded_array(controller, words):
    """Answer DRR? first count table ...: recorded rows from `first`, which is 1 or more."""
    first, count, tables = _whole(words[0], 1), _whole(words[1], 1), controller.record_tables(words[2:])
    _demand(first <= controller.instrument.recorded, GcsError.PARAMETER_RANGE)
    names, columns = [], []
    for axis, option in (controller.records[table] for table in tables):
        index = controller.axes.index(controller.named[axis])
        _, voltage, displacement = controller.instrument.samples(axis=index)
        found = {_POSITION: displacement * 1e6, _VOLTAGE: voltage}[option]
        columns.append(found[first - 1 : first - 1 + count].tolist())
        names.append(_RECORDED[option] + axis)
    rows = [" ".join(map(_numeral, row)) for row in zip(*columns, strict=True)]
    controller.rows_sent += len(rows)
    return [
        "# REM Recorded by an emulated controller of dehyst",
        "# VERSION = 1",
        "# TYPE = 1",
        "# SEPARATOR = 32",
        f"# DIM = {len(tables)}",
        f"# SAMPLE_TIME = {_numeral(controller.record_divider * controller.instrument.servo_period)}",
        f"# NDATA = {len(rows)}",
        *(f"# NAME{index} = {name}" for index, name in enumerate(names)),
        "# END_HEADER",
        *rows,
    ]


class GcsCommand(NamedTuple):
    """A row of `COMMANDS`: what it does, and its least and largest number of arguments.

    `run` returns the lines of the answer, or None where there is none.
    """

    run: Callable
    arguments: tuple = (0, 0)


def _of_axes(value):
    """Return a query of axes or channels, by default of all."""
    return GcsCommand(
        lambda c, given: [f"{axis.name}={_numeral(value(axis))}" for axis in c.chosen(given)], (0, math.inf)
    )


def _to_axes(act):
    """Return a command {axis value}; its axes are done in order, or none if an argument is wrong."""

    def run(controller, given):
        pairs = _groups(given, 2, len(controller.axes))
        axes = controller.chosen([name for name, _ in pairs])
        for axis, value in list(zip(axes, [_real(word) for _, word in pairs], strict=True)):
            act(axis, value)

    return GcsCommand(run, (2, math.inf))


def _to_generators(name, least=0, most=_MOST, more=0):
    """Return a command {generator value} of a setting; `more`: arguments that change nothing here."""

    def run(controller, given):
        groups = _groups(given, 2 + more, len(controller.axes))
        settings = [(controller.generator(number), _whole(value, least, most)) for number, value, *_ in groups]
        for axis, value in settings:
            setattr(axis, name, value)

    return GcsCommand(run, (2 + more, math.inf))


COMMANDS = {
    "*IDN?": GcsCommand(lambda c, _: [c.identity]),
    "DRC": GcsCommand(_set_record, (3, 3)),
    "DRL?": GcsCommand(
        lambda c, given: [f"{n}={c.instrument.recorded}" for n in c.record_tables(given)], (0, math.inf)
    ),
    "DRR?": GcsCommand(_recorded_array, (2, math.inf)),
    "DRT": GcsCommand(_set_trigger, (3, 3)),
    "ERR?": GcsCommand(_take_error),
    "HDR?": GcsCommand(_recorder_help),
    "HLP?": GcsCommand(_list_commands),
    "POS?": _of_axes(lambda axis: 1e6 * axis.bench.displacement()),
    "RTR": GcsCommand(_slow_recorder, (1, 1)),
    "SAI?": GcsCommand(lambda c, _: list(c.named), (0, 1)),
    "SPA?": GcsCommand(_read_parameter, (2, 2)),
    "SVA": _to_axes(_set_voltage),
    "SVO": _to_axes(_set_servo),
    "SVO?": _of_axes(lambda axis: int(axis.bench.servo)),
    "TNR?": GcsCommand(lambda c, _: [str(len(c.records))]),
    "VMA?": _of_axes(lambda axis: axis.reported[1]),
    "VMI?": _of_axes(lambda axis: axis.reported[0]),
    "VOL?": _of_axes(lambda axis: axis.monitor(axis.bench.voltage)),
    "WAV": GcsCommand(_write_wave, (4, math.inf)),
    "WAV?": GcsCommand(_wave_length, (2, 2)),
    "WGC": _to_generators("cycles"),
    "WGO": GcsCommand(_run_waves, (2, math.inf)),
    "WGO?": GcsCommand(
        lambda c, given: [f"{word}={int(c.generator(word).bench.playing)}" for word in given], (1, math.inf)
    ),
    "WSL": _to_generators("table", most=_TABLES),
    "WTR": _to_generators("divider", least=1, more=1),
}
