"""The server's end of the rig process."""

import asyncio
import os
import signal
import time

import pytest
from observed_rig import ORIGIN, asked

from dehyst import DehystError
from dehyst.workbench.rig.link import RigLink

CONNECT = {"do": "connect", "address": "sim://play", "limits": [0.0, 100.0], "slew": 1000.0}
ARM = {"do": "arm", "limits": [0.0, 100.0], "slew": 1000.0}


class Server:
    """What the workbench's server does with the messages."""

    def __init__(self):
        self.messages, self.state = [], {}
        self.link = RigLink(self.take, origins=[ORIGIN])

    def take(self, message):
        self.messages.append(message)
        if message["kind"] == "rig":
            self.state.update(message)

    async def until(self, condition, alive=True):
        end = time.monotonic() + 30
        while not condition():
            assert time.monotonic() < end, self.messages[-3:]
            if alive:
                self.link.alive()
            await asyncio.sleep(0.02)

    async def armed(self):
        await self.link.start()
        await self.link.send(CONNECT)
        await self.until(lambda: self.state.get("status") == "connected")
        await self.link.send(ARM)
        await self.until(lambda: self.state["status"] == "armed")


def run(journey):
    async def whole():
        server = Server()
        try:
            await journey(server)
        finally:
            await server.link.close()

    asyncio.run(asyncio.wait_for(whole(), 90))


def test_it_passes_commands_and_messages_on():
    async def journey(server):
        await server.armed()
        assert server.state["limits"] == [0.0, 100.0]
        assert server.state["stop"] == server.link.stop
        await server.until(lambda: any(one["kind"] == "live" for one in server.messages))
        await server.link.send({"do": "fly"})
        await server.until(lambda: any(one["kind"] == "error" for one in server.messages))

    run(journey)


def test_without_alive_it_is_disarmed():
    async def journey(server):
        await server.armed()
        await server.until(lambda: server.state["status"] == "connected", alive=False)
        assert "no sign of life" in server.state["words"][0]

    run(journey)


def test_the_process_is_in_a_session_of_its_own():
    async def journey(server):
        await server.link.start()
        assert os.getsid(server.link.pid) == server.link.pid != os.getsid(0)

    run(journey)


def test_its_end_is_reported_and_it_starts_again_with_the_same_stop():
    async def journey(server):
        await server.armed()
        stop = dict(server.link.stop)
        os.kill(server.link.pid, signal.SIGTERM)
        await server.until(lambda: not server.link.running)
        assert server.state["status"] == "none"
        assert server.state["words"][0] == "Stopped: the rig's process received SIGTERM."
        with pytest.raises(DehystError, match="does not run"):
            await server.link.send(ARM)
        assert asked(stop["port"], "POST /stop HTTP/1.1", {})[0] == 0
        await server.armed()
        assert server.link.stop == stop
        headers = {"Host": f"127.0.0.1:{stop['port']}", "Origin": ORIGIN, "X-Dehyst-Stop": stop["key"]}
        assert (await asyncio.to_thread(asked, stop["port"], "POST /stop HTTP/1.1", headers))[0] == 200
        await server.until(lambda: server.state["status"] == "connected")

    run(journey)


def test_a_process_that_dies_while_armed_is_replaced_to_retreat():
    async def journey(server):
        await server.armed()
        os.kill(server.link.pid, signal.SIGKILL)
        await server.until(lambda: not server.link.running)
        assert "status -9" in server.state["words"][0]
        assert server.state["words"][1] == "A fresh connection brought the voltage to 0 V."

    run(journey)


def test_closing_lets_the_process_retreat_and_end():
    async def journey(server):
        await server.armed()
        pid = server.link.pid
        await server.link.close()
        assert not server.link.running
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
        assert "The voltage was brought to 0 V." in server.state["words"]

    run(journey)


def test_it_may_be_closed_without_having_been_started():
    async def journey(server):
        server.link.alive()

    run(journey)
