"""Dask for tasks: a cluster on this machine, or a scheduler elsewhere; the same task, the same shards."""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any

from dehyst._errors import DehystError, IdentifyError, LinkError
from dehyst.fleet.dataset import Task
from dehyst.fleet.engine import Done, processors
from dehyst.fleet.needed import distributed
from dehyst.fleet.task import TaskRunner

# Seconds to wait for the scheduler and its first worker, to close, and between looks at the scheduler.
_PATIENCE, _CLOSING, _LOOK = 30, 3, 0.5
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
            raise IdentifyError("jobs: a scheduler has workers of its own; leave jobs out, or give dask='local'")

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
            key = f"dehyst-{self._head['digest'][:12]}-{task.position}"
            future = client.submit(run_one, self._head, task.as_dict(), key=key, pure=False)
            futures[key] = task, future
            future.add_done_callback(lambda future: ended.put(future.key))

    def _next(self, client: Any, futures: dict[str, tuple[Task, Any]], ended: Any) -> Done | None:
        """Wait for a task that ends, for a moment."""
        try:
            key = ended.get(timeout=_LOOK)
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
