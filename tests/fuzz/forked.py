"""Cases run in forked workers under limits of memory and CPU time, so that a crash or a hang is laid to its case."""

from __future__ import annotations

import json
import os
import resource
import signal
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

GIB = 1 << 30
# No case may use more CPU time [s] or memory [bytes] than this.
CPU, MEMORY = 10, 2 * GIB
_BATCH = 250
# Frames of a traceback that a finding shows.
_FRAMES = 4


def run(case: Callable[[int], dict[str, Any]], numbers: range) -> Iterator[dict[str, Any]]:
    """Yield what each case returned, with its number, CPU time and memory; or "finding" and how it ended.

    If a case ended its worker, "ended" is true.

    Parameters
    ----------
    case : callable
        Number of the case -> anything that JSON can hold; an exception is a finding.
    numbers : range
    """
    left = list(numbers)
    while left:
        batch = left[:_BATCH]
        done = yield from _batch(case, batch)
        left = left[done:]


def _batch(case: Callable[[int], dict[str, Any]], batch: list[int]) -> Iterator[dict[str, Any]]:
    """Run cases in one worker until it ends; return how many were seen to."""
    readable, writable = os.pipe()
    worker = os.fork()
    if not worker:
        os.close(readable)
        _work(case, batch, writable)
    os.close(writable)
    done = 0
    with os.fdopen(readable, encoding="utf-8") as lines:
        for line in lines:
            done += 1
            yield json.loads(line)
    _, status = os.waitpid(worker, 0)
    if done < len(batch) and status:
        yield {"case": batch[done], "finding": _ended(status), "ended": True}
        done += 1
    return done


def _work(case: Callable[[int], dict[str, Any]], batch: list[int], writable: int) -> None:
    """The worker: a line a case; ends itself early, with status 0, when its memory has grown."""
    status = 1
    try:
        _, hard = resource.getrlimit(resource.RLIMIT_AS)
        resource.setrlimit(resource.RLIMIT_AS, (_virtual() + MEMORY, hard))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 2)
        for number in batch:
            before = _cpu()
            _, hard = resource.getrlimit(resource.RLIMIT_CPU)
            resource.setrlimit(resource.RLIMIT_CPU, (int(before) + CPU + 1, hard))
            peak = _peak()
            line = {"case": number, **_one(case, number), "cpu_s": round(_cpu() - before, 3)}
            # A high-water mark counts for the case that raised it.
            line["memory"] = _peak() if _peak() > peak else 0
            if line["memory"] > MEMORY:
                line.setdefault("finding", f"used {line['memory'] / GIB:.2f} GiB")
            if line["cpu_s"] > CPU:
                line.setdefault("finding", f"used {line['cpu_s']} s of CPU time")
            os.write(writable, json.dumps(line).encode() + b"\n")
            if line["memory"] > MEMORY // 2:
                break
        status = 0
    finally:
        os._exit(status)


def _one(case: Callable[[int], dict[str, Any]], number: int) -> dict[str, Any]:
    try:
        return case(number)
    except BaseException as error:  # whatever leaves a case is a finding
        frames = [f"{Path(f.filename).name}:{f.lineno} {f.name}" for f in traceback.extract_tb(error.__traceback__)]
        return {"finding": f"{type(error).__name__}: {str(error)[:200]}", "frames": frames[-_FRAMES:]}


def _ended(status: int) -> str:
    if not os.WIFSIGNALED(status):
        return f"the worker exited with status {os.waitstatus_to_exitcode(status)}"
    number = os.WTERMSIG(status)
    name = signal.Signals(number).name
    return f"more than {CPU} s of CPU time" if number in (signal.SIGXCPU, signal.SIGKILL) else f"crashed with {name}"


def _cpu() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _peak() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _virtual() -> int:
    """Bytes of address space that the process has now."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
