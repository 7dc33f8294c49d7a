"""Local processes for tasks: each takes one at a time, and one that dies is replaced and its task tried again."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from contextlib import suppress
from typing import IO, Any

from dehyst._errors import LinkError
from dehyst.fleet.dataset import Task
from dehyst.fleet.engine import Done

# A task is tried so many times. Workers that end before their first task, one after another, are not replaced forever:
# three that end by themselves, or twelve that are killed.
TRIALS, _FRUITLESS, _BY_ITSELF = 3, 12, 4
COMMAND = [sys.executable, "-m", "dehyst.fleet.worker"]
# Seconds between looks at the time limits.
_LOOK = 0.2
_LIBRARIES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")


class Worker:
    """One process, and the task that it has."""

    def __init__(
        self, head: Mapping[str, Any], events: queue.SimpleQueue[tuple[Worker, dict[str, Any] | None]]
    ) -> None:
        environment = os.environ | dict.fromkeys(_LIBRARIES, "1")
        # Open as long as the process: see `close`.
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
            text=True,
            encoding="utf-8",
        )
        self.task: Task | None = None
        self.since = time.monotonic()
        self.worked = False
        self._events = events
        threading.Thread(target=self._listen, daemon=True).start()
        self.send(head)

    def send(self, words: Mapping[str, Any]) -> None:
        """Send one line; the death of the process is seen by the listener."""
        stream = self._process.stdin
        if stream is not None:
            with suppress(OSError):
                stream.write(json.dumps(words) + "\n")
                stream.flush()

    def take(self, task: Task) -> None:
        """Hand a task over."""
        self.task, self.since = task, time.monotonic()
        self.send(task.as_dict())

    def kill(self) -> None:
        """End the process at once."""
        with suppress(OSError):
            self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Release what the process leaves."""
        self.kill()
        for stream in (self._process.stdin, self._process.stdout, self._errors):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    @property
    def last_words(self) -> str:
        """How the process ended, and the last line that it printed."""
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read()[-2000:].decode(errors="replace").strip().splitlines()
        how = f"signal {-code}" if code < 0 else f"status {code}"
        return f"{how}{f': {lines[-1]}' if lines else ''}"

    def _listen(self) -> None:
        stream = self._process.stdout
        if stream is not None:
            with suppress(OSError, ValueError):
                for line in stream:
                    self._events.put((self, json.loads(line)))
        self._events.put((self, None))


class Supervisor:
    """Worker processes for one run.

    `head`: what a worker needs before its first task. `jobs`: number of processes. `time_limit`: seconds a task may
    take.
    """

    def __init__(self, head: Mapping[str, Any], jobs: int, time_limit: float | None = None) -> None:
        self._head, self._jobs, self._limit = head, jobs, time_limit
        self._events: queue.SimpleQueue[tuple[Worker, dict[str, Any] | None]] = queue.SimpleQueue()
        self._workers: list[Worker] = []
        self._trials: dict[int, int] = {}
        self._fruitless = 0

    def run(self, tasks: list[Task]) -> Generator[Done | None, None, None]:
        """Yield each task that ends, and None at least some times a second; closing the iterator ends the workers."""
        waiting, left = deque(tasks), len(tasks)
        try:
            self._workers = [self._begin() for _ in range(min(self._jobs, left))]
            while left:
                for done in self._next(waiting):
                    left -= done is not None
                    yield done
        finally:
            for worker in self._workers:
                worker.close()

    def _begin(self) -> Worker:
        return Worker(self._head, self._events)

    def _next(self, waiting: deque[Task]) -> Iterator[Done | None]:
        """Wait for one event."""
        try:
            worker, answer = self._events.get(timeout=_LOOK)
        except queue.Empty:
            yield from self._late()
            yield None
            return
        if worker not in self._workers:
            return
        if answer is None:
            yield from self._replace(worker, waiting)
            return
        task, worker.task = worker.task, None
        if task is not None:
            worker.worked, self._fruitless = True, 0
            yield Done(task, answer)
        if waiting:
            worker.take(waiting.popleft())

    def _replace(self, worker: Worker, waiting: deque[Task]) -> Iterator[Done]:
        """Begin another worker for one that died, and let its task be tried again."""
        words, task = worker.last_words, worker.task
        worker.close()
        self._workers.remove(worker)
        if not worker.worked and task is None:
            self._fruitless += 1 if words.startswith("signal") else _BY_ITSELF
            if self._fruitless >= _FRUITLESS:
                raise LinkError(f"workers end before their first task ({words}); mend that, then give --resume")
        if task is not None:
            trials = self._trials[task.position] = self._trials.get(task.position, 0) + 1
            if trials < TRIALS:
                waiting.appendleft(task)
            else:
                yield Done(task, {}, f"its worker died {trials} times, the last time by {words}")
        if waiting or any(other.task for other in self._workers):
            self._workers.append(self._begin())

    def _late(self) -> Iterator[Done]:
        """End workers whose task takes too long; another trial would take as long."""
        if self._limit is None:
            return
        for worker in list(self._workers):
            if worker.task is not None and time.monotonic() - worker.since > self._limit:
                task, worker.task = worker.task, None
                worker.worked = True
                worker.kill()
                yield Done(task, {}, f"no result within the time limit of {self._limit:g} s")
