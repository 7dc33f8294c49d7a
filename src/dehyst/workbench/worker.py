"""A process that runs operations for the workbench, one after another: ``python -m dehyst.workbench.worker``.

A request is ``{"id": 1, "do": OPERATION, "with": {...}, "force": false}``; its answer, of the kind "done" and with the
same id, has a "result" and whether it is "good", an "error", or "stopped". ``{"do": "finish"}``, and SIGINT, end a
running operation early, with its best result so far. The process ends when its input does, or by SIGTERM.
"""

from __future__ import annotations

import os
import signal
import traceback
from queue import SimpleQueue

from dehyst._errors import DehystError
from dehyst._process import Inlet, Message, Outlet, lines_of, own_output
from dehyst.operations.registry import find
from dehyst.operations.run import InterruptibleRun, perform, terminable

_NICE = 5


class _WorkerRun(InterruptibleRun):
    """A run that sends its progress."""

    def __init__(self, outlet: Outlet) -> None:
        super().__init__()
        self._outlet = outlet

    def progress(self, words: str) -> None:
        """Send what is being done."""
        if words:
            self._outlet.progress(progress=words)


def main() -> None:
    """Run operations until the process is ended."""
    # A process that drives an instrument comes first. Windows has no such number.
    if hasattr(os, "nice"):
        os.nice(_NICE)
    outlet, requests = Outlet(own_output()), SimpleQueue[Message]()

    def take(message: Message) -> None:
        if message.get("do") == "finish":
            os.kill(os.getpid(), signal.SIGINT)
        else:
            requests.put(message)

    Inlet(lines_of(0), take, outlet.error, lambda: os.kill(os.getpid(), signal.SIGTERM)).start()
    while True:
        # Between two operations there is nothing to end.
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        request = requests.get()
        try:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            answer = _answer(request, _WorkerRun(outlet))
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        except KeyboardInterrupt:
            answer = {"stopped": True}
        outlet.done(request["id"], **answer)


def _answer(request: Message, run: _WorkerRun) -> Message:
    try:
        with terminable():
            operation = find(request["do"])
            values = operation.of_json(request["with"])
            result = perform(operation, values, run, force=bool(request.get("force")))
            return {"result": result.as_dict(), "good": result.good}
    except DehystError as error:
        return {"error": {**run.known, **error.as_dict()}}
    except Exception as error:
        traceback.print_exc()
        return {"error": {"message": f"{type(error).__name__}: {error}"}}


if __name__ == "__main__":
    main()
