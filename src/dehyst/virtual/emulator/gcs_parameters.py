"""Parameters of an emulated controller: SPA? and HPA?."""

from __future__ import annotations

from collections.abc import Sequence

from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.emulator.gcs_errors import GcsError, demand, numeral, whole
from dehyst.virtual.stage_bench import StageBench

SERVO_PERIOD, WAVE_POINTS, RECORD_POINTS, SLEW_RATE = 0x0E000200, 0x13000004, 0x16000200, 0x07000201


class Parameters:
    """The read-only parameters of an instrument, by number.

    `instrument`: without a slew rate it has no such parameter. `axes`: share the recorder's memory.
    """

    def __init__(self, instrument: VirtualBench | StageBench, axes: int = 1) -> None:
        self._table = {
            SERVO_PERIOD: (numeral(instrument.servo_period), "FLOAT", "Servo Update Time (s)"),
            WAVE_POINTS: (str(instrument.wave_points), "INT", "Max Wave Points"),
            RECORD_POINTS: (str(instrument.record_points * axes), "INT", "Data Recorder Max Points"),
        }
        if instrument.slew_rate is not None:
            self._table[SLEW_RATE] = (numeral(instrument.slew_rate), "FLOAT", "Open-Loop Slew Rate (V/s)")

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
