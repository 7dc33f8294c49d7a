"""Jobs of a session: operations in worker processes, with progress and result."""

from __future__ import annotations

import asyncio
import inspect
import json
import signal
import sys
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from dehyst._errors import DehystError
from dehyst.operations.command import context_of
from dehyst.workbench.folder import Folder

# Two workers are enough for one user on a computer with two cores.
_AT_ONCE = 2
# Ended jobs that are still listed.
_LISTED = 20
# Seconds that a worker may take to end after SIGTERM.
_PATIENCE = 5.0
# Bytes of a worker's longest message.
_LONGEST = 1 << 26
Progress: TypeAlias = Callable[[str], None]


def words_of(command: str, *arguments: str, **options: Any) -> list[str]:
    """Return the words of a command; raise OperationError if the command does not understand them.

    An option that is None or empty is left out; a list gives it several times, and a tuple several words.
    """
    words = [*command.split(), *arguments]
    for name, value in options.items():
        for each in value if isinstance(value, list) else [value]:
            if each not in (None, ""):
                words += [f"--{name.replace('_', '-')}", *map(str, each if isinstance(each, tuple) else (each,))]
    context_of(words)
    return words


@dataclass
class Finished:
    """The outcome of an operation.

    Attributes
    ----------
    result : dict or None
        The result as JSON values; None if the operation failed or was stopped.
    error : dict
        The error, as in `DehystError.as_dict`, and the values known before it.
    stopped : bool
        Whether it was stopped on request.
    """

    result: dict[str, Any] | None = None
    error: dict[str, Any] = field(default_factory=dict)
    stopped: bool = False

    @property
    def words(self) -> str:
        """A sentence that says why there is no result."""
        return str(self.error.get("message", "it was stopped"))


class Worker:
    """A worker process that runs operations one after another in a `folder`; the first operation starts it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: asyncio.subprocess.Process | None = None
        self._stopped = False

    @property
    def alive(self) -> bool:
        """Whether the worker can run another operation."""
        return not self._stopped and self._process is not None and self._process.returncode is None

    async def run(self, step: Sequence[str], progress: Progress) -> Finished:
        """Run an operation to its end; if this task is cancelled, the process is ended too."""
        if self._stopped:
            return Finished(stopped=True)
        try:
            self._process = self._process or await self._started()
            stdin, stdout = self._process.stdin, self._process.stdout
            assert stdin is not None and stdout is not None
            stdin.write(json.dumps({"do": step}).encode() + b"\n")
            while line := await stdout.readline():
                message = json.loads(line)
                if (done := message.get("done")) is not None:
                    return Finished(done.get("result"), done.get("error", {}), done.get("stopped", False))
                progress(message["progress"])
        except OSError as error:
            self._stopped = True
            words = f"a process cannot be started or reached ({error.strerror}); is there memory left?"
            return Finished(error={"message": words})
        except asyncio.CancelledError:
            await self.close()
            raise
        stopped, self._stopped = self._stopped, True
        status = await self._process.wait()
        return Finished(error={"message": f"its process ended with status {status}; see the terminal"}, stopped=stopped)

    async def _started(self) -> asyncio.subprocess.Process:
        """Start the process, in a session of its own: signals of the terminal do not reach it."""
        return await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "dehyst.workbench.worker"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.DEVNULL,
            cwd=self._folder,
            start_new_session=True,
            limit=_LONGEST,
        )

    def finish(self) -> None:
        """Request the best result so far, as Ctrl-C does."""
        self._send(signal.SIGINT)

    def stop(self) -> None:
        """End the operation without a result."""
        self._stopped = True
        self._send(signal.SIGTERM)

    async def close(self) -> None:
        """End the process."""
        self.stop()
        if self._process is not None:
            try:
                await asyncio.wait_for(self._process.wait(), _PATIENCE)
            except TimeoutError:
                self._process.kill()

    def _send(self, number: signal.Signals) -> None:
        if self._process is not None and self._process.returncode is None:
            with suppress(ProcessLookupError):
                self._process.send_signal(number)


@dataclass
class JobEntry:
    """A running or ended job."""

    id: str
    kind: str
    subject: str
    status: str = "running"
    progress: str = ""
    error: str | None = None


Done: TypeAlias = Callable[[Finished], Awaitable[None] | None]


class Jobs:
    """The jobs of one session: operations in at most two workers at once.

    Parameters
    ----------
    folder : Folder
    changed : callable
        Called after each change of a job.
    worker : callable
        Makes a worker.
    """

    def __init__(self, folder: Folder, changed: Callable[[], None], worker: Callable[[Path], Worker]) -> None:
        self.entries: dict[str, JobEntry] = {}
        self._folder, self._changed, self._worker = folder, changed, worker
        self._idle: list[Worker] = []
        self._busy: dict[str, Worker] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._turns, self._last = asyncio.Semaphore(_AT_ONCE), 0

    def start(
        self, kind: str, subject: str, steps: Sequence[Sequence[str]], done: Done, progress: Progress = lambda _: None
    ) -> str:
        """Run operations one after another; call `done` with the end of the last one; return the job's key."""
        self._last += 1
        entry = JobEntry(f"j{self._last}", kind, subject, progress="waiting for its turn")
        self.entries[entry.id] = entry
        task = asyncio.create_task(self._run(entry, steps, done, progress))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._changed()
        return entry.id

    def running(self, subject: str, kind: str | None = None) -> list[str]:
        """Return the keys of the running jobs of a subject, of one kind or of all kinds."""
        return [
            job.id
            for job in self.entries.values()
            if job.subject == subject and job.status == "running" and kind in (None, job.kind)
        ]

    def finish(self, key: str) -> None:
        """Request the best result so far."""
        if key in self._busy:
            self._busy[key].finish()

    def stop(self, key: str) -> None:
        """End a job without a result."""
        if self.entries[key].status == "running":
            self.entries[key].progress, self.entries[key].status = "stopping", "cancelled"
            if key in self._busy:
                self._busy[key].stop()
            self._changed()

    async def close(self) -> None:
        """End all jobs and workers."""
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await asyncio.gather(*(worker.close() for worker in self._idle))

    async def _run(self, entry: JobEntry, steps: Sequence[Sequence[str]], done: Done, progress: Progress) -> None:
        def report(words: str) -> None:
            entry.progress = words
            progress(words)
            self._changed()

        finished = Finished(stopped=True)
        try:
            async with self._turns:
                for step in steps if entry.status == "running" else ():
                    finished = await self._step(entry, step, report)
                    if finished.result is None:
                        break
                    self._folder.note(["dehyst", *step])
            entry.progress = ""
            # Call it first: when a job is done, the page looks for its results.
            after = done(finished)
            if inspect.isawaitable(after):
                await after
            if entry.status == "running":
                failed = finished.result is None
                entry.status, entry.error = ("failed", finished.words) if failed else ("done", None)
        except DehystError as error:
            entry.status, entry.error = "failed", str(error)
        finally:
            if entry.status == "running":
                entry.status, entry.error = "failed", "the workbench failed; see the terminal"
            ended = [key for key, job in self.entries.items() if job.status != "running"]
            for key in ended[:-_LISTED]:
                del self.entries[key]
            self._changed()

    async def _step(self, entry: JobEntry, step: Sequence[str], report: Progress) -> Finished:
        """Run a step in a worker, which is kept for the next one unless it ended."""
        entry.progress = ""
        worker = self._busy[entry.id] = self._idle.pop() if self._idle else self._worker(self._folder.path)
        try:
            return await worker.run(step, report)
        finally:
            del self._busy[entry.id]
            if worker.alive:
                self._idle.append(worker)
