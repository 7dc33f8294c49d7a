"""Ctrl-C, SIGQUIT, SIGTERM and SIGHUP: the first signal stops the wave, later ones wait until the voltage is safe."""

from __future__ import annotations

import signal
import threading
from traceback import walk_tb
from types import FrameType
from typing import Self

from dehyst._errors import Terminated

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGQUIT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Shield:
    """Signal handlers for a block: the first signal passes, later ones wait until its end; with `defer`, all wait.

    A signal whose handler is the system's, usually SIGTERM, raises Terminated, so that the wave is stopped too.
    `deferring`: whether signals wait. The first signal that raises an exception sets it.
    """

    def __init__(self, *, defer: bool = False) -> None:
        self.deferring, self._stopped, self._defer = True, False, defer
        self.deferred: list[int] = []
        # Other threads receive no signals. Ignored signals, and handlers that are not Python's, are left alone.
        found = {number: signal.getsignal(number) for number in _SIGNALS}
        main = threading.current_thread() is threading.main_thread()
        self._handlers = {n: handler for n, handler in found.items() if main and handler not in (None, signal.SIG_IGN)}

    def __enter__(self) -> Self:
        try:
            for number in self._handlers:
                signal.signal(number, self._handle)
            self.deferring = self._defer
            while self.deferred and not self._defer:
                signal.raise_signal(self.deferred.pop(0))
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Restore the handlers, and raise a deferred signal unless one has already ended the block."""
        self.deferring = True
        try:
            while self._handlers:
                number, handler = next(iter(self._handlers.items()))
                signal.signal(number, handler)
                del self._handlers[number]
        finally:
            # A handler that is restored may raise at once.
            if self._handlers:
                self.__exit__()
        if self.deferred and not self._stopped:
            deferred, self.deferred = self.deferred, []
            signal.raise_signal(deferred[0])

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.deferring:
            self.deferred.append(number)
            return
        self.deferring = self._stopped = True
        handler = self._handlers[number]
        if not callable(handler):
            # The system's handler would end the process at once and leave the voltage where it is.
            raise Terminated(128 + number)
        handler(number, frame)
        # A handler that raises nothing does not stop the block.
        self.deferring = self._stopped = False


def by_signal(error: BaseException) -> bool:
    """Return whether the handler of a signal raised an error, such as the SystemExit of a program's own handler."""
    handlers = [Shield._handle, *map(signal.getsignal, signal.valid_signals())]
    codes = {getattr(handler, "__code__", None) for handler in handlers}
    return any(frame.f_code in codes for frame, _ in walk_tb(error.__traceback__))
