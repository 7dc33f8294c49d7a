"""An emulated piezo controller with the GCS 2.0 protocol: a line in, an answer out, without sockets."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from dehyst._errors import DeviceError
from dehyst._version import __version__
from dehyst.virtual.bench import BenchAxis, VirtualBench
from dehyst.virtual.emulator.gcs_errors import CommandError, GcsError, demand, demand_count, lines, numeral, real, whole
from dehyst.virtual.emulator.gcs_waves import Recorder, WaveGenerators, groups

_LONGEST_LINE = 65536
_IDENTITY = "dehyst,emulated piezo controller"
# Numbers of the parameters that SPA? and HPA? answer.
_SERVO_PERIOD, _WAVE_POINTS, _RECORD_POINTS, _SLEW_RATE = 0x0E000200, 0x13000004, 0x16000200, 0x07000201
# The answer to HLP?: a description of each command.
_DESCRIPTIONS = {
    "*IDN?": "Get device identification",
    "CST?": "Get assignment of stages to axes",
    "CSV?": "Get syntax version",
    "DRC": "Set data recorder configuration {table source option}",
    "DRC?": "Get data recorder configuration",
    "DRL?": "Get number of recorded points",
    "DRR?": "Get recorded data {[first [count [table]]]}",
    "DRT": "Set data recorder trigger source {table trigger value}",
    "DRT?": "Get data recorder trigger source",
    "ERR?": "Get error number",
    "HDR?": "Get help for data recording",
    "HLP?": "Get list of commands",
    "HLT": "Halt motion",
    "HPA?": "Get list of parameters",
    "MOV": "Set target position {axis position}",
    "MOV?": "Get target position",
    "MVR": "Set target relative to present target {axis distance}",
    "ONT?": "Get on-target state",
    "POS?": "Get real position",
    "PUN?": "Get unit of position",
    "RTR": "Set record table rate {divider}",
    "RTR?": "Get record table rate",
    "SAI?": "Get list of axes {[ALL]}",
    "SPA?": "Get parameters {[item parameter]}",
    "SSN?": "Get serial number",
    "STP": "Stop all axes",
    "SVA": "Set open-loop value {axis voltage}",
    "SVA?": "Get open-loop value",
    "SVO": "Set servo mode {axis state}",
    "SVO?": "Get servo mode",
    "SVR": "Set relative open-loop value {axis voltage}",
    "TIM?": "Get timer value in ms",
    "TMN?": "Get lowest position",
    "TMX?": "Get highest position",
    "TNR?": "Get number of record tables",
    "VER?": "Get versions",
    "VMA?": "Get highest voltage",
    "VMI?": "Get lowest voltage",
    "VOL?": "Get voltage of output channel",
    "WAV": "Set waveform {table X|& shape ...}",
    "WAV?": "Get wave tables",
    "WCL": "Clear wave table {table}",
    "WGC": "Set number of cycles {generator cycles}",
    "WGC?": "Get number of cycles",
    "WGO": "Start or stop wave generator {generator mode}",
    "WGO?": "Get wave generator state",
    "WSL": "Set connection of wave table {generator table}",
    "WSL?": "Get connection of wave table",
    "WTR": "Set wave generator rate {generator divider interpolation}",
    "WTR?": "Get wave generator rate",
}

_Words = Sequence[str]
Limits = tuple[float, float]


class Parameters:
    """The read-only parameters of an instrument, by number.

    `instrument`: without a slew rate it has no such parameter. `axes`: share the recorder's memory.
    """

    def __init__(self, instrument: VirtualBench, axes: int) -> None:
        self._table = {
            _SERVO_PERIOD: (numeral(instrument.servo_period), "FLOAT", "Servo Update Time (s)"),
            _WAVE_POINTS: (str(instrument.wave_points), "INT", "Max Wave Points"),
            _RECORD_POINTS: (str(instrument.record_points * axes), "INT", "Data Recorder Max Points"),
        }
        if instrument.slew_rate is not None:
            self._table[_SLEW_RATE] = (numeral(instrument.slew_rate), "FLOAT", "Open-Loop Slew Rate (V/s)")

    def values(self, words: Sequence[str]) -> list[str]:
        """Answer SPA? [item parameter ...]: their values."""
        demand(len(words) % 2 == 0, GcsError.MISSING)
        demand(all(item == "1" for item in words[::2]), GcsError.PARAMETER_RANGE)
        numbers = [whole(word) for word in words[1::2]] or list(self._table)
        demand(all(number in self._table for number in numbers), GcsError.UNKNOWN_PARAMETER)
        return [f"1 0x{number:08X}={self._table[number][0]}" for number in numbers]

    def help(self) -> list[str]:
        """Answer HPA?: number, command level, items, type, group and name of each."""
        return [
            *(f"0x{number:08X}=0\t1\t{kind}\tdevice\t{name}" for number, (_, kind, name) in self._table.items()),
            "end of help",
        ]


class ControllerAxis:
    """One axis of a controller: its name, its `bench`, the limits [V] it `reported`, and its `target` [m]."""

    def __init__(self, name: str, bench: BenchAxis, reported: tuple[float, float]) -> None:
        self.name, self.bench, self.reported, self.target = name, bench, reported, 0.0


class Controller:
    """Axes with an output channel and a wave generator each, and one data recorder, around an instrument.

    Parameters
    ----------
    instrument : VirtualBench
    axis : str, optional
        Name of the only axis and of its channel; those of several are 1, 2, ...
    reported_limits : (float, float) or sequence of (float, float), optional
        Limits [V] that the controller reports, of its only axis or of each; default: its actual limits.
    serial : str, optional
        Serial number, in ASCII; default: the instrument's.

    Attributes
    ----------
    axes : tuple of ControllerAxis
    error : GcsError
        The error that is latched until ERR?.
    """

    def __init__(
        self,
        instrument: VirtualBench,
        *,
        axis: str = "1",
        reported_limits: Limits | Sequence[Limits] | None = None,
        serial: str | None = None,
    ) -> None:
        self.instrument, self.error = instrument, GcsError.NONE
        names = [axis] if len(instrument.axes) == 1 else [str(number + 1) for number in range(len(instrument.axes))]
        own = [one.limits for one in instrument.axes]
        limits = np.array(own if reported_limits is None else reported_limits).reshape(len(own), 2).tolist()
        self.axes = tuple(
            ControllerAxis(name, bench, (low, high))
            for name, bench, (low, high) in zip(names, instrument.axes, limits, strict=True)
        )
        self.axis = self.axes[0].name
        self._named = {one.name: one for one in self.axes}
        self.waves = WaveGenerators(instrument, [one.bench for one in self.axes])
        self.recorder = Recorder(
            instrument, {name: partial(instrument.samples, axis=j) for j, name in enumerate(names)}
        )
        self._parameters = Parameters(instrument, len(self.axes))
        self._serial = (serial or instrument.serial).replace(",", " ")
        self._identity = ",".join((_IDENTITY, self._serial, __version__))
        self._actions = self._action_table()
        self._queries = self._query_table()

    def answer(self, line: str) -> str | None:
        """Return the answer to a `line`: one line or several, or None; a command that fails latches its error."""
        words = line.split()
        if not words:
            return None
        command, rest = words[0].upper(), words[1:]
        self.instrument.advance()
        try:
            demand(len(line) <= _LONGEST_LINE, GcsError.TOO_LONG)
            if command in self._queries:
                return self._queries[command](rest)
            demand(command in self._actions, GcsError.UNKNOWN_COMMAND)
            self._actions[command](rest)
        except CommandError as refusal:
            self.error = refusal.error
        except DeviceError:
            self.error = GcsError.PARAMETER_RANGE
        return None

    def single(self, byte: int) -> str | None:
        """Return the answer to a command of one `byte`: #5 moving, #7 ready, #9 playing, #24 stop."""
        self.instrument.advance()
        if byte == 5:
            return f"{sum(one.bench.moving << number for number, one in enumerate(self.axes)):X}\n"
        if byte == 7:
            return "\xb1\n"
        if byte == 9:
            return f"{sum(one.bench.playing << number for number, one in enumerate(self.axes)):X}\n"
        if byte == 24:
            self._stop([])
        return None

    def _action_table(self) -> dict[str, Callable[[_Words], None]]:
        waves, recorder = self.waves, self.recorder
        return {
            "DRC": recorder.configure,
            "DRT": recorder.arm,
            "HLT": self._stop,
            "MOV": self._with_values(lambda one, value: _move(one, 1e-6 * value)),
            "MVR": self._with_values(lambda one, value: _move(one, one.target + 1e-6 * value)),
            "RTR": recorder.slow,
            "STP": self._stop,
            "SVA": self._with_values(_send),
            "SVO": self._with_values(_close_loop),
            "SVR": self._with_values(lambda one, value: _send(one, one.bench.voltage + value)),
            "WAV": waves.write,
            "WCL": waves.clear,
            "WGC": waves.repeat,
            "WGO": self._wgo,
            "WSL": waves.select,
            "WTR": waves.slow,
        }

    def _query_table(self) -> dict[str, Callable[[_Words], str]]:
        waves, recorder = self.waves, self.recorder
        return {
            "*IDN?": lambda words: self._alone(words, self._identity),
            "CST?": self._each(lambda _: "DEHYST"),
            "CSV?": lambda words: self._alone(words, "2.0"),
            "DRC?": lambda words: lines(*recorder.configured(words)),
            "DRL?": lambda words: lines(*recorder.lengths(words)),
            "DRR?": recorder.array,
            "DRT?": lambda words: lines(*recorder.armed(words)),
            "ERR?": self._err,
            "HDR?": lambda words: self._alone(words, *recorder.help()),
            "HLP?": lambda words: self._alone(words, *_help()),
            "HPA?": lambda words: self._alone(words, *self._parameters.help()),
            "MOV?": self._each(lambda one: numeral(1e6 * one.target)),
            "ONT?": self._each(lambda one: str(int(one.bench.servo and one.bench.arrived))),
            "POS?": self._each(lambda one: numeral(1e6 * one.bench.displacement())),
            "PUN?": self._each(lambda _: "um"),
            "RTR?": lambda words: self._alone(words, str(recorder.divider)),
            "SAI?": self._sai,
            "SPA?": lambda words: lines(*self._parameters.values(words)),
            "SSN?": lambda words: self._alone(words, self._serial),
            "SVA?": self._each(lambda one: numeral(one.bench.target)),
            "SVO?": self._each(lambda one: str(int(one.bench.servo))),
            "TIM?": lambda words: self._alone(words, numeral(1e3 * self.instrument.now)),
            "TMN?": self._each(lambda _: numeral(0.0)),
            "TMX?": self._each(lambda one: numeral(1e6 * one.bench.stroke)),
            "TNR?": lambda words: self._alone(words, str(len(recorder.options))),
            "VER?": lambda words: self._alone(words, f"FW: {__version__}", f"GCS: {self._identity}"),
            "VMA?": self._each(lambda one: numeral(one.reported[1])),
            "VMI?": self._each(lambda one: numeral(one.reported[0])),
            "VOL?": self._each(lambda one: numeral(one.bench.voltage)),
            "WAV?": lambda words: lines(*waves.lengths(words)),
            "WGC?": self._generator(lambda number: str(waves.settings[number].cycles)),
            "WGO?": self._generator(lambda number: str(int(self.axes[number - 1].bench.playing))),
            "WSL?": self._generator(lambda number: str(waves.settings[number].selected)),
            "WTR?": self._generator(lambda number: waves.settings[number].rate),
        }

    def _each(self, value: Callable[[ControllerAxis], str]) -> Callable[[_Words], str]:
        """Return a query of axes or channels."""

        def query(words: _Words) -> str:
            demand(all(word in self._named for word in words), GcsError.AXIS)
            return lines(*(f"{axis}={value(self._named[axis])}" for axis in words or self._named))

        return query

    def _generator(self, value: Callable[[int], str]) -> Callable[[_Words], str]:
        """Return a query of wave generators."""

        def query(words: _Words) -> str:
            numbers = [whole(word, 1, len(self.axes)) for word in words]
            return lines(*(f"{number}={value(number)}" for number in numbers or range(1, len(self.axes) + 1)))

        return query

    def _with_values(self, action: Callable[[ControllerAxis, float], None]) -> Callable[[_Words], None]:
        """Return a command {axis value}; its axes are done in order."""

        def command(words: _Words) -> None:
            pairs = groups(words, 2, len(self.axes))
            demand(all(name in self._named for name, _ in pairs), GcsError.AXIS)
            for name, value in [(name, real(word)) for name, word in pairs]:
                action(self._named[name], value)

        return command

    @staticmethod
    def _alone(words: _Words, *answer: str) -> str:
        """Answer a query without arguments."""
        demand_count(words, 0)
        return lines(*answer)

    def _sai(self, words: _Words) -> str:
        demand(not words or [word.upper() for word in words] == ["ALL"], GcsError.PARAMETER_COUNT)
        return lines(*self._named)

    def _err(self, words: _Words) -> str:
        demand_count(words, 0)
        error, self.error = self.error, GcsError.NONE
        return lines(str(error.value))

    def _wgo(self, words: _Words) -> None:
        pairs = groups(words, 2, len(self.axes))
        modes = {whole(number, 1, len(self.axes)): whole(mode, 0, 1) for number, mode in pairs}
        for number in [number for number, mode in modes.items() if not mode]:
            bench = self.axes[number - 1].bench
            if bench.playing:
                bench.stop()
        if started := [number for number, mode in modes.items() if mode]:
            self._start(started)

    def _start(self, numbers: Sequence[int]) -> None:
        """Start these wave generators at one instant."""
        benches = [self.axes[number - 1].bench for number in numbers]
        demand(not any(bench.servo for bench in benches), GcsError.WAVE_WITH_SERVO)
        demand(not any(one.bench.playing for one in self.axes), GcsError.WAVE_RUNNING)
        waves = {number - 1: self.waves.selected_wave(number) for number in numbers}
        dividers = {self.waves.settings[number].divider for number in numbers}
        # One recorder records all axes.
        demand(len(dividers) == 1, GcsError.PARAMETER_RANGE)
        (divider,) = dividers
        self.recorder.begin(divider)
        self.instrument.start(waves, divider)

    def _stop(self, words: _Words) -> None:
        demand(all(word in self._named for word in words), GcsError.AXIS)
        for one in [self._named[word] for word in words] or self.axes:
            one.bench.stop()
            one.target = one.bench.displacement()
        self.error = GcsError.STOPPED


def _send(axis: ControllerAxis, voltage: float) -> None:
    demand(not axis.bench.servo, GcsError.SERVO_ON)
    demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    demand(axis.bench.set_voltage(voltage), GcsError.VOLTAGE)


def _close_loop(axis: ControllerAxis, on: float) -> None:
    demand(on in (0, 1), GcsError.PARAMETER_RANGE)
    demand(not axis.bench.playing, GcsError.WAVE_RUNNING)
    if bool(on) != axis.bench.servo:
        axis.bench.servo = bool(on)
        axis.target = axis.bench.displacement()


def _move(axis: ControllerAxis, target: float) -> None:
    demand(axis.bench.servo, GcsError.SERVO_OFF)
    # A target at the end of the range is allowed although micrometres are rounded.
    demand(-1e-12 <= target <= axis.bench.stroke + 1e-12, GcsError.POSITION)
    axis.bench.move(target)
    axis.target = target


def _help() -> list[str]:
    return [
        "The following commands are valid:",
        "#5 Request motion status",
        "#7 Request controller ready status",
        "#9 Get wave generator status",
        "#24 Stop all motion",
        *(f"{command} {words}" for command, words in _DESCRIPTIONS.items()),
        "end of help",
    ]
