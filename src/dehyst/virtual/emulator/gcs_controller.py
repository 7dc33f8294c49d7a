"""An emulated piezo controller with the GCS 2.0 protocol: a line in, an answer out, without sockets."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from dehyst._errors import DeviceError
from dehyst._version import __version__
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.emulator.gcs_errors import CommandError, GcsError, demand, demand_count, lines, numeral, real, whole
from dehyst.virtual.emulator.gcs_parameters import Parameters
from dehyst.virtual.emulator.gcs_recorder import Recorder
from dehyst.virtual.emulator.gcs_waves import WaveGenerator, demand_generator

_LONGEST_LINE = 65536
_IDENTITY = "dehyst,emulated piezo controller"
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


class Controller:
    """One axis, one output channel, one wave generator around an instrument.

    Parameters
    ----------
    instrument : VirtualBench
    axis : str, optional
        Name of the axis and of its channel.
    reported_limits : (float, float), optional
        Limits [V] that the controller reports; default: its actual limits.
    serial : str, optional
        Serial number, in ASCII; default: the instrument's.

    Attributes
    ----------
    error : GcsError
        The error that is latched until ERR?.
    """

    def __init__(
        self,
        instrument: VirtualBench,
        *,
        axis: str = "1",
        reported_limits: tuple[float, float] | None = None,
        serial: str | None = None,
    ) -> None:
        self.instrument, self.axis, self.error = instrument, axis, GcsError.NONE
        self.waves, self.recorder = WaveGenerator(instrument), Recorder(instrument, axis)
        self._reported = reported_limits or instrument.limits
        self._parameters = Parameters(instrument)
        self._serial = (serial or instrument.serial).replace(",", " ")
        self._identity = ",".join((_IDENTITY, self._serial, __version__))
        self._target = 0.0
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
            return f"{int(self.instrument.moving):X}\n"
        if byte == 7:
            return "\xb1\n"
        if byte == 9:
            return f"{int(self.instrument.playing)}\n"
        if byte == 24:
            self._stop([])
        return None

    def _action_table(self) -> dict[str, Callable[[_Words], None]]:
        waves, recorder = self.waves, self.recorder
        return {
            "DRC": recorder.configure,
            "DRT": recorder.arm,
            "HLT": self._stop,
            "MOV": lambda words: self._move(1e-6 * self._value(words)),
            "MVR": lambda words: self._move(self._target + 1e-6 * self._value(words)),
            "RTR": recorder.slow,
            "STP": self._stop,
            "SVA": lambda words: self._send(self._value(words)),
            "SVO": self._svo,
            "SVR": lambda words: self._send(self.instrument.voltage + self._value(words)),
            "WAV": waves.write,
            "WCL": waves.clear,
            "WGC": waves.repeat,
            "WGO": self._wgo,
            "WSL": waves.select,
            "WTR": waves.slow,
        }

    def _query_table(self) -> dict[str, Callable[[_Words], str]]:
        bench, waves, recorder = self.instrument, self.waves, self.recorder
        return {
            "*IDN?": lambda words: self._alone(words, self._identity),
            "CST?": self._each(lambda: "DEHYST"),
            "CSV?": lambda words: self._alone(words, "2.0"),
            "DRC?": lambda words: lines(*recorder.configured(words)),
            "DRL?": lambda words: lines(*recorder.lengths(words)),
            "DRR?": recorder.array,
            "DRT?": lambda words: lines(*recorder.armed(words)),
            "ERR?": self._err,
            "HDR?": lambda words: self._alone(words, *recorder.help()),
            "HLP?": lambda words: self._alone(words, *_help()),
            "HPA?": lambda words: self._alone(words, *self._parameters.help()),
            "MOV?": self._each(lambda: numeral(1e6 * self._target)),
            "ONT?": self._each(lambda: str(int(bench.servo and bench.arrived))),
            "POS?": self._each(lambda: numeral(1e6 * bench.displacement())),
            "PUN?": self._each(lambda: "um"),
            "RTR?": lambda words: self._alone(words, str(recorder.divider)),
            "SAI?": self._sai,
            "SPA?": lambda words: lines(*self._parameters.values(words)),
            "SSN?": lambda words: self._alone(words, self._serial),
            "SVA?": self._each(lambda: numeral(bench.target)),
            "SVO?": self._each(lambda: str(int(bench.servo))),
            "TIM?": lambda words: self._alone(words, numeral(1e3 * bench.now)),
            "TMN?": self._each(lambda: numeral(0.0)),
            "TMX?": self._each(lambda: numeral(1e6 * bench.stroke)),
            "TNR?": lambda words: self._alone(words, str(len(recorder.options))),
            "VER?": lambda words: self._alone(words, f"FW: {__version__}", f"GCS: {self._identity}"),
            "VMA?": self._each(lambda: numeral(self._reported[1])),
            "VMI?": self._each(lambda: numeral(self._reported[0])),
            "VOL?": self._each(lambda: numeral(bench.voltage)),
            "WAV?": lambda words: lines(*waves.lengths(words)),
            "WGC?": self._generator(lambda: str(waves.cycles)),
            "WGO?": self._generator(lambda: str(int(bench.playing))),
            "WSL?": self._generator(lambda: str(waves.selected)),
            "WTR?": self._generator(lambda: f"{waves.divider} {waves.interpolation}"),
        }

    def _each(self, value: Callable[[], str]) -> Callable[[_Words], str]:
        """Return a query of axes or channels, of which there is one."""

        def query(words: _Words) -> str:
            demand(all(word == self.axis for word in words), GcsError.AXIS)
            return lines(*(f"{axis}={value()}" for axis in words or [self.axis]))

        return query

    def _generator(self, value: Callable[[], str]) -> Callable[[_Words], str]:
        """Return a query of wave generators, of which there is one."""

        def query(words: _Words) -> str:
            for word in words:
                whole(word, 1, 1)
            return lines(*(f"1={value()}" for _ in words or "1"))

        return query

    @staticmethod
    def _alone(words: _Words, *answer: str) -> str:
        """Answer a query without arguments."""
        demand_count(words, 0)
        return lines(*answer)

    def _sai(self, words: _Words) -> str:
        demand(not words or [word.upper() for word in words] == ["ALL"], GcsError.PARAMETER_COUNT)
        return lines(self.axis)

    def _err(self, words: _Words) -> str:
        demand_count(words, 0)
        error, self.error = self.error, GcsError.NONE
        return lines(str(error.value))

    def _value(self, words: _Words) -> float:
        demand_count(words, 2)
        demand(words[0] == self.axis, GcsError.AXIS)
        return real(words[1])

    def _send(self, voltage: float) -> None:
        demand(not self.instrument.servo, GcsError.SERVO_ON)
        demand(not self.instrument.playing, GcsError.WAVE_RUNNING)
        demand(self.instrument.set_voltage(voltage), GcsError.VOLTAGE)

    def _svo(self, words: _Words) -> None:
        on = self._value(words)
        demand(on in (0, 1), GcsError.PARAMETER_RANGE)
        demand(not self.instrument.playing, GcsError.WAVE_RUNNING)
        if bool(on) != self.instrument.servo:
            self.instrument.servo = bool(on)
            self._target = self.instrument.displacement()

    def _move(self, target: float) -> None:
        demand(self.instrument.servo, GcsError.SERVO_OFF)
        # A target at the end of the range is allowed although micrometres are rounded.
        demand(-1e-12 <= target <= self.instrument.stroke + 1e-12, GcsError.POSITION)
        self.instrument.move(target)
        self._target = target

    def _wgo(self, words: _Words) -> None:
        demand_generator(words, 2)
        mode = whole(words[1], 0, 1)
        if not mode:
            if self.instrument.playing:
                self.instrument.stop()
            return
        demand(not self.instrument.servo, GcsError.WAVE_WITH_SERVO)
        demand(not self.instrument.playing, GcsError.WAVE_RUNNING)
        wave = self.waves.selected_wave()
        self.recorder.begin(self.waves.divider)
        self.instrument.start(wave, self.waves.divider)

    def _stop(self, words: _Words) -> None:
        demand(all(word == self.axis for word in words), GcsError.AXIS)
        self.instrument.stop()
        self._target = self.instrument.displacement()
        self.error = GcsError.STOPPED


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
