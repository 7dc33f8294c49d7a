"""Wave tables of an emulated controller: WAV, WSL, WGC, WTR and the wave that WGO plays."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dehyst._types import Array
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.emulator.gcs_errors import CommandError, GcsError, demand, demand_count, real, whole

TABLES = 4
# Points that one command line may bring.
_LONGEST_SEGMENT = 4096


class WaveGenerator:
    """The settings and tables of the wave generator.

    `instrument`: the instrument whose limits and wave table size apply.
    """

    def __init__(self, instrument: VirtualBench) -> None:
        self._instrument = instrument
        self.tables: dict[int, Array] = {number: np.zeros(0) for number in range(1, TABLES + 1)}
        self.selected, self.cycles, self.divider, self.interpolation = 0, 0, 1, 1
        self._shapes: dict[str, Callable[[Sequence[str]], Array]] = {
            "PNT": self._points,
            "SIN_P": self._sine,
            "LIN": _line,
            "RAMP": self._ramp,
        }

    def write(self, words: Sequence[str]) -> None:
        """Do WAV table X|& shape ...: write a table, or append to it."""
        demand(len(words) >= 4, GcsError.MISSING)
        number, how, kind = whole(words[0], 1, TABLES), words[1].upper(), words[2].upper()
        demand(how in ("X", "&") and kind in self._shapes, GcsError.PARAMETER_RANGE)
        demand(self.selected != number or not self._instrument.playing, GcsError.WAVE_RUNNING)
        segment = self._shapes[kind](words[3:])
        low, high = self._instrument.limits
        if segment.min() < low or segment.max() > high:
            self._instrument.log.refused += 1
            raise CommandError(GcsError.VOLTAGE)
        table = segment if how == "X" else np.concatenate([self.tables[number], segment])
        demand(table.size <= self._instrument.wave_points, GcsError.WAVE_TOO_LARGE)
        self.tables[number] = table

    def clear(self, words: Sequence[str]) -> None:
        """Do WCL table."""
        demand_count(words, 1)
        self.tables[whole(words[0], 1, TABLES)] = np.zeros(0)

    def lengths(self, words: Sequence[str]) -> list[str]:
        """Answer WAV? [table [1]]: number of points of each table."""
        demand_count(words, 0, 2)
        demand(len(words) < 2 or whole(words[1]) == 1, GcsError.PARAMETER_RANGE)
        numbers = [whole(words[0], 1, TABLES)] if words else list(self.tables)
        return [f"{number} 1={self.tables[number].size}" for number in numbers]

    def select(self, words: Sequence[str]) -> None:
        """Do WSL generator table, where 0 is none."""
        demand_generator(words, 2)
        self.selected = whole(words[1], 0, TABLES)

    def repeat(self, words: Sequence[str]) -> None:
        """Do WGC generator cycles, where 0 is as many as the generator takes."""
        demand_generator(words, 2)
        self.cycles = whole(words[1])

    def slow(self, words: Sequence[str]) -> None:
        """Do WTR generator divider interpolation."""
        demand_count(words, 3)
        demand(whole(words[0]) in (0, 1), GcsError.PARAMETER_RANGE)
        divider, interpolation = whole(words[1], 1, 10**6), whole(words[2], 0, 1)
        self.divider, self.interpolation = divider, interpolation

    def selected_wave(self) -> Array:
        """Return the voltages (n,) [V] that a start plays."""
        demand(self.selected in self.tables and self.tables[self.selected].size > 0, GcsError.NO_WAVE_SELECTED)
        table = self.tables[self.selected]
        most = self._instrument.wave_points // table.size
        demand(self.cycles <= most, GcsError.WAVE_TOO_LARGE)
        return np.tile(table, self.cycles or most)

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


def demand_generator(words: Sequence[str], count: int) -> None:
    """Raise CommandError for a wave generator other than 1, or another number of arguments."""
    demand_count(words, count)
    whole(words[0], 1, 1)
