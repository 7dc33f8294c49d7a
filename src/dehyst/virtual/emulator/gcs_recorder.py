"""The data recorder of an emulated controller: DRC, DRT, RTR, and the GCS array that DRR? returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from dehyst._types import Array
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.emulator.gcs_errors import GcsError, demand, demand_count, lines, numeral, whole
from dehyst.virtual.stage_bench import StageBench

POSITION, VOLTAGE, NOTHING = 2, 16, 0
NAMES = {NOTHING: "Nothing is recorded", POSITION: "Current Position of axis", VOLTAGE: "Voltage of output chn"}
# Tables for each axis.
TABLES = 2

Sources = Mapping[str, Callable[[], tuple[Array, Array, Array]]]


class Recorder:
    """The configuration of the data recorder, and its answers.

    Parameters
    ----------
    instrument : VirtualBench or StageBench
    sources : mapping
        For each name of an axis, which is that of its output channel too, a function that returns what was recorded.

    Attributes
    ----------
    rows_sent : int
        Rows that DRR? has returned so far.
    """

    def __init__(self, instrument: VirtualBench | StageBench, sources: Sources) -> None:
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
