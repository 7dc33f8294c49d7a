"""Commands of a session, each in a process of its own: progress, end, and the entries made of their results."""

from __future__ import annotations

import asyncio
import inspect
import json
import os
import signal
import sys
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from dehyst._errors import DehystError
from dehyst._types import Array
from dehyst.identification.results import read_traces
from dehyst.model import Actuator
from dehyst.records import read, read_table
from dehyst.trust.turn_plane import turn_plane
from dehyst.workbench.entries import JobEntry, ModelEntry, RecordEntry, VoltageEntry
from dehyst.workbench.folder import Folder

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
    refused : dict
        The error that it printed as JSON, as `DehystError.as_dict` has it, and options to try instead; the last line on
        standard error as its message if it printed no JSON.
    """

    status: int
    result: dict[str, Any] | None
    refused: dict[str, Any] = field(default_factory=dict)

    @property
    def stopped(self) -> bool:
        """Whether a signal ended it: SIGTERM or SIGINT, whose exit statuses are 128 and their number."""
        return self.status < 0 or self.status - 128 in (signal.SIGTERM, signal.SIGINT)

    @property
    def error(self) -> str:
        """Why it has no result, in a sentence."""
        return str(self.refused.get("message") or f"the command ended with status {self.status}")


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
            output, last = await asyncio.gather(_all_of(process.stdout), self._report(process.stderr))
            printed = _json(output)
            refused = {"message": last} if printed is None else printed.pop("error", {})
            return Finished(await process.wait(), printed or None, refused)
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

    async def _report(self, stream: asyncio.StreamReader | None) -> str:
        """Hand lines of progress over; return the last line."""
        line = ""
        async for line in _lines(stream):
            if line.startswith(_HEAD):
                self._progress(line.removeprefix(_HEAD))
        return line.removeprefix(_HEAD)


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
                    finished = Finished(-signal.SIGTERM, None)
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
            # With status 1 a command is done, but not good enough; with 2 it says at most what it was given.
            usable = finished.result is not None and finished.status != 2
            entry.status, entry.error = ("done", None) if usable else ("failed", finished.error)
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
        sentence = f"the command cannot be run: {error.strerror}; is the folder still there?"
        return Finished(2, None, DehystError(sentence).as_dict())


_MICRO = 1e6
_CANCELLED = "it was ended before there was a model"


def fill_record(entry: RecordEntry, result: dict[str, Any]) -> None:
    """Fill in what `dehyst show --json` printed."""
    entry.status = "ready"
    entry.samples, entry.seconds = int(result["samples"]), float(result["duration_s"])
    entry.rate_hz, entry.noise_nm = float(result["sample_rate_Hz"]), float(result["noise_nm"])
    entry.voltage, entry.displacement_um = list(result["voltage_V"]), list(result["displacement_um"])
    columns, scales = result["columns"], result["scales"]
    entry.words = [
        f"{quantity} from '{column}'{f', {scales[quantity]}' if quantity in scales else ''}"
        for quantity, column in columns.items()
    ]
    entry.words.extend(result["problems"])


def fill_model(entry: ModelEntry, finished: Finished) -> None:
    """Fill in what `dehyst identify --json` printed, or why there is no model."""
    fit = finished.result
    if fit is None:
        stopped = entry.early or finished.stopped
        entry.status, entry.error = ("cancelled", _CANCELLED) if stopped else ("failed", finished.error)
        return
    verdict = fit.get("verdict")
    if verdict is None:
        entry.status, entry.error = "failed", str(fit["sentence"])
        return
    entry.status, entry.error = "ready", None
    entry.verdict = {
        "readiness": verdict["readiness"],
        "sentence": verdict["sentence"],
        "largest_percent": verdict["largest_percent"],
        "rms_percent": verdict["rms_percent"],
        "largest_um": verdict["largest_m"] * _MICRO,
        "noise_um": verdict["noise_m"] * _MICRO,
        "basis": verdict["basis"],
        "goal": verdict["goal_percent"],
        "why": verdict["reasons"],
        "remarks": fit["remarks"],
    }
    entry.band_percent = verdict["largest_percent"]
    names = ("record", "role", "samples", "left_out", "largest_percent", "rms_percent")
    entry.table = [{name: error[name] for name in names} for error in fit["errors"]]
    entry.summary = [fit["sentence"], *fit["repairs"]]


def fill_voltage(entry: VoltageEntry, finished: Finished, file: Path) -> None:
    """Fill in what `dehyst compensate --json` printed."""
    result: dict[str, Any] = finished.result or {}
    entry.clamped = int(result.get("clamped", 0))
    entry.range_v = [float(result["lowest_V"]), float(result["highest_V"])] if "lowest_V" in result else []
    entry.words = [str(one) for one in result.get("warnings", ())]
    if result.get("homing_samples"):
        entry.words.insert(0, f"the first {result['homing_s']:.4g} s home the actuator: play the whole file")
    columns = voltage_columns(file)
    entry.samples, entry.seconds = columns[0].size, float(columns[0][-1] - columns[0][0]) if columns[0].size else 0.0


def fill_ranges(entry: ModelEntry, file: Path) -> None:
    """Fill in voltages [V] and speed [V/s] that a model is known for, and the displacements [um] that it reaches."""
    actuator = Actuator.load(file)
    entry.range_v, entry.slew_v_per_s = list(actuator.voltage_range), actuator.recorded_slew_rate
    entry.range_um = [end * _MICRO for end in actuator.reach]


def wasm(file: Path, period: float | None) -> bytes:
    """Return a model as a WebAssembly module with a `period` [s], for a model that depends on time."""
    from dehyst.control import Compensator
    from dehyst.exports import wasm_module

    actuator = Actuator.load(file)
    return wasm_module(Compensator(actuator, period=period if actuator.needs_time else None))


def record_columns(file: Path) -> tuple[Array, ...]:
    """Return time [s], voltage [V] and displacement [um] of a record's file."""
    record = read(file)
    return record.time - record.time[0], record.voltage, record.displacement * _MICRO


