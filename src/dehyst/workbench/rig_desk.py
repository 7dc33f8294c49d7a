"""The desk of a rig: requests of the page to the rig's process, and reports of this process."""

from __future__ import annotations

import asyncio
import itertools
import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from dehyst._errors import DehystError, LinkError
from dehyst.operations.registry import find
from dehyst.records.recording import salvage
from dehyst.waveforms.excitation import positive
from dehyst.workbench import folder as places
from dehyst.workbench.data import limits_of, number_of
from dehyst.workbench.folder import Folder
from dehyst.workbench.forms import rig_address
from dehyst.workbench.jobs import Step
from dehyst.workbench.rig.link import RigLink

_NONE: dict[str, Any] = {
    **dict.fromkeys(("error", "plan", "result", "known", "silent")),
    "status": "none",
    "words": [],
}
# Seconds between two pings, which the page answers while a rig is armed.
_PING = 0.2
_LIVE = frozenset({"armed", "playing", "calibrating", "stopping"})
# Seconds without a message after which the rig's process is silent, that a stop may take to be confirmed, and that a
# command may take that moves nothing.
_SILENT, _STOPPED, _DONE = 1.0, 2.0, 30.0
# Requests without anything to check.
_PLAIN = ("disarm", "disconnect")
# Commands whose answer is waited for.
_SHORT = ("arm", "plan")
_UNCONNECTED = frozenset({"none", "connecting", "lost"})
_BUSY = frozenset({"playing", "calibrating"})
_LONGEST_ADDRESS = 500
# Repetitions of a path: each is shown.


class RigRequestError(DehystError, ValueError):
    """The rig cannot do this request now."""


class NoAnswerError(DehystError, RuntimeError):
    """The rig's process did not confirm a stop."""

    status = 504


class NothingArmedError(DehystError, RuntimeError):
    """A stop that had nothing to stop."""

    status = 409


