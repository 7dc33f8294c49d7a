"""A TCP server of an emulated controller: one client at a time, as on real controllers, in one thread."""

import asyncio
import socket
import threading

from emulator.faults import Rehearsal

_HOST = "127.0.0.1"
# Seconds between updates of the instrument, and until a client that takes no answers is disconnected.
_TICK, _PATIENCE = 0.02, 10.0
# Bytes of the longest line.
_LONGEST_LINE = 65536


class Server:
    """A TCP server of a `controller`; as a context manager it runs in a thread of its own.

    It listens at `port` of this machine, where 0 is any free one, and triggers the faults of a `rehearsal`. The `lock`
    is held while the controller is used: share it with every other user of its instrument.
    """

    def __init__(self, controller, *, port, lock=None, rehearsal=None):
        self.controller, self.lock = controller, lock or threading.Lock()
        self.rehearsal = rehearsal or Rehearsal()
        self._listening = socket.create_server((_HOST, port), backlog=16)
        self.port = self._listening.getsockname()[1]
        self._client = self._server = None
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self.serve, name=f"pi://{_HOST}:{self.port}", daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.stop()
        self._thread.join()

    def stop(self):
        """Make `serve` return; from any thread, or from a signal."""
        self._stopped.set()

    def serve(self):
        """Serve until `stop`; close all connections at the end."""
        asyncio.run(self._serve())

    async def _serve(self):
        self._server = await asyncio.start_server(self._attend, sock=self._listening, limit=_LONGEST_LINE)
        try:
            while not self._stopped.is_set():
                self._update()
                await asyncio.sleep(_TICK)
        finally:
            self._disconnect()
            self._server.close()

    def _update(self):
        """Bring the instrument up to now, and trigger faults."""
        with self.lock:
            self.controller.instrument.advance()
            faults = self.rehearsal.trigger(self.controller)
        if faults:
            self._disconnect()
        if "refuse" in faults:
            self._server.close()

    def _disconnect(self):
        client, self._client = self._client, None
        if client is not None:
            client.transport.abort()

    async def _attend(self, reader, writer):
        """Answer the commands of a client; if there is one already that does not leave, close the new connection."""
        if self._client is not None:
            await asyncio.sleep(_TICK)
        if self._client is not None:
            writer.close()
            return
        self._client = writer
        try:
            while self._client is writer:
                writer.write(self._answer(await reader.readuntil(b"\n")))
                if writer.transport.get_write_buffer_size():
                    await asyncio.wait_for(writer.drain(), _PATIENCE)
                self._update()
                # Many commands that wait must not keep others waiting.
                await asyncio.sleep(0)
        except (OSError, EOFError, asyncio.LimitOverrunError, asyncio.CancelledError):
            # The client has gone, sends a line without end or takes no answers, or the server ends.
            pass
        finally:
            if self._client is writer:
                self._disconnect()

    def _answer(self, command):
        with self.lock:
            answer = self.controller.answer(command.decode("latin-1"))
        return self.rehearsal.corrupt(answer.encode("latin-1", "replace")) if answer else b""
