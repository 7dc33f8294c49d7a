"""A command of dehyst in a process of its own: progress, end, result."""

from __future__ import annotations

import asyncio
import json
import os
import shlex
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

_HEAD = "dehyst: "
# Seconds between two lines of progress, and that a command has to end after SIGTERM.
_PROGRESS, _PATIENCE = "0.2", 5.0
# Characters of an output that are read at once.
_BLOCK = 65536


@dataclass
class Finished:
    """How a command ended.

    Attributes
    ----------
    status : int
        0 done, 1 done but not good enough, 2 wrong input; negative if a signal ended it.
    result : dict or None
        What it printed as JSON.
    messages : list of str
        What it printed on standard error, without lines of progress before it.
    """

    status: int
    result: dict[str, Any] | None
    messages: list[str] = field(default_factory=list)

    @property
    def stopped(self) -> bool:
        """Whether a signal ended it: SIGTERM or SIGINT, whose exit statuses are 128 and their number."""
        return self.status < 0 or self.status - 128 in (signal.SIGTERM, signal.SIGINT)

    @property
    def error(self) -> str:
        """Why it has no result, in a sentence."""
        sentences = [line.removeprefix(_HEAD) for line in self.messages if line.startswith(_HEAD)]
        if sentences:
            return sentences[-1]
        return self.messages[-1] if self.messages else f"the command ended with status {self.status}"

    @property
    def suggestion(self) -> dict[str, str]:
        """Options that the command suggests to try instead, by name."""
        line = next((line for line in reversed(self.messages) if line.startswith("  dehyst ")), "")
        words = shlex.split(line)
        return {name[2:].replace("-", "_"): value for name, value in pairwise(words) if name.startswith("--")}


class CommandRun:
    """One run of a command.

    Parameters
    ----------
    words : sequence of str
        The command, without "dehyst".
    folder : Path
        In which it runs.
    progress : callable
        Called with each line of progress.
    """

    def __init__(self, words: Sequence[str], folder: Path, progress: Callable[[str], None] = lambda _: None) -> None:
        self.words = tuple(words)
        self._folder, self._progress = folder, progress
        self._process: asyncio.subprocess.Process | None = None
        self._stopped = False

    async def run(self) -> Finished:
        """Run it to its end; if this task is cancelled, the process is ended too."""
        self._process = process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "dehyst.cli.worker", *self.words),
            cwd=self._folder,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            env={**os.environ, "DEHYST_PROGRESS_SECONDS": _PROGRESS, "PYTHONIOENCODING": "utf-8"},
            # Ctrl-C at the terminal of the server is the server's.
            start_new_session=True,
        )
        if self._stopped:
            self._send(signal.SIGTERM)
        try:
            # Both are pipes, so that both streams are there.
            output, messages = await asyncio.gather(_all_of(process.stdout), self._messages(process.stderr))
            return Finished(await process.wait(), _json(output), messages)
        finally:
            if process.returncode is None:
                self._send(signal.SIGTERM)
                try:
                    await asyncio.wait_for(process.wait(), _PATIENCE)
                except TimeoutError:
                    process.kill()

    def finish(self) -> None:
        """Request its best result so far, as Ctrl-C does."""
        self._send(signal.SIGINT)

    def stop(self) -> None:
        """End it without a result."""
        self._stopped = True
        self._send(signal.SIGTERM)

    def _send(self, number: signal.Signals) -> None:
        if self._process is not None and self._process.returncode is None:
            with suppress(ProcessLookupError):
                self._process.send_signal(number)

    async def _messages(self, stream: asyncio.StreamReader | None) -> list[str]:
        lines = []
        async for line in _lines(stream):
            lines.append(line)
            if line.startswith(_HEAD):
                self._progress(line.removeprefix(_HEAD))
        return lines


async def _all_of(stream: asyncio.StreamReader | None) -> bytes:
    return b"" if stream is None else await stream.read()


async def _lines(stream: asyncio.StreamReader | None) -> Any:
    """Yield lines of any length."""
    rest = b""
    while stream is not None and (block := await stream.read(_BLOCK)):
        *lines, rest = (rest + block).split(b"\n")
        for line in lines:
            yield line.decode(errors="replace")
    if rest:
        yield rest.decode(errors="replace")


def _json(output: bytes) -> dict[str, Any] | None:
    with suppress(ValueError):
        result = json.loads(output)
        return result if isinstance(result, dict) else None
    return None
