"""The watchdog of the rig process: it interrupts the main thread, and replaces it if it hangs."""

from __future__ import annotations

import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable
from queue import SimpleQueue
from types import FrameType

from dehyst.instruments import AbstractRig

# Longest time [s] without a sign of life while armed.
HEARTBEAT = 0.6
# Seconds between two looks of the watchdog; and a look that comes later than this is not held against the page.
_LOOK, _LATE = 0.02, 0.1
# Late looks in a row that are left out.
_LEFT_OUT = 3
# Seconds that the main thread has to stop at the next batch of samples, all of them recorded, before a signal does it.
_NEXT_BATCH = 0.25
# A main thread that neither stops nor retreats for this time [s] hangs; one in a retreat, for this and the ramp's.
_HANGS, _HANGS_IN_RETREAT = 3.0, 30.0
# A clock that goes on while the computer is suspended, where there is one.
_CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
# A thread that waits for Python's lock wakes 200 times a second; one of a process that is stopped does not wake.
_WAKES = 10.0
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# Sent by this process to its own main thread; with a session of its own it has no terminal that could send it.
_NUDGE = signal.SIGHUP


class Stopped(BaseException):
    """Interrupts the main thread's activity for a reason; no driver's `except Exception` catches it."""


class _Nap:
    """Whether this process slept between two looks: it was stopped or frozen, or the computer was suspended."""

    def __init__(self) -> None:
        self._at, self._wakes = time.clock_gettime(_CLOCK), _wakes()

    def seconds(self) -> float:
        """Return the seconds that it slept since the last call; 0 if the thread waited for Python's lock only."""
        at, wakes = time.clock_gettime(_CLOCK), _wakes()
        passed, woken = at - self._at, wakes - self._wakes
        self._at, self._wakes = at, wakes
        return passed if woken < _WAKES * passed else 0.0


def _wakes() -> int:
    """Return how often this thread waited until now; 0 where that is not counted."""
    who = getattr(resource, "RUSAGE_THREAD", None)
    return 0 if who is None else resource.getrusage(who).ru_nvcsw


# What confirms a stop, and whether the rig was armed.
_Press = tuple[Callable[[bool], None], bool]