def voltage_columns(file: Path) -> tuple[Array, ...]:
    """Return time [s], voltage [V], wanted and expected displacement [um] of an output of `dehyst compensate`."""
    table = read_table(file)
    columns = {column.name: column.data for column in table.columns}
    voltage = columns["voltage_V"]
    time = columns.get("time_s", np.arange(voltage.size, dtype=np.float64))
    wanted = columns["displacement_um"]
    return time, voltage, wanted, columns.get("expected_um", wanted)


def trace_heads(file: Path) -> dict[str, Any]:
    """Return name, role, samples and gaps [s] of each record of a file of traces, and where they turned."""
    traces = list(read_traces(file)) if file.exists() else []
    plane = turn_plane((trace.record, trace.time, trace.voltage) for trace in traces)
    heads = [
        {
            "name": trace.record,
            "role": trace.role,
            "samples": int(trace.time.size),
            "shaded": list(_gaps(trace.time, trace.began)),
        }
        for trace in traces
    ]
    return {"records": heads, "turns": None if plane is None else plane.as_dict()}


def trace_columns(file: Path, number: int) -> tuple[Array, ...]:
    """Return time [s], voltage [V], measured and simulated displacement [um] of a trace; IndexError if none."""
    trace = list(read_traces(file))[number]
    return trace.time - trace.began, trace.voltage, trace.measured * _MICRO, trace.simulated * _MICRO


def packed(columns: tuple[Array, ...]) -> bytes:
    """Return columns one after the other as little-endian 32-bit floats."""
    return b"".join(column.astype("<f4").tobytes() for column in columns)


def _gaps(time: Array, began: float) -> Iterator[list[float]]:
    """Yield begin and end [s] of what was set aside, from the record's first sample."""
    if not time.size:
        return
    if began < time[0]:
        yield [0.0, float(time[0] - began)]
    steps = np.diff(time)
    for k in np.flatnonzero(steps > 3 * np.median(steps)) if steps.size else ():
        yield [float(time[k] - began), float(time[k + 1] - began)]
