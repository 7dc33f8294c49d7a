"""Who does the tasks of a run: processes of this machine, or Dask."""

from __future__ import annotations

import json
import logging
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from typing import IO, Any, NamedTuple

from dehyst._errors import DehystError, IdentifyError, LinkError
from dehyst.fleet.dataset import Task, distributed
from dehyst.fleet.task import TaskRunner


class Done(NamedTuple):
    """A task that ended: what its worker answers, or the `reason` why there is no row."""

    task: Task
    answer: Mapping[str, Any]
    reason: str = ""


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


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


# Seconds to wait for the scheduler and its first worker, to close, and between looks at the scheduler.
_PATIENCE, _CLOSING, _GLANCE = 30, 3, 0.5
# Tasks that wait beside those that run, for each thread of the workers.
_AHEAD = 2
# Dask's own threshold of 64 kB makes tasks take half as much processor time again.
_MEMORY = {"MALLOC_TRIM_THRESHOLD_": 1 << 27, "MALLOC_MMAP_THRESHOLD_": 1 << 25}
_here = threading.local()


class DaskEngine:
    """Tasks by Dask.

    `head`: what a task needs beside its record. `address`: "local" or that of a scheduler. `jobs`: number of local
    processes.
    """

    def __init__(self, head: Mapping[str, Any], address: str, jobs: int | None) -> None:
        self._head, self._address, self._jobs = dict(head), address, jobs
        if address != "local" and jobs is not None:
            raise IdentifyError("jobs: a scheduler has workers of its own; leave jobs out, or let this machine do it")

    def run(self, tasks: list[Task]) -> Generator[Done | None, None, None]:
        """Yield each task that ends, and None at least once a second."""
        try:
            yield from self._run(tasks)
        except DehystError:
            raise
        # What Dask raises while its scheduler goes depends on what it did then.
        except (OSError, CancelledError) as error:
            raise self._lost() from error

    def _run(self, tasks: list[Task]) -> Generator[Done | None, None, None]:
        with _quiet(), self._client() as client:
            waiting = iter(tasks)
            ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
            futures: dict[str, tuple[Task, Any]] = {}
            self._submit(client, islice(waiting, self._room(client)), futures, ended)
            while futures:
                done = self._next(client, futures, ended)
                if done is not None:
                    self._submit(client, islice(waiting, max(0, self._room(client) - len(futures))), futures, ended)
                yield done

    def _submit(self, client: Any, tasks: Iterator[Task], futures: dict[str, tuple[Task, Any]], ended: Any) -> None:
        for task in tasks:
            key = f"dehyst-{self._head['digest'][:12]}-{task.code}"
            future = client.submit(run_one, self._head, task.as_dict(), key=key, pure=False)
            futures[key] = task, future
            future.add_done_callback(lambda future: ended.put(future.key))

    def _next(self, client: Any, futures: dict[str, tuple[Task, Any]], ended: Any) -> Done | None:
        """Wait for a task that ends, for a moment."""
        try:
            key = ended.get(timeout=_GLANCE)
        except queue.Empty:
            self._refuse_lost(client)
            return None
        task, future = futures.pop(key)
        if future.status == "finished":
            return Done(task, future.result(timeout=_PATIENCE))
        if future.status != "error":
            raise self._lost()
        error = future.exception(timeout=_PATIENCE)
        if isinstance(error, distributed().KilledWorker):
            return Done(task, {}, f"its workers died, the last one {error.last_worker.address}")
        if isinstance(error, DehystError):
            raise error
        raise LinkError(
            f"{self._address}: a worker failed ({type(error).__name__}: {error}); does it have this dehyst?"
        )

    def _refuse_lost(self, client: Any) -> None:
        if client.status != "running":
            raise self._lost()

    def _lost(self) -> LinkError:
        return LinkError(
            f"{self._address}: the connection to Dask's scheduler is lost; what is done is kept. Start the scheduler, "
            "then give the same command with --resume"
        )

    def _room(self, client: Any) -> int:
        """Return how many tasks to hand to the scheduler: more would only wait there."""
        threads: int = sum(worker["nthreads"] for worker in client.scheduler_info(n_workers=-1)["workers"].values())
        return (1 + _AHEAD) * max(threads, 2)

    @contextmanager
    def _client(self) -> Iterator[Any]:
        """Connect, and close in any case."""
        dask = distributed()
        cluster, client = None, None
        try:
            if self._address == "local":
                cluster = _local(dask, self._jobs or processors())
            try:
                client = dask.Client(self._address if cluster is None else cluster, timeout=_PATIENCE)
                client.wait_for_workers(1, timeout=_PATIENCE)
            except (OSError, TimeoutError, ValueError) as error:
                raise LinkError(
                    f"{self._address}: no Dask scheduler with a worker ({type(error).__name__}: {error}); start "
                    "'dask scheduler' and 'dask worker ADDRESS' first"
                ) from error
            yield client
        finally:
            for one in (client, cluster):
                if one is not None:
                    with suppress(Exception):
                        one.close(timeout=_CLOSING)


def _local(library: Any, jobs: int) -> Any:
    """Return a cluster on this machine whose workers keep the memory that a task has freed for the next one."""
    from dask import config as settings

    name = "distributed.nanny.pre-spawn-environ"
    environment = {**settings.get(name, {}), **_MEMORY}
    with settings.set({name: environment}):
        return library.LocalCluster(
            n_workers=jobs,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
        )


def run_one(head: Mapping[str, Any], task: Mapping[str, Any]) -> dict[str, Any]:
    """Run one task in a worker; return what the client needs to know."""
    runners = _here.__dict__
    if head["digest"] not in runners:
        runners.clear()
        runners[head["digest"]] = TaskRunner(head)
    runner: TaskRunner = runners[head["digest"]]
    return runner.run(Task.from_dict(task), keep=True)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's logs, each of which has a level of its own, while the command shows its own progress."""
    distributed()
    names = [name for name in logging.Logger.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    try:
        for name in levels:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
