"""Ctrl-C, SIGTERM and SIGHUP: the first signal stops the wave, later ones wait until the voltage is safe."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Protocol

# First words of a note on an error that reports where the voltage was left.
_NOTE = "The voltage"
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


class Shield:
    """Signal handlers that can defer signals; made by `shielded`.

    `deferring`: whether signals wait. The first signal that raises an exception sets it.
    """

    def __init__(self) -> None:
        self.deferring, self._stopped = True, False
        self.deferred: list[int] = []
        self._handlers: dict[int, Any] = {}

    def install(self) -> None:
        """Replace the handlers; signals wait."""
        # Other threads receive no signals. Ignored signals, and handlers that are not Python's, are left alone.
        if threading.current_thread() is threading.main_thread():
            self._handlers = {
                number: handler
                for number in _SIGNALS
                if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)
            }
            for number in self._handlers:
                signal.signal(number, self._handle)

    def open(self) -> None:
        """Let the first signal through."""
        self.deferring = False
        for number in self._take_deferred():
            signal.raise_signal(number)

    def restore(self) -> None:
        """Restore the handlers; one of them may raise at once."""
        self.deferring = True
        try:
            while self._handlers:
                number, handler = next(iter(self._handlers.items()))
                signal.signal(number, handler)
                del self._handlers[number]
        finally:
            if self._handlers:
                self.restore()

    def deliver(self) -> None:
        """Raise a deferred signal, unless a signal has already ended the block."""
        if not self._stopped:
            for number in self._take_deferred()[:1]:
                signal.raise_signal(number)

    def _take_deferred(self) -> list[int]:
        deferred, self.deferred = self.deferred, []
        return deferred

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self.deferring:
            self.deferred.append(number)
            return
        self.deferring = self._stopped = True
        handler = self._handlers[number]
        if not callable(handler):
            # The system's handler would end the process at once and leave the voltage where it is.
            raise SystemExit(128 + number)
        handler(number, frame)
        # A handler that raises nothing does not stop the block.
        self.deferring = self._stopped = False


@contextmanager
def shielded(*, defer: bool = False) -> Iterator[Shield]:
    """Let the first signal through and defer all others; with `defer` defer all.

    A signal whose handler is the system's, usually SIGTERM, raises SystemExit, so that the wave is stopped too.
    """
    shield = Shield()
    shield.install()
    try:
        if not defer:
            shield.open()
        yield shield
    except BaseException:
        shield.restore()
        shield.deliver()
        raise
    shield.restore()
    shield.deliver()


class _Retreating(Protocol):
    def _retreated(self) -> str: ...


@contextmanager
def retreating(rig: _Retreating) -> Iterator[None]:
    """Let a `rig` retreat after any error within, Ctrl-C too, and add the outcome to the error as a note."""
    with shielded() as shield:
        try:
            # Twice: a signal may come between an error and the line that defers signals.
            try:
                yield
            except BaseException:
                shield.deferring = True
                raise
        except BaseException as error:
            if not any(note.startswith(_NOTE) for note in getattr(error, "__notes__", ())):
                # The cause of the error may prevent the retreat too.
                error.add_note(rig._retreated().replace(f" ({error})", ""))
            raise


def retreated(retreat: Callable[[], Any], safe: str, close: Callable[[], None], axes: str = "") -> str:
    """Retreat if the link still works, else close it; return the outcome as a sentence.

    `safe` are the voltages that `retreat` brings about, `axes` are words on several.
    """
    try:
        retreat()
        return f"{_NOTE}{axes} was brought to {safe} V."
    except Exception as error:  # a driver's library may raise anything; the first error is the one to report
        with suppress(Exception):
            close()
        failure = f"{_NOTE}{axes} could not be brought to {safe} V ({error})"
        return f"{failure}: the device holds, or plays to its end, what it has; see to it by hand."
