"""A stand-in of the workbench's server: it holds a `RigLink`, and passes lines on, both ways."""

import asyncio
import json
import os
import signal
import sys

from dehyst.workbench.rig.link import RigLink

ORIGIN = "http://127.0.0.1:8123"


def show(message: dict) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


async def main() -> None:
    link = RigLink(show, origins=[ORIGIN])
    await link.start()
    show({"kind": "parent", "pid": link.pid, "stop": link.stop})
    lines = asyncio.StreamReader(limit=1 << 22)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        message = json.loads(line)
        if "alive" in message:
            link.alive()
        elif message.get("do") == "kill the rig's process":
            os.kill(link.pid, message["signal"])
        else:
            await link.send(message)
    await link.close()


if __name__ == "__main__":
    # What runs in the background may ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    asyncio.run(main())
