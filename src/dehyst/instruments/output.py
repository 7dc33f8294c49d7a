"""The voltage that an axis puts out, by what was sent, what was received and the time since."""

from __future__ import annotations

import time
from collections import deque

from dehyst._types import Array

# Batches by which the place in a wave is known; a device this much faster than time is a virtual one.
_RECENT, _FASTER = 5, 1.5
# Seconds by which the place in a wave may be wrong, at least.
_LEAST_DELAY = 0.02


class Output:
    """What an axis puts out: a voltage, or those of a wave (n,) [V] at a `rate` [Hz], since now.

    `speed`: seconds of the device in one of the host.
    """

    def __init__(self, voltage: Array, rate: float = 0.0, speed: float = 1.0) -> None:
        self.voltage, self._rate, self._pace = voltage, rate, speed * rate
        self._began = time.monotonic()
        self._arrived: deque[tuple[float, int]] = deque(maxlen=_RECENT)

    def observe(self, count: int) -> None:
        """Take note that the sample of a number `count` came now."""
        self._arrived.append((time.monotonic(), count))

    def stopped(self, begin: float, *, anywhere: bool) -> tuple[float, float, float]:
        """Return the likeliest voltage, lowest and highest [V] of an output that was stopped between `begin` and now.

        `anywhere`: the device may have stopped by itself since the last sample.
        """
        likely, first, latest = self._rows(begin, time.monotonic(), anywhere=anywhere)
        rows = [min(max(int(row), 0), self.voltage.size - 1) for row in (likely, first, latest)]
        possible = self.voltage[rows[1] : rows[2] + 1]
        return float(self.voltage[rows[0]]), float(possible.min()), float(possible.max())

    def _rows(self, begin: float, end: float, *, anywhere: bool) -> tuple[float, float, float]:
        """Return the likeliest, the first and the last number of the voltage that is put out."""
        if not self._arrived:
            return 0, 0, self._pace * (end - self._began)
        (oldest, old), (newest, count) = self._arrived[0], self._arrived[-1]
        row, ahead = count - 1, self._pace * (end - self._began)
        if len(self._arrived) > 1:
            measured = (count - old) / max(newest - oldest, 1e-9)
            if measured > _FASTER * self._pace:
                # A virtual device has a time of its own.
                return row + self._rate * (end - newest), row, row + measured * (end - self._arrived[-2][0])
            ahead = row + self._pace * (end - oldest)

        def reached(now: float) -> float:
            """Return the row that was put out at a time, by the sample that came with the least delay."""
            return max(number - 1 + self._pace * (now - came) for came, number in self._arrived)

        if anywhere:
            return reached(end), row, max(ahead, reached(end))
        return reached(end), reached(begin), reached(end) + self._pace * max(_LEAST_DELAY, end - begin)
