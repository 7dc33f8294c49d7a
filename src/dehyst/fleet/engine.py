"""Tasks run by Dask: on a cluster of local processes, or on the workers of a scheduler."""

from __future__ import annotations

import logging
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Generator, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from itertools import islice
from typing import Any

from dehyst._errors import DehystError, LinkError, library
from dehyst.fleet.dataset import Task
from dehyst.fleet.task import TaskRunner

# Seconds to wait for the scheduler and its first worker, for an answer that is said to be there, to close, and between
# looks at the scheduler.
_PATIENCE, _ANSWER, _CLOSING, _GLANCE = 30, 3, 3, 0.5
# Times that local workers are started, in case that they are killed before their first task.
_STARTS = 5
# Tasks that wait beside those that run, for each thread of the workers.
_AHEAD = 2
# Dask's own threshold of 64 kB makes tasks take half as much processor time again. `TaskRunner` counts the deaths of
# the workers of each task, Dask also those of tasks that waited there.
_SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 1 << 27,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 1 << 25,
    "distributed.scheduler.allowed-failures": 1_000_000,
    # Nobody looks at profiles and loads of the workers, which cost a tenth of a short task.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
}
_here = threading.local()


def _distributed() -> Any:
    return library("distributed", "A fleet", "fleet")


def run_tasks(
    head: Mapping[str, Any], tasks: list[Task], *, jobs: int | None = None, scheduler: str | None = None
) -> Generator[dict[str, Any] | None, None, None]:
    """Yield the answer to each task, and None at least once a second; closing the iterator ends the local workers.

    `head`: data that a task needs in addition to its record. `jobs`: number of local processes, by default one for each
    processor. `scheduler`: address of a scheduler with its own workers.
    """
    name = scheduler or "workers"
    try:
        with _quiet(), _without_script(), _connected(jobs, scheduler) as client:
            yield from _answers(client, head, tasks, name)
    except DehystError:
        raise
    # What Dask raises while its scheduler goes depends on what it did then.
    except (OSError, CancelledError) as error:
        raise _lost(name) from error


def _answers(client: Any, head: Mapping[str, Any], tasks: list[Task], name: str) -> Iterator[dict[str, Any] | None]:
    waiting, running = iter(tasks), dict[str, tuple[Task, Any]]()
    ended: queue.SimpleQueue[str] = queue.SimpleQueue()
    room, counted_at = 0, -_GLANCE
    while True:
        if time.monotonic() - counted_at >= _GLANCE:
            # Workers of a scheduler come and go; more tasks than they take would only wait there.
            workers = client.scheduler_info(n_workers=-1)["workers"].values()
            room, counted_at = (1 + _AHEAD) * max(sum(one["nthreads"] for one in workers), 2), time.monotonic()
            if client.cluster is not None and len(workers) < len(client.cluster.worker_spec):
                # A worker that was killed while it began is not begun again otherwise.
                client.cluster.scale(len(client.cluster.worker_spec))
        for task in islice(waiting, max(0, room - len(running))):
            key = f"dehyst-{head['digest'][:12]}-{task.code}"
            running[key] = task, client.submit(run_one, head, task, key=key, pure=False)
            running[key][1].add_done_callback(lambda future: ended.put(future.key))
        if not running:
            return
        try:
            key = ended.get(timeout=_GLANCE)
        except queue.Empty:
            if client.status != "running":
                raise _lost(name) from None
            yield None
            continue
        task, future = running[key]
        if future.status in ("lost", "pending") and client.status == "running":
            # Its worker died before the answer was here: it runs again, and finds the row.
            future.add_done_callback(lambda future: ended.put(future.key))
            continue
        try:
            answer = _answer(head, task, future, name)
        except TimeoutError:
            if client.status != "running":
                raise
            # Its worker died with the answer, but Dask does not know that yet.
            ended.put(key)
            yield None
            continue
        del running[key]
        yield answer


def _answer(head: Mapping[str, Any], task: Task, future: Any, name: str) -> dict[str, Any]:
    if future.status == "finished":
        return dict(future.result(timeout=_ANSWER))
    if future.status != "error":
        raise _lost(name)
    error = future.exception(timeout=_ANSWER)
    if isinstance(error, _distributed().KilledWorker):
        return TaskRunner(head).lose(task, "worker", f"its workers died, the last one {error.last_worker.address}")
    if isinstance(error, DehystError):
        raise error
    raise LinkError(f"{name}: a worker failed ({type(error).__name__}: {error}); does it have this dehyst?")


def _lost(name: str) -> LinkError:
    return LinkError(
        f"{name}: the connection to Dask's scheduler is lost; what is done is kept. Start the scheduler, then give the "
        "same command with --resume"
    )


@contextmanager
def _connected(jobs: int | None, scheduler: str | None) -> Iterator[Any]:
    """Connect to workers, and close the connection in any case."""
    distributed, opened = _distributed(), list[Any]()
    try:
        if scheduler is None:
            opened.append(_local(distributed, jobs))
        try:
            opened.append(distributed.Client(scheduler or opened[0], timeout=_PATIENCE))
            opened[-1].wait_for_workers(1, timeout=_PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            raise LinkError(
                f"{scheduler}: no Dask scheduler with a worker ({type(error).__name__}: {error}); start 'dask "
                "scheduler' and 'dask worker ADDRESS' first"
            ) from error
        yield opened[-1]
    finally:
        for one in reversed(opened):
            with suppress(Exception):
                one.close(timeout=_CLOSING)


def _local(distributed: Any, jobs: int | None) -> Any:
    """Return a cluster on this machine whose workers keep the memory that a task has freed for the next one."""
    from dask import config

    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    for left in reversed(range(_STARTS)):
        try:
            with config.set(_SETTINGS):
                return distributed.LocalCluster(
                    n_workers=jobs or processors,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    scheduler_kwargs={"dashboard": False},
                    memory_limit=None,
                    preload=__name__,
                    silence_logs=logging.CRITICAL,
                )
        except (OSError, RuntimeError, TimeoutError) as error:
            if not left:
                raise LinkError(f"workers cannot be started ({error}); is there memory left?") from error
    return None


def dask_setup(_worker: Any) -> None:
    """Prepare a local worker, which preloads this module: only the client handles Ctrl-C and prints."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)


def run_one(head: Mapping[str, Any], task: Task) -> dict[str, Any]:
    """Run one task in a worker; return the answer for the client."""
    runner: TaskRunner | None = getattr(_here, "runner", None)
    if runner is None or runner.head != head:
        _here.runner = runner = TaskRunner(head)
    return runner.run(task)


@contextmanager
def _without_script() -> Iterator[None]:
    """Keep workers from importing the running script, which may begin the run without a check of `__name__`."""
    script = vars(sys.modules["__main__"])
    kept = {name: script.get(name) for name in ("__file__", "__spec__")}
    try:
        script.update(dict.fromkeys(kept))
        yield
    finally:
        script.update(kept)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence Dask's logs (each has its own level) while the command shows its own progress."""
    _distributed()
    names = [name for name in logging.Logger.manager.loggerDict if name.split(".")[0] in ("distributed", "tornado")]
    levels = {name: logging.getLogger(name).level for name in names}
    try:
        for name in levels:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)
