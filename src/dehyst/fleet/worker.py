"""A worker process: takes one task at a time on standard input, answers on standard output, ends with its client."""

from __future__ import annotations

import json
import os
import queue
import signal
import sys
import threading
from collections.abc import Iterator
from typing import Any, TextIO


def main() -> None:
    """Read the head of the run, then tasks, a line each; write the row of each to its shard, then a line about it."""
    # Ctrl-C on a terminal reaches every process; the client decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = _private_output()
    head = json.loads(sys.stdin.readline() or "null")
    if head is None:
        return
    from dehyst._threads import one_thread
    from dehyst.fleet.dataset import Task
    from dehyst.fleet.task import TaskRunner

    runner = TaskRunner(head)
    with one_thread():
        _answer(answers, {"ready": os.getpid()})
        for line in _lines():
            task = Task.from_dict(json.loads(line))
            _answer(answers, {"position": task.position, **runner.run(task)})


def _private_output() -> TextIO:
    """Return a stream to the client; what a library prints goes to standard error."""
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return stream


def _lines() -> Iterator[str]:
    """Yield lines of standard input; its end ends the process at once, even in the middle of a task."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            lines.put(line)
        # The client is gone, or needs no more: a shard is written whole or not at all.
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    while True:
        yield lines.get()


def _answer(stream: TextIO, words: dict[str, Any]) -> None:
    try:
        stream.write(json.dumps(words) + "\n")
        stream.flush()
    except OSError:
        os._exit(0)


if __name__ == "__main__":
    main()