class RigDesk:
    """The rig of a workbench, which has at most one.

    Parameters
    ----------
    folder : Folder
        For records and calibrations.
    changed : callable
        Called after each change of `state`.
    send : callable
        Called with each live message for the pages.
    origins : sequence of str
        Of the page, which may send the emergency stop to the rig's process.
    finished : callable
        Called with each result, a record, a model or the folder of a calibration, relative to the workbench's folder,
        and with the parameters of the operation that made it.

    Attributes
    ----------
    state : dict
        State that the page shows. "silent": whole seconds without an answer of the rig's process, or None.
    """

    def __init__(
        self,
        folder: Folder,
        changed: Callable[[], None],
        send: Callable[[Mapping[str, Any]], None],
        origins: Sequence[str],
        finished: Callable[[str, Mapping[str, Any]], None] = lambda _, __: None,
    ) -> None:
        self.state: dict[str, Any] = dict(_NONE)
        self._folder, self._changed, self._send = folder, changed, send
        self._link = RigLink(self._receive, origins=origins, folder=folder.path, errors=folder.path / places.RIG_LOG)
        self._pings: asyncio.Task[None] | None = None
        self._finished, self._remark = finished, ""
        # Results of the command, and the parameters of the operation that makes them.
        self._expected: dict[str, Mapping[str, Any]] = {}
        # The command that is being done, and the answers that are waited for.
        self._task, self._keys = "", itertools.count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._recovering: asyncio.Task[None] | None = None

    @property
    def stop_port(self) -> int:
        """Where the rig's process listens for the emergency stop."""
        return int(self._link.stop["port"])

    async def request(self, what: str, body: Mapping[str, Any]) -> None:
        """Execute a request of the page.

        Wait for the outcome of arming and planning, and for the confirmation of a stop; other requests are only begun.

        Raises
        ------
        RigRequestError
            If the request cannot be done now, or the rig's process refused it.
        NothingArmedError
            If a stop was requested, but nothing was armed.
        NoAnswerError
            If the rig's process does not confirm a stop.
        """
        makers = {
            "connect": self._connect,
            "arm": self._arm,
            "plan": self._plan,
            "calibrate": self._calibrate,
            "play": self._play,
        }
        if what == "stop":
            await self._stop()
        elif what in _PLAIN:
            self._demand_link()
            await self._link.send({"do": what})
        elif what not in makers:
            raise RigRequestError(f"{what}: a rig cannot do that; it can {', '.join((*makers, 'stop', *_PLAIN))}")
        elif what != "connect" and self.state["status"] in _UNCONNECTED:
            raise RigRequestError("no rig is connected; connect one first")
        elif self._task or self.state["status"] in _BUSY:
            busy = self._task or self.state["status"]
            raise RigRequestError(f"{what}: the rig is busy ({busy}); wait until it is done, or stop it first")
        else:
            await self._command(what, makers[what](body))

    def heard(self) -> None:
        """Receive a sign of life of a page, and pass it on to the rig's watchdog."""
        self._link.alive()

    async def close(self) -> None:
        """Release the rig: its process brings the voltage to the safe value, then ends."""
        if self._pings is not None:
            self._pings.cancel()
            self._pings = None
        await self._link.close()

    async def recover(self) -> None:
        """Convert journals left by killed processes to records, and list them."""
        folder = self._folder.path / places.RECORDS
        with suppress(DehystError, OSError):
            for path in await asyncio.to_thread(salvage, folder):
                self._finished(f"{places.RECORDS}/{path.name}", {})

    async def _stop(self) -> None:
        self._demand_link()
        try:
            answer = await asyncio.wait_for(self._ask({"do": "stop"}), _STOPPED)
        except (TimeoutError, LinkError) as error:
            raise NoAnswerError(
                f"the rig's process gave no answer to the stop within {_STOPPED:g} s; switch the amplifier off by hand"
            ) from error
        if answer.get("armed") is None:
            raise NoAnswerError("the rig's process ended before it confirmed the stop; look at the device")
        if not answer["armed"]:
            raise NothingArmedError("nothing was armed, and the voltage was not moved")

    async def _command(self, what: str, message: Mapping[str, Any]) -> None:
        """Have a command done; none is begun before its answer. No other request may come between check and note."""
        self._task = what
        try:
            if what == "connect":
                await self._link.start()
                self.state = {**_NONE, "status": "connecting", "address": message["address"]}
                self.state["stop"] = dict(self._link.stop)
                self._changed()
                if self._pings is None:
                    self._pings = asyncio.create_task(self._ping())
            if what == "arm":
                # A calibration's modules take longer to import than the watchdog of an armed rig waits for a page.
                await asyncio.to_thread(find, "calibrate")
            done = await self._post({"do": what, **message})
            done.add_done_callback(lambda _: self._conclude())
        except BaseException:
            self._conclude()
            raise
        if what in _SHORT:
            try:
                answer = await asyncio.wait_for(asyncio.shield(done), _DONE)
            except TimeoutError as error:
                raise RigRequestError(f"{what}: the rig's process gave no answer within {_DONE:g} s") from error
            if answer.get("error"):
                raise RigRequestError(answer["error"])

    async def _ask(self, message: Mapping[str, Any]) -> dict[str, Any]:
        return await (await self._post(message))

    async def _post(self, message: Mapping[str, Any]) -> asyncio.Future[dict[str, Any]]:
        """Send a message, and return its answer to come."""
        key = next(self._keys)
        self._answers[key] = answer = asyncio.get_running_loop().create_future()
        answer.add_done_callback(lambda _: self._answers.pop(key, None))
        try:
            await self._link.send({**message, "id": key})
        except BaseException:
            answer.cancel()
            raise
        return answer

    def _conclude(self) -> None:
        """Note that a command is done: its result, or what a killed process left of it, is listed."""
        self._task, self._remark, expected, self._expected = "", "", self._expected, {}
        if not expected:
            return
        made = [place for place in expected if (self._folder.path / place).exists()]
        for place in made:
            self._finished(place, expected[place])
        if not made and not self._link.running:
            self._recovering = asyncio.create_task(self.recover())
        self._changed()

    def _connect(self, body: Mapping[str, Any]) -> dict[str, Any]:
        if self.state["status"] not in ("none", "lost"):
            raise RigRequestError(f"{self.state.get('address')}: is connected; disconnect it first")
        address = body.get("address")
        if not isinstance(address, str) or not 0 < len(address) <= _LONGEST_ADDRESS:
            raise RigRequestError("address: need one such as pi://host:port, epics://PREFIX or sim://play")
        if not rig_address().fullmatch(address):
            raise RigRequestError(
                f"{address}: need pi://HOST:PORT, epics://PREFIX, ni://..., jena://HOST or sim://NAME; a page chooses "
                "no file: use dehyst calibrate for a driver of your own or the actuator of a model file"
            )
        return {"address": address, **_limits_of(body)}

    def _arm(self, body: Mapping[str, Any]) -> dict[str, Any]:
        return {"identity": body.get("identity"), **_limits_of(body)}

    def _plan(self, body: Mapping[str, Any]) -> dict[str, Any]:
        return {"given": {"rig": str(self._address), **_plan_of(body)}}

    def _calibrate(self, body: Mapping[str, Any]) -> dict[str, Any]:
        place = self._folder.new(places.CALIBRATIONS, str(body.get("name") or "rig"))
        bounds = {name: [value] for name, value in self._bounds.items()}
        return self._operation("calibrate", {**bounds, **_plan_of(body), "output": place}, place)

    def _operation(self, name: str, asked: Mapping[str, Any], *made: str) -> dict[str, Any]:
        """Return the message that performs an operation, which makes these files or folders."""
        step = Step(name, {"rig": str(self._address), **asked})
        self._expected, self._remark = dict.fromkeys(made, asked), f"moves the actuator: {shlex.join(step.command)}"
        return {"given": step.parameters}

    def _play(self, body: Mapping[str, Any]) -> dict[str, Any]:
        relative = str(body.get("file", ""))
        file = self._folder.inside(relative)
        place = self._folder.new(places.RECORDS, f"{file.stem}-played", ".h5")
        self._expected = {place: {}}
        self._remark = f"played on {self._address}: {relative}, recorded as {place}"
        return {"file": relative, "record": place}

    @property
    def _address(self) -> Any:
        return self.state.get("address")

    @property
    def _bounds(self) -> dict[str, Any]:
        """Limits [V] and slew rate [V/s] of the rig, as parameters of an operation of one axis."""
        return {"limits": self.state.get("limits"), "slew_rate": self.state.get("slew")}

    def _demand_link(self) -> None:
        if not self._link.running:
            raise RigRequestError("no rig is connected; connect one first")

    def _receive(self, message: Mapping[str, Any]) -> None:
        """Receive a message of the rig's process."""
        kind = message.get("kind")
        if kind == "live":
            self.state["voltage"], self.state["displacement_um"] = message["v"][-1], message["y"][-1]
            self._send(message)
            return
        if kind == "done":
            self._answer(message["id"], message)
            return
        if kind == "error":
            self.state["error"] = message["error"]
        elif kind == "rig":
            self.state |= {name: value for name, value in message.items() if name != "kind"}
            if self._remark and message.get("status") in _BUSY:
                self._folder.remark(self._remark)
                self._remark = ""
            if not self._link.running:
                for key in tuple(self._answers):
                    self.state["error"] = "the rig's process ended before it answered; connect again"
                    self._answer(key, {"error": self.state["error"]})
        self._changed()

    def _answer(self, key: int, answer: Mapping[str, Any]) -> None:
        waiting = self._answers.get(key)
        if waiting is not None and not waiting.done():
            waiting.set_result(dict(answer))

    async def _ping(self) -> None:
        while True:
            began = time.monotonic()
            await asyncio.sleep(_PING)
            if self.state["status"] in _LIVE:
                self._send({"kind": "ping"})
            # After a pause of this process, messages of the other one may wait to be read.
            if time.monotonic() - began < 2 * _PING:
                self._note_silence(self._link.silent)

    def _note_silence(self, seconds: float) -> None:
        silent = int(seconds) if seconds >= _SILENT else None
        if silent != self.state["silent"]:
            self.state["silent"] = silent
            self._changed()


def _limits_of(body: Mapping[str, Any]) -> dict[str, Any]:
    """Return limits and slew rate of a request."""
    return {"limits": list(limits_of(body.get("limits"))), "slew": number_of(body.get("slew"), "slew")}


def _plan_of(body: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a calibration's plan from a request."""
    plan: dict[str, Any] = {name: number_of(body.get(name, 1.0), name) for name in ("frequency", "goal")}
    for name, value in plan.items():
        positive(value, name)
    rounds = number_of(body.get("rounds", 2), "rounds")
    if rounds != int(rounds) or not 0 <= rounds <= 20:
        raise RigRequestError(f"rounds: got {rounds:g}, need a whole number, 0 to 20")
    return {**plan, "rounds": int(rounds)}
