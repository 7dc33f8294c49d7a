"""Memories of an emulated controller: wave tables (WAV, WSL, WGC, WTR), and the data recorder (DRC, DRT, RTR, DRR?)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.virtual.bench import BenchAxis, VirtualBench
from dehyst.virtual.emulator.gcs_errors import CommandError, GcsError, demand, demand_count, lines, numeral, real, whole

TABLES = 4
# Points that one command line may bring.
_LONGEST_SEGMENT = 4096
# What a recorder records, by its number.
POSITION, VOLTAGE, NOTHING = 2, 16, 0
NAMES = {NOTHING: "Nothing is recorded", POSITION: "Current Position of axis", VOLTAGE: "Voltage of output chn"}
Sources = Mapping[str, Callable[[], tuple[Array, Array, Array]]]


@dataclass
class GeneratorSettings:
    """The settings of one wave generator: its table (0: none), cycles, divider and interpolation."""

    selected: int = 0
    cycles: int = 0
    divider: int = 1
    interpolation: int = 1

    @property
    def rate(self) -> str:
        """The answer to WTR?."""
        return f"{self.divider} {self.interpolation}"


class WaveGenerators:
    """The wave tables, and the settings of a wave generator an axis.

    `instrument`: whose wave table size applies. `benches`: that of each axis, whose limits apply.
    """

    def __init__(self, instrument: VirtualBench, benches: Sequence[BenchAxis]) -> None:
        self._instrument, self._benches = instrument, benches
        self._count = max(TABLES, len(benches))
        self.tables: dict[int, Array] = {number: np.zeros(0) for number in range(1, self._count + 1)}
        self.settings = {number: GeneratorSettings() for number in range(1, len(benches) + 1)}
        self._shapes: dict[str, Callable[[Sequence[str]], Array]] = {
            "PNT": self._points,
            "SIN_P": self._sine,
            "LIN": _line,
            "RAMP": self._ramp,
        }

    def write(self, words: Sequence[str]) -> None:
        """Do WAV table X|& shape ...: write a table, or append to it."""
        demand(len(words) >= 4, GcsError.MISSING)
        number, how, kind = whole(words[0], 1, self._count), words[1].upper(), words[2].upper()
        demand(how in ("X", "&") and kind in self._shapes, GcsError.PARAMETER_RANGE)
        for bench, settings in zip(self._benches, self.settings.values(), strict=True):
            demand(settings.selected != number or not bench.playing, GcsError.WAVE_RUNNING)
        segment = self._shapes[kind](words[3:])
        if not any(low <= segment.min() and segment.max() <= high for low, high in (b.limits for b in self._benches)):
            self._benches[0].log.refused += 1
            raise CommandError(GcsError.VOLTAGE)
        table = segment if how == "X" else np.concatenate([self.tables[number], segment])
        demand(table.size <= self._instrument.wave_points, GcsError.WAVE_TOO_LARGE)
        self.tables[number] = table

    def clear(self, words: Sequence[str]) -> None:
        """Do WCL table."""
        demand_count(words, 1)
        self.tables[whole(words[0], 1, self._count)] = np.zeros(0)

    def lengths(self, words: Sequence[str]) -> list[str]:
        """Answer WAV? [table [1]]: number of points of each table."""
        demand_count(words, 0, 2)
        demand(len(words) < 2 or whole(words[1]) == 1, GcsError.PARAMETER_RANGE)
        numbers = [whole(words[0], 1, self._count)] if words else list(self.tables)
        return [f"{number} 1={self.tables[number].size}" for number in numbers]

    def select(self, words: Sequence[str]) -> None:
        """Do WSL {generator table}, where 0 is none."""
        for number, table in self._pairs(words, self._count):
            self.settings[number].selected = table

    def repeat(self, words: Sequence[str]) -> None:
        """Do WGC {generator cycles}, where 0 is as many as the generator takes."""
        for number, cycles in self._pairs(words):
            self.settings[number].cycles = cycles

    def slow(self, words: Sequence[str]) -> None:
        """Do WTR {generator divider interpolation}; generator 0 is all of them."""
        given = [
            (whole(number, 0, len(self.settings)), whole(divider, 1, 10**6), whole(kind, 0, 1))
            for number, divider, kind in groups(words, 3, len(self.settings))
        ]
        for number, divider, kind in given:
            for settings in [self.settings[number]] if number else self.settings.values():
                settings.divider, settings.interpolation = divider, kind

    def selected_wave(self, number: int) -> Array:
        """Return the voltages (n,) [V] that a start of generator `number` plays."""
        settings = self.settings[number]
        table = self.tables.get(settings.selected, np.zeros(0))
        demand(table.size > 0, GcsError.NO_WAVE_SELECTED)
        most = self._instrument.wave_points // table.size
        demand(settings.cycles <= most, GcsError.WAVE_TOO_LARGE)
        return np.tile(table, settings.cycles or most)

    def _pairs(self, words: Sequence[str], most: int | None = None) -> list[tuple[int, int]]:
        pairs = groups(words, 2, len(self.settings))
        return [(whole(number, 1, len(self.settings)), whole(value, 0, most)) for number, value in pairs]

    def _points(self, words: Sequence[str]) -> Array:
        demand(len(words) >= 3, GcsError.MISSING)
        whole(words[0])
        size = whole(words[1], 1, _LONGEST_SEGMENT)
        demand_count(words, 2 + size)
        return np.array([real(word) for word in words[2:]])

    def _curve(self, words: Sequence[str], count: int) -> tuple[Array, float, float, int, list[int]]:
        """Return points (n,) after the start of a curve, its amplitude, offset and length, and the other numbers."""
        demand_count(words, count)
        size, amplitude, offset = whole(words[0], 1, self._instrument.wave_points), real(words[1]), real(words[2])
        length = whole(words[3], 1, size)
        start, *rest = (whole(word, 0, size) for word in words[4:])
        return np.arange(size, dtype=np.float64) - start, amplitude, offset, length, rest

    def _sine(self, words: Sequence[str]) -> Array:
        """Read SIN_P size amplitude offset length start centre: one raised cosine."""
        point, amplitude, offset, length, (centre,) = self._curve(words, 6)
        return np.asarray(offset + amplitude * 0.5 * (1 - np.cos(2 * np.pi * _phase(point, length, centre))))

    def _ramp(self, words: Sequence[str]) -> Array:
        """Read RAMP size amplitude offset length start speed centre: up and down, with sharp corners."""
        point, amplitude, offset, length, (_, centre) = self._curve(words, 7)
        phase = _phase(point, length, centre)
        return np.asarray(offset + amplitude * (1 - np.abs(1 - 2 * phase)))


def _line(words: Sequence[str]) -> Array:
    """Read LIN size amplitude offset length start speed: one rise, with sharp corners."""
    demand_count(words, 6)
    size, amplitude, offset = whole(words[0], 1, 10**6), real(words[1]), real(words[2])
    length, start = whole(words[3], 1, size), whole(words[4], 0, size)
    whole(words[5], 0, size)
    share = np.clip((np.arange(size) - start) / max(1, length - 1), 0.0, 1.0)
    return np.asarray(offset + amplitude * share)


def _phase(point: Array, length: int, centre: int) -> Array:
    """Return the share of a curve before each point (n,): a half at its centre."""
    demand(0 < centre < length, GcsError.PARAMETER_RANGE)
    inside = np.clip(point, 0, length)
    return np.interp(inside, [0.0, centre, length], [0.0, 0.5, 1.0])


def groups(words: Sequence[str], size: int, most: int) -> list[Sequence[str]]:
    """Return arguments in groups of `size`: one group at least, `most` at most; raises CommandError."""
    demand_count(words, size, size * most)
    demand(len(words) % size == 0, GcsError.MISSING)
    return [words[first : first + size] for first in range(0, len(words), size)]


class Recorder:
    """The configuration of the data recorder, and its answers.

    Parameters
    ----------
    instrument : VirtualBench
    sources : mapping
        For each name of an axis, which is that of its output channel too, a function that returns what was recorded.

    Attributes
    ----------
    rows_sent : int
        Rows that DRR? has returned so far.
    """

    def __init__(self, instrument: VirtualBench, sources: Sources) -> None:
        self._instrument, self._from = instrument, sources
        kinds = [(axis, kind) for axis in sources for kind in (POSITION, VOLTAGE)]
        self.options = {table: kind for table, (_, kind) in enumerate(kinds, 1)}
        self._axes = {table: axis for table, (axis, _) in enumerate(kinds, 1)}
        self.trigger = ("1", "0")
        self.divider, self._stride, self._period = 1, 1, instrument.servo_period
        self.rows_sent = 0

    def begin(self, divider: int) -> None:
        """Prepare for a wave with samples `divider` servo periods apart; the recorder takes each, or every nth."""
        demand(self.divider % divider == 0, GcsError.PARAMETER_RANGE)
        self._stride = self.divider // divider
        self._period = self.divider * self._instrument.servo_period

    @property
    def count(self) -> int:
        """Number of recorded rows."""
        return -(-self._instrument.recorded // self._stride)

    def configure(self, words: Sequence[str]) -> None:
        """Do DRC table source option."""
        demand_count(words, 3)
        table = self._table(words[0])
        demand(words[1] in self._from, GcsError.AXIS)
        option = whole(words[2])
        demand(option in NAMES, GcsError.RECORD_OPTION)
        self.options[table], self._axes[table] = option, words[1]

    def configured(self, words: Sequence[str]) -> list[str]:
        """Answer DRC? [table]."""
        return [f"{table}={self._axes[table]} {self.options[table]}" for table in self._tables(words)]

    def arm(self, words: Sequence[str]) -> None:
        """Do DRT table trigger value; a wave triggers the recorder in any case."""
        demand_count(words, 3)
        whole(words[0], 0, len(self.options), GcsError.RECORD_TABLE)
        whole(words[1], 0, 4)
        self.trigger = (words[1], words[2])

    def armed(self, words: Sequence[str]) -> list[str]:
        """Answer DRT? [table]."""
        return [f"{table}={' '.join(self.trigger)}" for table in self._tables(words)]

    def slow(self, words: Sequence[str]) -> None:
        """Do RTR divider."""
        demand_count(words, 1)
        self.divider = whole(words[0], 1, 10**6)

    def lengths(self, words: Sequence[str]) -> list[str]:
        """Answer DRL? [table]: rows recorded so far."""
        return [f"{table}={self.count}" for table in self._tables(words)]

    def array(self, words: Sequence[str]) -> str:
        """Answer DRR? [first [count [table ...]]]: recorded rows from `first`, which is 1 or more."""
        first = whole(words[0], 1) if words else 1
        count = whole(words[1], 1) if len(words) > 1 else self.count
        tables = [self._table(word) for word in words[2:]] or list(self.options)
        available = self.count
        demand(first <= available, GcsError.NOT_RECORDED)
        stop = min(available, first - 1 + count)
        columns = [self._column(table)[first - 1 : stop].tolist() for table in tables]
        rows = [" ".join(map(numeral, row)) for row in zip(*columns, strict=True)]
        self.rows_sent += len(rows)
        return lines(*self._header(tables, stop - first + 1), *rows)

    def help(self) -> list[str]:
        """Answer HDR?: what can be recorded."""
        return [
            "#RecordOptions",
            *(f"{option}={name}" for option, name in NAMES.items()),
            "#TriggerOptions",
            "0=default setting",
            "1=any command that changes the output, and the start of a wave",
            "#Additional information",
            f"{len(self.options)} record tables",
            f"{self._instrument.record_points} datapoints per table",
            "end of help",
        ]

    def _table(self, word: str) -> int:
        return whole(word, 1, len(self.options), GcsError.RECORD_TABLE)

    def _tables(self, words: Sequence[str]) -> list[int]:
        return [self._table(word) for word in words] or list(self.options)

    def _column(self, table: int) -> Array:
        time, voltage, displacement = (column[:: self._stride] for column in self._from[self._axes[table]]())
        return {POSITION: displacement * 1e6, VOLTAGE: voltage, NOTHING: time * 0.0}[self.options[table]]

    def _header(self, tables: list[int], count: int) -> list[str]:
        suffix = {NOTHING: ""}
        names = [NAMES[self.options[table]] + suffix.get(self.options[table], self._axes[table]) for table in tables]
        return [
            "# REM Recorded by an emulated controller of dehyst",
            "# VERSION = 1",
            "# TYPE = 1",
            "# SEPARATOR = 32",
            f"# DIM = {len(tables)}",
            f"# SAMPLE_TIME = {numeral(self._period)}",
            f"# NDATA = {count}",
            *(f"# NAME{index} = {name}" for index, name in enumerate(names)),
            "# END_HEADER",
        ]
