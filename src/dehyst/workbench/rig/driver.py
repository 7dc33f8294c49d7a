"""The driver of the rig, in the main thread of its process: it runs commands one by one, and retreats on a stop."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from queue import Empty, SimpleQueue
from typing import Any

from dehyst._errors import DehystError, RigError
from dehyst._process import Outlet
from dehyst.instruments import BY_HAND, AbstractRig, VoltageNote, open_rig
from dehyst.instruments.samples import READBACK_TOLERANCE
from dehyst.workbench.rig.messages import Request, number, pair, text
from dehyst.workbench.rig.tasks import LiveFeed, RigRun, performed, playing
from dehyst.workbench.rig.watchdog import Stopped, Watchdog

# Seconds between two readings of a rig at rest, and longest wait for a command.
_PERIOD, _TICK = 0.1, 0.02
# Readings in a row that must fail before a rig that is not armed counts as lost.
_LOST_AFTER = 3
# Fields of the state that belong to one rig.
OF_RIG = ("name", "identity", "axis", "limits", "slew", "safe", "plan")


class RigDriver:
    """A rig, its state, and the commands that the server may request. All methods except `take` run in the main thread.

    Voltages are sent only while the rig is armed. A request to arm must repeat the rig's identity, limits and slew
    rate. A request with an "id" is answered once: when it is done, refused or stopped.

    Parameters
    ----------
    watchdog : Watchdog
    outlet : Outlet

    Attributes
    ----------
    address : str or None
        Of the connected rig.
    rig : AbstractRig or None
    """

    def __init__(self, watchdog: Watchdog, outlet: Outlet) -> None:
        self.rig: AbstractRig | None = None
        self.address: str | None = None
        self._watchdog, self._outlet = watchdog, outlet
        self._feed = LiveFeed(outlet.live, outlet.progress, watchdog.check)
        self._waiting: SimpleQueue[Request] = SimpleQueue()
        self._status, self._busy = "none", ""
        self._read_at, self._failures, self._fresh = 0.0, 0, True
        # What the last stop said, until the rig is armed again or closed.
        self._stopped: list[str] = []
        self._commands: dict[str, Callable[[Request], None]] = {
            "connect": self._connect,
            "arm": self._arm,
            "plan": self._plan,
            "play": self._play,
            "calibrate": self._operate,
            "disarm": self._disarm,
            "disconnect": self._disconnect,
        }

    def take(self, request: Request) -> None:
        """Accept a request of the server, in any thread; answer with an error if it cannot be done now."""
        if "alive" in request:
            self._watchdog.alive()
            return
        command = request.get("do")
        if command == "stop":
            key = request.get("id")
            self._watchdog.stop("the stop was pressed", lambda armed: self._outlet.done(key, armed=armed))
        elif not isinstance(command, str) or command not in self._commands:
            known = ", ".join([*self._commands, "stop"])
            self._refuse(request, f"do: got {str(command)[:60]!r}, need one of {known}")
        elif not self._busy:
            self._waiting.put(request)
        elif command in ("disarm", "disconnect"):
            self._watchdog.trip(f"{command} was requested")
            self._waiting.put(request)
        else:
            busy = f"the rig is busy ({self._busy}); wait until it is done, or stop it first"
            self._refuse(request, f"{command}: {busy}")

    def run(self) -> None:
        """Serve until the process ends; then close the rig, with a safe voltage if it was armed."""
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda message, *_, **__: self._outlet.state(words=[str(message)])
            while not (self._watchdog.ends and self._watchdog.reason is None):
                self._guarded_turn()
            # From here on no request is read. Said before the last state, after which another process may be started.
            self._outlet.state(ends=True)
            self._close()
            self._outlet.state(ends=True, **({} if self._status == "lost" else {"status": "none"}))

    def _guarded_turn(self) -> None:
        try:
            self._turn()
        except Stopped:
            # The signal may come between any two lines; the next turn retreats.
            pass
        # Also what a driver raises to end the program: not before the voltage is safe.
        except BaseException as error:
            self._watchdog.trip(f"the rig's process failed ({reason_of(error)})")

    def _turn(self) -> None:
        if self._watchdog.reason is not None:
            self._stop(self._watchdog.reason)
            return
        try:
            request = self._waiting.get(timeout=_TICK)
        except Empty:
            self._look()
            return
        self._do(request)

    def _refuse(self, request: Request, sentence: str) -> None:
        self._outlet.error(sentence)
        self._outlet.done(request.get("id"), error=sentence)

    def _do(self, request: Request) -> None:
        self._busy = request["do"]
        outcome: str | None = f"{self._busy}: was stopped"
        try:
            self._commands[request["do"]](request)
            outcome = None
        # A driver, its library or a file may raise anything; the voltage is safe all the same.
        except Exception as error:
            outcome = reason_of(error)
            self._fail(error)
        finally:
            self._busy = ""
            self._outlet.done(request.get("id"), error=outcome)

    def _connect(self, request: Request) -> None:
        if self.rig is not None:
            raise RigError("connect: a rig is connected; disconnect it first")
        address, limits, slew = text(request, "address"), pair(request, "limits"), number(request, "slew")
        self._show("connecting", address=address, error=None, words=[], plan=None, result=None)
        rig = open_rig(address, limits=limits, slew_rate=slew)
        if len(rig.axes) > 1:
            rig.close()
            raise RigError(f"connect: {address} names several axes, the workbench drives one; give one of them")
        self.rig = rig
        self.address, self._failures, self._fresh, self._stopped = address, 0, True, []
        self._show(
            "connected",
            name=rig.name,
            identity=rig.identity,
            axis=rig.axis,
            limits=[rig.limits.low, rig.limits.high],
            slew=rig.slew_rate,
            safe=rig.safe,
        )

    def _arm(self, request: Request) -> None:
        rig = self._connected()
        limits, slew = pair(request, "limits"), number(request, "slew")
        if request.get("identity") != rig.identity:
            raise RigError(
                f"arm: got the rig {str(request.get('identity'))[:200]!r}, but {rig.identity!r} is connected; "
                "confirm that one, or connect another"
            )
        if limits != (rig.limits.low, rig.limits.high) or slew != rig.slew_rate:
            raise RigError(
                f"arm: got the limits {limits} V and {slew} V/s, but {rig.limits.low!r} to {rig.limits.high!r} V and "
                f"{rig.slew_rate!r} V/s are in force; confirm those, or connect with others"
            )
        self._feed.reading(reading := rig.read())
        slack = READBACK_TOLERANCE * (rig.limits.high - rig.limits.low)
        if abs(reading.voltage - rig.limits.nearest(reading.voltage)) > slack:
            raise RigError(
                f"arm: the rig stands at {reading.voltage:.6g} V, but {rig.limits.words} is allowed; bring it there "
                "by hand, or connect with wider limits if device and actuator allow it"
            )
        self._watchdog.arm(ramp_seconds(rig))
        self._stopped = []
        self._show("armed", error=None, words=[])

    def _plan(self, request: Request) -> None:
        """Show what a calibration would send."""
        run = RigRun(self._connected(), self._working("connected"), self._outlet.state)
        steps = performed(run, {**request, "do": "calibrate"}, dry_run=True)["steps"]
        self._outlet.state(plan={"steps": steps, "seconds": sum(one.get("seconds", 0.0) for one in steps)}, error=None)

    def _play(self, request: Request) -> None:
        rig = self._armed()
        task = playing(rig, request, self._feed, first=self._fresh)
        with self._working("playing"):
            result = task()
        self._show("armed", result=result, words=[])

    def _operate(self, request: Request) -> None:
        """Calibrate."""
        result = performed(RigRun(self._armed(), self._working("calibrating"), self._outlet.state), request)
        self._show("armed", result=result, words=[])

    def _armed(self) -> AbstractRig:
        rig = self._connected()
        if not self._watchdog.armed:
            raise RigError("the rig is not armed, nothing was sent; confirm limits and slew rate first")
        return rig

    @contextmanager
    def _working(self, status: str) -> Iterator[LiveFeed]:
        """Send voltages; `Stopped` leaves it after the base class has retreated."""
        self._show(status, error=None, words=[], result=None)
        self._watchdog.active, self._fresh = True, False
        try:
            yield self._feed
        finally:
            self._watchdog.active = False
            self._feed.end()

    def _disarm(self, _: Request) -> None:
        self._connected()
        self._watchdog.trip("it was disarmed")

    def _disconnect(self, _: Request) -> None:
        if self._watchdog.armed:
            self._stop("it was disconnected")
            if self.rig is None:
                # Lost meanwhile: that must stay visible.
                return
        self._close()
        self._show("none", **dict.fromkeys(("address", *OF_RIG)))

    def _stop(self, reason: str) -> None:
        """Retreat if armed, disarm, and forget what was requested before."""
        self._watchdog.acknowledge()
        try:
            self._forget_requests()
            sentence = f"Stopped: {reason}."
            if self._watchdog.armed:
                self._show("stopping", words=[sentence])
                self._retreat([sentence])
            elif self.rig is not None:
                idle = "Nothing was armed, and the voltage was not moved."
                self._outlet.state(words=[*self._stopped, sentence, idle])
        finally:
            self._watchdog.settle()

    def _retreat(self, words: list[str]) -> None:
        """Bring the voltage to the safe one, disarm, and send the outcome after `words`."""
        rig = self.rig
        if rig is None:
            self._watchdog.disarm()
            return
        try:
            voltage = rig.retreat()
        # Whatever a driver raises, also to end the program: the outcome is a sentence.
        except BaseException as error:
            self._lose(f"The voltage could not be brought to {rig.safe:.6g} V ({reason_of(error)}): {BY_HAND}.", words)
            return
        self._watchdog.disarm()
        self._stopped = [*words, f"The voltage was brought to {voltage:.6g} V."]
        self._show("connected", voltage=voltage, words=self._stopped)

    def _fail(self, error: Exception) -> None:
        """Send an error. If it came while a voltage was sent, the base class has retreated: disarm."""
        sentence = reason_of(error)
        notes = list(getattr(error, "__notes__", ()))
        stopped = [] if self._watchdog.reason is None else [f"Stopped: {self._watchdog.reason}."]
        self._outlet.error(sentence)
        self._outlet.state(error=sentence)
        if self.rig is None:
            self._show("none")
        elif not self._watchdog.armed or self._status == "armed":
            self._show(self._status, words=notes)
        elif any(isinstance(note, VoltageNote) and not note.safe for note in notes):
            self._lose(" ".join(notes), stopped)
            self._watchdog.settle()
        else:
            self._retreat([sentence, *stopped])
            self._watchdog.settle()

    def _lose(self, outcome: str, words: list[str]) -> None:
        """Give up a rig whose voltage cannot be brought anywhere; send where it was last."""
        last, now = self._feed.last, time.monotonic()
        known = "Its voltage was never read."
        if last is not None:
            known = f"Its voltage was last seen at {last.voltage:.6g} V, {now - self._feed.seen_at:.1f} s ago."
        self._watchdog.lose()
        self._close()
        self._show("lost", words=[*words, outcome, known])

    def _look(self) -> None:
        """Read a rig at rest, ten times a second."""
        if self.rig is None or time.monotonic() - self._read_at < _PERIOD:
            return
        self._watchdog.active = True
        try:
            self._look_now()
            self._failures = 0
        except Stopped:
            raise
        # Also what a driver raises to end the program.
        except BaseException as error:
            self._unreadable(reason_of(error))
        finally:
            self._watchdog.active = False
            self._read_at = time.monotonic()

    def _unreadable(self, reason: str) -> None:
        self._failures += 1
        if self._watchdog.armed:
            self._outlet.state(error=reason)
            self._watchdog.trip(f"the rig cannot be read: {reason}")
        elif self._failures >= _LOST_AFTER:
            self._outlet.state(error=reason)
            self._lose(f"It cannot be read any more: {BY_HAND}.", [])

    def _look_now(self) -> None:
        if self.rig is not None:
            self._feed.reading(self.rig.read())

    def _connected(self) -> AbstractRig:
        if self.rig is None:
            raise RigError("no rig is connected; connect one first")
        return self.rig

    def _show(self, status: str, **change: Any) -> None:
        self._status = self._feed.status = status
        self._outlet.state(status=status, **change)

    def _forget_requests(self) -> None:
        """Refuse what waits; a disconnection is done after the stop."""
        kept: list[Request] = []
        with suppress(Empty):
            while True:
                request = self._waiting.get_nowait()
                if request["do"] == "disconnect":
                    kept.append(request)
                elif request["do"] != "disarm":
                    self._refuse(request, f"{request['do']}: was not begun, because of the stop")
        for request in kept:
            self._waiting.put(request)

    def _close(self) -> None:
        self._watchdog.disarm()
        if self.rig is not None:
            with suppress(Exception):
                self.rig.close()
        self.rig = self.address = None


def reason_of(error: BaseException) -> str:
    """Return the message of an `error`, with its type unless it is one of dehyst."""
    return str(error) if isinstance(error, DehystError) else f"{type(error).__name__}: {error}"


def ramp_seconds(rig: AbstractRig) -> float:
    """Return the time [s] of a ramp of `rig` through its whole range."""
    return max(1.0, (rig.limits.high - rig.limits.low) / rig.slew_rate)
