"""Live data: samples as they arrive, thinned to ten messages a second."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.instruments import Reading, Samples

# Seconds between two messages, and between two changes of the state.
_PERIOD, _STATE_PERIOD = 0.1, 1.0
# Most samples of one message.
MOST = 200
# Digits of a number: a microvolt and less than a picometre.
_DIGITS = 6


class LiveFeed:
    """A listener of waves and calibrations; it sends live data and the progress, and stops where it must.

    Parameters
    ----------
    live : callable
        Takes a message of live data.
    state : callable
        Takes changed fields of the state, as keywords.
    check : callable
        Called after each batch of samples, which is on disk by then; it raises to stop the wave.

    Attributes
    ----------
    status : str
        Sent with each message.
    last : Reading or None
        The last sample.
    seen_at : float
        When it came [s of time.monotonic].
    count : int
        Samples of the present step.
    """

    def __init__(
        self, live: Callable[[dict[str, Any]], None], state: Callable[..., None], check: Callable[[], None]
    ) -> None:
        self._live, self._state, self._check = live, state, check
        self.status, self.seen_at, self.count = "none", 0.0, 0
        self.last: Reading | None = None
        self._step: str | None = None
        self._first: float | None = None
        self._share: float | None = None
        self._seconds = 0.0
        self._batches: list[tuple[Array, Array, Array, Array]] = []
        self._sent_at = self._state_at = -np.inf

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Begin the step `name`, which plays for `seconds` [s]; 0 for one that computes."""
        self.flush()
        self._check()
        self._step, self._seconds, self._first, self.count = name, seconds, None, 0
        self._share = 0.0 if seconds else None
        self._state(step=name, progress=self._share, words=[])

    def message(self, text: str) -> None:
        """Send a `text` on what the step does now."""
        self._check()
        self._state(words=[text])

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Send `samples` that are on disk; `expected` (n,) [m] is their wanted displacement."""
        if samples.time.size:
            wanted = np.full(samples.time.size, np.nan) if expected is None else np.asarray(expected, dtype=np.float64)
            self._batches.append((*samples, wanted))
            self.last = last = Reading(*(float(column[-1]) for column in samples))
            self.seen_at = time.monotonic()
            self.count += samples.time.size
            self._first = float(samples.time[0]) if self._first is None else self._first
            if self._seconds:
                self._share = min(1.0, (last.time - self._first) / self._seconds)
            if self.seen_at - self._sent_at >= _PERIOD:
                self.flush()
        self._check()

    def reading(self, reading: Reading) -> None:
        """Send one `reading` of a rig at rest."""
        self.samples(Samples(*(np.array([value]) for value in reading)))

    def end(self) -> None:
        """End the last step."""
        self.flush()
        self._step, self._share, self._seconds = None, None, 0.0
        self._state(step=None, progress=None, **self._present())

    def flush(self) -> None:
        """Send the samples since the last message."""
        if not self._batches:
            return
        time_, voltage, displacement, wanted = (np.concatenate(column) for column in zip(*self._batches, strict=True))
        self._batches, self._sent_at = [], time.monotonic()
        rows = thinned(voltage)
        self._live(
            {
                "kind": "live",
                "t": _numbers(time_[rows]),
                "v": _numbers(voltage[rows]),
                "y": _numbers(1e6 * displacement[rows]),
                "expected": _numbers(1e6 * wanted[rows]),
                "step": self._step,
                "share": self._share,
                "status": self.status,
            }
        )
        if self._sent_at - self._state_at >= _STATE_PERIOD:
            self._state_at = self._sent_at
            self._state(progress=self._share, **self._present())

    def _present(self) -> dict[str, Any]:
        if self.last is None:
            return {}
        return {"voltage": self.last.voltage, "displacement_um": 1e6 * self.last.displacement}


def thinned(voltage: Array) -> NDArray[np.intp]:
    """Return the rows of at most 200 of voltages (n,) [V]: the last, and the two extremes of each equal stretch."""
    if voltage.size <= MOST:
        return np.arange(voltage.size, dtype=np.intp)
    stretches = np.array_split(np.arange(voltage.size - 1, dtype=np.intp), MOST // 2 - 1)
    extremes = [stretch[[function(voltage[stretch])]] for stretch in stretches for function in (np.argmin, np.argmax)]
    return np.unique(np.concatenate([*extremes, [voltage.size - 1]]))


def _numbers(values: Array) -> list[float | None]:
    return [round(value, _DIGITS) if np.isfinite(value) else None for value in values.tolist()]
