"""A process that runs operations for the workbench, one after another: ``python -m dehyst.workbench.worker``.

It reads requests and writes messages, each a line with a JSON object. A request is ``{"do": WORDS}``, the words of a
command. Messages are ``{"progress": WORDS}`` and, at the end of the operation, ``{"done": {...}}`` with a
"result" and whether it is "good", an "error", or "stopped". SIGINT ends a running operation early, with its best result
so far. The process ends at the end of its input, or by SIGTERM.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any

from dehyst._errors import DehystError
from dehyst._io import finite
from dehyst.operations.command import context_of
from dehyst.operations.run import Run, perform, terminable

Message = dict[str, Any]
# The server has a higher priority.
_NICE = 5


class _WorkerRun(Run):
    """A run that sends its progress."""

    def __init__(self, send: Callable[[Message], None]) -> None:
        super().__init__()
        self._send = send

    def progress(self, words: str) -> None:
        """Send a message about progress."""
        if words:
            self._send({"progress": words})


def main() -> None:
    """Run operations until the process is ended."""
    # Windows has no niceness.
    if hasattr(os, "nice"):
        os.nice(_NICE)
    output = _own_output()
    requests: SimpleQueue[Message] = SimpleQueue()

    def send(message: Message) -> None:
        data = json.dumps(finite(message), allow_nan=False).encode() + b"\n"
        while data:
            data = data[os.write(output, data) :]

    threading.Thread(target=_receive, args=(requests,), daemon=True).start()
    while True:
        # Between two operations the signal has no effect.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        request = requests.get()
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            answer = _answer(request, _WorkerRun(send))
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        except KeyboardInterrupt:
            answer = {"stopped": True}
        send({"done": answer})


def _own_output() -> int:
    """Return a descriptor of standard output that only messages use: the output of libraries is discarded."""
    descriptor = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    return descriptor


def _receive(requests: SimpleQueue[Message]) -> None:
    """Queue the requests of the input; its end ends the process."""
    for line in sys.stdin.buffer:
        requests.put(json.loads(line))
    os.kill(os.getpid(), signal.SIGTERM)


def _answer(request: Message, run: _WorkerRun) -> Message:
    try:
        with terminable():
            result = perform(context_of(request["do"]), run)
            return {"result": result.fields, "good": result.good}
    except DehystError as error:
        return {"error": {**run.known, **error.as_dict()}}
    except Exception as error:
        traceback.print_exc()
        return {"error": {"message": f"{type(error).__name__}: {error}"}}


if __name__ == "__main__":
    main()
