"""The server's end of the rig process."""

import asyncio
import os
import signal
import time

import pytest
from observed_rig import ORIGIN, asked, children

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

    async def pressed(self, key=None):
        """Press the emergency stop; the answer."""
        port = self.link.stop["port"]
        headers = {"Host": f"127.0.0.1:{port}", "Origin": ORIGIN, "X-Dehyst-Stop": key or self.link.stop["key"]}
        return await asyncio.to_thread(asked, port, "POST /stop HTTP/1.1", headers)

    async def armed(self):
        await self.link.start()
        await self.link.send(CONNECT)
        await self.until(lambda: self.state.get("status") == "connected")
        await self.link.send({**ARM, "identity": self.state["identity"]})
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


def test_its_end_is_reported_and_the_next_one_has_a_stop_of_its_own():
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
        assert server.link.stop["port"] == stop["port"]
        assert (await server.pressed(stop["key"]))[0] == 403
        assert server.state["status"] == "armed"
        assert (await server.pressed())[0] == 200
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


@pytest.mark.parametrize("gap", [0.0, 0.002, 0.02])
def test_two_starts_at_once_make_one_process(gap):
    async def journey(server):
        async def later():
            await asyncio.sleep(gap)
            await server.link.start()

        await asyncio.gather(server.link.start(), later())
        assert len(children(os.getpid(), "dehyst.workbench.rig.process")) == 1

    run(journey)


def test_a_start_while_a_process_ends_waits_for_a_fresh_one():
    async def journey(server):
        await server.armed()
        before = server.link.pid
        os.kill(before, signal.SIGKILL)
        await server.until(lambda: "status -9" in "".join(server.state["words"]))
        await server.armed()
        assert server.link.pid not in (None, before)

    run(journey)


def test_a_start_right_after_the_last_state_makes_a_fresh_process():
    async def journey(server):
        for _ in range(5):
            await server.armed()
            before = server.link.pid
            server.state.clear()
            os.kill(before, signal.SIGTERM)
            end = time.monotonic() + 30
            while server.state.get("status") != "none":
                assert time.monotonic() < end
                await asyncio.sleep(0)

    run(journey)


@pytest.mark.nightly
def test_a_stop_that_the_process_does_not_confirm_is_not_answered_by_another():
    """A process that is stopped (SIGSTOP) confirms nothing; it wakes disarmed, and says how long it slept."""

    async def journey(server):
        await server.armed()
        os.kill(server.link.pid, signal.SIGSTOP)
        assert (await server.pressed())[0] != 200
        await server.until(lambda: server.link.silent > 1.5)
        os.kill(server.link.pid, signal.SIGCONT)
        await server.until(lambda: server.state["status"] == "connected")
        assert server.link.silent < 1.0

    run(journey)


def test_a_process_that_slept_wakes_disarmed():
    async def journey(server):
        await server.armed()
        os.kill(server.link.pid, signal.SIGSTOP)
        slept = time.monotonic() + 1.5
        # Signs of life wait in the pipe meanwhile.
        await server.until(lambda: time.monotonic() > slept)
        assert server.state["status"] == "armed"
        os.kill(server.link.pid, signal.SIGCONT)
        await server.until(lambda: server.state["status"] == "connected")
        assert "did not run for" in server.state["words"][0]

    run(journey)


def test_it_may_be_closed_without_having_been_started():
    async def journey(server):
        server.link.alive()

    run(journey)
