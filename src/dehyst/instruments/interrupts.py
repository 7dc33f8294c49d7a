"""Ctrl-C, SIGTERM and a terminal that goes: the first stops what is played, later ones wait until all is safe."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_NUMBERS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Shield:
    """What becomes of signals; made by `shielded`.

    Attributes
    ----------
    held : bool
        Whether they wait. Set by the first that raises an exception.
    """

    def __init__(self) -> None:
        self.held, self.stopped = True, False
        self.late: list[int] = []
        self._before: dict[int, Any] = {}

    def raise_(self) -> None:
        """Put up; signals wait."""
        # Elsewhere no signal arrives. What is ignored, or not Python's, is left alone.
        if threading.current_thread() is threading.main_thread():
            self._before = {
                number: handler
                for number in _NUMBERS
                if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
            }
            for number in self._before:
                signal.signal(number, self._came)

    def open(self) -> None:
        """Let the first signal through."""
        self.held = False
        for number in self._taken():
            signal.raise_signal(number)

    def lower(self) -> None:
        """Put the handlers back; one of them may raise at once."""
        self.held = True
        try:
            while self._before:
                number, handler = next(iter(self._before.items()))
                signal.signal(number, handler)
                del self._before[number]
        finally:
            if self._before:
                self.lower()

    def deliver(self) -> None:
        """Act on what came late, unless a signal is why all ended."""
        if not self.stopped:
            for number in self._taken()[:1]:
                signal.raise_signal(number)

    def _taken(self) -> list[int]:
        late, self.late = self.late, []
        return late

    def _came(self, number: int, frame: FrameType | None) -> None:
        if self.held:
            self.late.append(number)
            return
        self.held = self.stopped = True
        handler = self._before[number]
        if not callable(handler):
            # It would end the process at once, with the voltage where it is.
            raise SystemExit(128 + number)
        handler(number, frame)
        # One that raises nothing does not mean to stop.
        self.held = self.stopped = False


@contextmanager
def shielded(*, held: bool = False) -> Iterator[Shield]:
    """Let through the first signal, and let all others wait; with `held` all wait.

    A signal whose handler is the system's, SIGTERM as a rule, raises SystemExit: what is played is stopped, too.
    """
    shield = Shield()
    shield.raise_()
    try:
        if not held:
            shield.open()
        yield shield
    except BaseException:
        shield.lower()
        shield.deliver()
        raise
    shield.lower()
    shield.deliver()