class Watchdog:
    """Reasons to stop, and the means to reach the main thread; made in the main thread.

    `trip` may be called from every thread and from signal handlers. The main thread calls `check` where it may stop,
    and `settle` when the voltage is safe.

    Parameters
    ----------
    hung : callable
        Called with a sentence, in the watchdog's thread, if the main thread hangs while armed. It does not return.

    Attributes
    ----------
    reason : str or None
        Reason of the stop, until the rig has stopped.
    ends : bool
        Whether the process ends after the stop.
    armed : bool
        Whether voltages may be sent, and signs of life are needed.
    active : bool
        Whether the main thread runs something that `Stopped` may interrupt.
    ramp : float
        Time [s] of the longest ramp to the safe voltage.
    """

    def __init__(self, hung: Callable[[str], None]) -> None:
        self.reason: str | None = None
        self.ends = self.armed = self.active = False
        self.ramp = 1.0
        self._hung, self._parent = hung, os.getppid()
        self._acknowledged = self._nudging = self._retreated = self._lost = False
        self._alive_at = self._tripped_at = self._nudged_at = 0.0
        self._main = threading.main_thread().ident or 0
        self._pressed: SimpleQueue[_Press] = SimpleQueue()
        self._unconfirmed: list[_Press] = []

    def start(self) -> None:
        """Handle signals, and begin to watch."""
        for number in _SIGNALS:
            signal.signal(number, self._handle)
        threading.Thread(target=self._watch, name="watchdog", daemon=True).start()

    def arm(self, ramp: float) -> None:
        """Require signs of life from now on; `ramp` [s] is the time of the longest ramp to the safe voltage."""
        self._lost = False
        self.ramp, self._alive_at, self.armed = ramp, time.monotonic(), True

    def disarm(self) -> None:
        """Require no signs of life any more."""
        self.armed = False

    def lose(self) -> None:
        """Confirm no stop until the rig is armed again: the voltage cannot be brought anywhere."""
        self._lost, self.armed = True, False

    def alive(self) -> None:
        """Take note of a sign of life."""
        self._alive_at = time.monotonic()

    def trip(self, reason: str, *, ends: bool = False) -> None:
        """Stop for a `reason`; only the first reason counts. With `ends` the process ends afterwards."""
        # Plain assignments in this order: a signal handler may interrupt any line.
        self.ends = self.ends or ends
        if self.reason is None:
            self._tripped_at = time.monotonic()
            self.reason = reason

    def stop(self, reason: str, confirm: Callable[[bool], None]) -> None:
        """Stop for a `reason` as `trip` does, and confirm the stop.

        `confirm` is called in the watchdog's thread: with True once the main thread of an armed rig retreats or has
        retreated; with False if the rig was not armed. If the main thread hangs, or the rig is lost, it is not called.
        """
        armed = self.armed
        self.trip(reason)
        self._pressed.put((confirm, armed))

    def check(self) -> None:
        """Raise `Stopped` if there is a reason for which it was not raised yet."""
        if self.reason is not None and not self._acknowledged:
            self._acknowledged = True
            raise Stopped(self.reason)

    def acknowledge(self) -> None:
        """Raise no further `Stopped`, because the main thread knows the reason."""
        self._acknowledged = True

    def settle(self) -> None:
        """Forget the reason: the voltage is safe, or nothing more can be done."""
        self.reason = None
        self._acknowledged = self._retreated = False

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if number == _NUDGE and self._nudging:
            self._nudging = False
        else:
            self.trip(f"the rig's process received {signal.Signals(number).name}", ends=True)
        if self.active and self._waited >= _NEXT_BATCH:
            self.check()

    @property
    def _waited(self) -> float:
        """Seconds since the trip."""
        return 0.0 if self.reason is None else time.monotonic() - self._tripped_at

    def _watch(self) -> None:
        looked, late, nap = time.monotonic(), 0, _Nap()
        while True:
            time.sleep(_LOOK)
            now = time.monotonic()
            if (slept := nap.seconds()) > HEARTBEAT and self.armed:
                self.trip(f"the rig's process did not run for {slept:.1f} s")
            # If this thread did not run, neither did the one that reads the signs of life: let it read first.
            late = late + 1 if now - looked > _LATE else 0
            looked = now
            if not 0 < late <= _LEFT_OUT:
                self._look(now)
                self._confirm()

    def _confirm(self) -> None:
        while not self._pressed.empty():
            self._unconfirmed.append(self._pressed.get_nowait())
        if self._lost:
            self._unconfirmed.clear()
        heeded = self.reason is None or self._retreated
        for confirm, armed in [one for one in self._unconfirmed if heeded or not one[1]]:
            confirm(armed)
        self._unconfirmed = [one for one in self._unconfirmed if one[1] and not heeded]

    def _look(self, now: float) -> None:
        if self.armed and now - self._alive_at > HEARTBEAT:
            self.trip(f"the page gave no sign of life for {HEARTBEAT:g} s")
        if os.getppid() != self._parent:
            self.trip("the workbench ended", ends=True)
        if self.reason is None:
            return
        if self.active and not self._acknowledged and self._waited >= _NEXT_BATCH:
            self._nudge(now)
        self._retreated = self._retreated or self._retreating
        if self._waited > (_HANGS_IN_RETREAT + self.ramp if self._retreated else _HANGS):
            self._give_up()

    def _nudge(self, now: float) -> None:
        if now - self._nudged_at > _NEXT_BATCH:
            self._nudged_at, self._nudging = now, True
            signal.pthread_kill(self._main, _NUDGE)

    @property
    def _retreating(self) -> bool:
        """Whether the main thread is in a retreat."""
        frame = sys._current_frames().get(self._main)
        while frame is not None:
            if frame.f_code is AbstractRig.retreat.__code__:
                return True
            frame = frame.f_back
        return False

    def _give_up(self) -> None:
        if self.armed:
            self._hung(f"the rig's driver does not return since {self._waited:.1f} s; {self.reason}")
        elif self.ends:
            os._exit(0)
