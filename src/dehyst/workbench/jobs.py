"""Running commands of a session: at most two at a time, each noted in the script when it ended."""

from __future__ import annotations

import asyncio
import inspect
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import TypeAlias

from dehyst._errors import DehystError
from dehyst.workbench.command import CommandRun, Finished
from dehyst.workbench.entries import JobEntry
from dehyst.workbench.folder import Folder

# A session has one person, and a small computer two cores.
_AT_ONCE = 2
# Ended jobs that are still listed.
_LISTED = 20

Runner: TypeAlias = Callable[[Sequence[str], Path, Callable[[str], None]], CommandRun]
Done: TypeAlias = Callable[[Finished], Awaitable[None] | None]


class Jobs:
    """The commands of one session.

    Parameters
    ----------
    folder : Folder
    changed : callable
        Called after each change of a job.
    runner : callable
        Makes the command that is run.
    """

    def __init__(self, folder: Folder, changed: Callable[[], None], runner: Runner) -> None:
        self.entries: dict[str, JobEntry] = {}
        self._folder, self._changed, self._runner = folder, changed, runner
        self._commands: dict[str, CommandRun] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._turns, self._last = asyncio.Semaphore(_AT_ONCE), 0

    def start(
        self,
        kind: str,
        subject: str,
        words: Sequence[str],
        done: Done,
        progress: Callable[[str], None] = lambda _: None,
        *,
        noted: bool = True,
    ) -> str:
        """Run a command; call `done` with its end, whatever that is; return the job's key."""
        self._last += 1
        entry = JobEntry(f"j{self._last}", kind, subject, " ".join(["dehyst", *words]), progress="waiting for its turn")
        self.entries[entry.id] = entry

        def report(line: str) -> None:
            entry.progress = line
            progress(line)
            self._changed()

        command = self._commands[entry.id] = self._runner(words, self._folder.path, report)
        task = asyncio.create_task(self._run(entry, command, done, noted))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self._changed()
        return entry.id

    def running(self, subject: str, kind: str | None = None) -> list[str]:
        """Return the keys of the running jobs of a subject, of any kind or one."""
        return [
            one.id
            for one in self.entries.values()
            if one.subject == subject and one.status == "running" and kind in (None, one.kind)
        ]

    def finish(self, key: str) -> None:
        """Request the best result so far."""
        if key in self._commands:
            self._commands[key].finish()

    def stop(self, key: str) -> None:
        """End a job without a result."""
        if key in self._commands:
            self.entries[key].progress, self.entries[key].status = "stopping", "cancelled"
            self._commands[key].stop()
            self._changed()

    async def settled(self) -> None:
        """Wait until no command runs."""
        while self._tasks:
            await asyncio.gather(*tuple(self._tasks), return_exceptions=True)

    async def close(self) -> None:
        """End all commands."""
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _run(self, entry: JobEntry, command: CommandRun, done: Done, noted: bool) -> None:
        try:
            async with self._turns:
                if entry.status == "cancelled":
                    finished = Finished(-15, None, [])
                else:
                    entry.progress = ""
                    finished = await _ended(command)
            await self._conclude(entry, command, finished, done, noted)
        except DehystError as error:
            entry.status, entry.error = "failed", str(error)
        finally:
            del self._commands[entry.id]
            if entry.status == "running":
                entry.status, entry.error = "failed", "the workbench failed at it; see the terminal"
            self._forget()
            self._changed()

    async def _conclude(
        self, entry: JobEntry, command: CommandRun, finished: Finished, done: Done, noted: bool
    ) -> None:
        entry.progress = ""
        if entry.status == "running":
            # With status 1 a command is done, but not good enough.
            entry.status = "done" if finished.result is not None else "failed"
            entry.error = None if finished.result is not None else finished.error
        if entry.status == "done" and noted:
            self._folder.note(command.words)
        after = done(finished)
        if inspect.isawaitable(after):
            await after

    def _forget(self) -> None:
        """Keep the last jobs only."""
        ended = [key for key, one in self.entries.items() if one.status != "running"]
        for key in ended[:-_LISTED]:
            del self.entries[key]


async def _ended(command: CommandRun) -> Finished:
    """Run a command; one that cannot be started has ended too."""
    try:
        return await command.run()
    except OSError as error:
        return Finished(2, None, [f"the command cannot be run: {error.strerror}; is the folder still there?"])
