"""The desk of a rig: what the page may request of the process that drives it, and what that process reports."""

from __future__ import annotations

import asyncio
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from dehyst._errors import DehystError
from dehyst.workbench import folder as places
from dehyst.workbench.folder import Folder
from dehyst.workbench.requests import limits_of, number_of
from dehyst.workbench.rig.link import RigLink

_NONE: dict[str, Any] = {"status": "none", "words": [], "error": None, "plan": None, "result": None}
# Seconds between two pings, which the page answers while a rig is armed.
_PING = 0.2
_LIVE = frozenset({"armed", "playing", "calibrating", "stopping"})
# Requests without anything to check, and after which something that was played may be complete.
_PLAIN = ("stop", "disarm", "disconnect")
_UNCONNECTED = frozenset({"none", "connecting", "lost"})
_BUSY = frozenset({"playing", "calibrating"})
_ENDED = frozenset({"armed", "connected", "none", "lost"})
_LONGEST_ADDRESS = 500
_ADDRESS = re.compile(r"(pi|epics|ni)://[^\s]+|sim://[a-z]+")


class RigRequestError(DehystError, ValueError):
    """A request that cannot be made of a rig now."""


class RigDesk:
    """The rig of a workbench: one at most.

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
        Called with what a voltage or a calibration left in the folder: a record, or a folder, relative to it.

    Attributes
    ----------
    state : dict
        What the page shows.
    """

    def __init__(
        self,
        folder: Folder,
        changed: Callable[[], None],
        send: Callable[[Mapping[str, Any]], None],
        origins: Sequence[str],
        finished: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.state: dict[str, Any] = dict(_NONE)
        self._folder, self._changed, self._send = folder, changed, send
        self._link = RigLink(self._receive, origins=origins, errors=folder.path / places.RIG_LOG)
        self._pings: asyncio.Task[None] | None = None
        self._finished, self._place, self._remark = finished, "", ""

    @property
    def stop_port(self) -> int:
        """Where the rig's process listens for the emergency stop."""
        return int(self._link.stop["port"])

    async def request(self, what: str, body: Mapping[str, Any]) -> None:
        """Do what the page asks for; raises RigRequestError if that cannot be done now."""
        doings = {
            "connect": self._connect,
            "arm": self._arm,
            "plan": self._plan,
            "calibrate": self._calibrate,
            "play": self._play,
        }
        if what in doings:
            if what != "connect" and self.state["status"] in _UNCONNECTED:
                raise RigRequestError("no rig is connected; connect one first")
            await doings[what](body)
        elif what in _PLAIN:
            await self._do({"do": what})
        else:
            raise RigRequestError(f"{what}: a rig cannot do that; it can {', '.join((*doings, *_PLAIN))}")

    def heard(self) -> None:
        """Receive a sign of life of a page, and pass it on to the rig's watchdog."""
        self._link.alive()

    async def close(self) -> None:
        """Let go of the rig: its process brings the voltage to the safe one, then ends."""
        if self._pings is not None:
            self._pings.cancel()
            self._pings = None
        await self._link.close()

    async def _connect(self, body: Mapping[str, Any]) -> None:
        if self.state["status"] not in ("none", "lost"):
            raise RigRequestError(f"{self.state.get('address')}: is connected; disconnect it first")
        address = body.get("address")
        if not isinstance(address, str) or not 0 < len(address) <= _LONGEST_ADDRESS:
            raise RigRequestError("address: need one such as pi://host:port, epics://PREFIX or sim://play")
        limits, slew = limits_of(body.get("limits")), number_of(body.get("slew"), "slew")
        if not _ADDRESS.fullmatch(address):
            raise RigRequestError(
                f"{address}: need pi://HOST:PORT, epics://PREFIX, ni://... or sim://NAME; a page chooses no file: "
                "use dehyst calibrate for a driver of your own or the actuator of a model file"
            )
        await self._link.start()
        self.state = {**_NONE, "status": "connecting", "address": address, "stop": dict(self._link.stop)}
        self._changed()
        if self._pings is None:
            self._pings = asyncio.create_task(self._ping())
        await self._link.send({"do": "connect", "address": address, "limits": list(limits), "slew": slew})

    async def _arm(self, body: Mapping[str, Any]) -> None:
        limits, slew = limits_of(body.get("limits")), number_of(body.get("slew"), "slew")
        await self._do({"do": "arm", "limits": list(limits), "slew": slew})

    async def _plan(self, body: Mapping[str, Any]) -> None:
        await self._do({"do": "plan", **_plan_of(body)})

    async def _calibrate(self, body: Mapping[str, Any]) -> None:
        plan = _plan_of(body)
        place = self._folder.new(places.CALIBRATIONS, str(body.get("name") or "rig"))
        low, high = self.state.get("limits") or (0.0, 0.0)
        words = ["calibrate", str(self.state.get("address")), "-o", place, "--limits", f"{low:g}", f"{high:g}"]
        words += ["--slew", f"{self.state.get('slew'):g}", *(f"--{name}={value:g}" for name, value in plan.items())]
        self._begin(place, f"moves the actuator: {shlex.join(['dehyst', *words])}")
        await self._do({"do": "calibrate", "folder": str(self._folder.path / place), **plan})

    async def _play(self, body: Mapping[str, Any]) -> None:
        relative = str(body.get("file", ""))
        file = self._folder.inside(relative)
        place = self._folder.new(places.RECORDS, f"{file.stem}-played", ".h5")
        self._begin(place, f"played on {self.state.get('address')}: {relative}, recorded as {place}")
        await self._do({"do": "play", "file": str(file), "record": str(self._folder.path / place)})

    def _begin(self, place: str, remark: str) -> None:
        """Note what is requested: where its result will be, and a remark for the script once it has begun."""
        if self.state["status"] in _BUSY:
            raise RigRequestError("the rig is busy; wait until it is done, or stop it first")
        self._place, self._remark = place, remark

    async def _do(self, message: Mapping[str, Any]) -> None:
        if not self._link.running:
            raise RigRequestError("no rig is connected; connect one first")
        await self._link.send(dict(message))

    def _receive(self, message: Mapping[str, Any]) -> None:
        """Receive a message of the rig's process."""
        kind = message.get("kind")
        if kind == "live":
            self.state["voltage"], self.state["displacement_um"] = message["v"][-1], message["y"][-1]
            self._send(message)
            return
        if kind == "error":
            self.state["error"] = message["error"]
        elif kind == "rig":
            self.state |= {name: self._shown(value) for name, value in message.items() if name != "kind"}
            if self._remark and message.get("status") in _BUSY:
                self._folder.remark(self._remark)
                self._remark = ""
            if self._place and message.get("status") in _ENDED:
                place, self._place = self._place, ""
                if (self._folder.path / place).exists():
                    self._finished(place)
        self._changed()

    def _shown(self, value: Any) -> Any:
        """Return a value with names of files as the page knows them: relative to the folder."""
        if isinstance(value, dict):
            return {name: self._shown(inner) for name, inner in value.items()}
        return value.replace(f"{self._folder.path}/", "") if isinstance(value, str) else value

    async def _ping(self) -> None:
        while True:
            await asyncio.sleep(_PING)
            if self.state["status"] in _LIVE:
                self._send({"kind": "ping"})


def _plan_of(body: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a calibration's plan from a request."""
    plan: dict[str, Any] = {
        "frequency": number_of(body.get("frequency", 1.0), "frequency"),
        "goal": number_of(body.get("goal", 1.0), "goal"),
    }
    rounds = number_of(body.get("rounds", 2), "rounds")
    if rounds != int(rounds) or not 0 <= rounds <= 20:
        raise RigRequestError(f"rounds: got {rounds:g}, need a whole number, 0 to 20")
    return {**plan, "rounds": int(rounds)}
