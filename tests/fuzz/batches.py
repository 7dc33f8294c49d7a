"""How a fuzzer plays its cases: in batches, each in a process of its own, so that a crash or a hang is a finding.

A fuzzer has a function `play(seed, case, note)`: it plays one case and returns what is wrong, in sentences. What it
notes is counted. An exception that leaves it is wrong too.
"""

import argparse
import json
import mmap
import os
import resource
import signal
import struct
import sys
import time
import traceback
from collections import Counter

HANG = 10
MEMORY = 2 << 30
BATCH = 500
_SHOWN = 20


def run(play, seed, count, *, first=0, seconds=None):
    """Play cases `first` to `count` - 1, as far as the seconds allow; return what the summary holds."""
    begun, findings, counts = time.monotonic(), [], Counter()
    case = first
    while case < count and (seconds is None or time.monotonic() - begun < seconds):
        stop = min(case + BATCH, count)
        left = None if seconds is None else seconds - (time.monotonic() - begun)
        case, found, noted = _batch(play, seed, case, stop, left)
        findings += found
        counts.update(noted)
    return {
        "seed": seed,
        "cases": case - first,
        "findings": findings,
        "counts": dict(sorted(counts.items())),
        "seconds": round(time.monotonic() - begun, 1),
    }


def main(name, play, known=lambda seed, finding: False):
    """The command line of a fuzzer; a finding that is known is none."""
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument(
        "--first", type=int, default=0, help="the first case: a finding is played again with its number"
    )
    parser.add_argument("--seconds", type=float, help="stop after so many")
    given = parser.parse_args()
    summary = run(play, given.seed, given.count, first=given.first, seconds=given.seconds)
    summary["findings"] = [each for each in summary["findings"] if not known(given.seed, each)]
    print(json.dumps({"fuzzer": name, **summary}))
    sys.exit(1 if summary["findings"] else 0)


def _batch(play, seed, first, stop, seconds):
    """The case to go on with, what was found, and what was counted."""
    now = mmap.mmap(-1, 8)
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        _child(play, seed, range(first, stop), now, into, seconds)
    os.close(into)
    with os.fdopen(out, "rb") as pipe:
        told = pipe.read().decode()
    _, status = os.waitpid(child, 0)
    findings, counts = [], Counter()
    for line in told.splitlines():
        entry = json.loads(line)
        findings += entry.get("findings", [])
        counts.update(entry.get("counts", {}))
    case = struct.unpack("q", now[:8])[0]
    if status == 0:
        return case, findings, counts
    number = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
    what = f"hang over {HANG} CPU s" if number == signal.SIGXCPU else f"crash: signal {number}, status {status}"
    return case + 1, [*findings, {"case": case, "what": what, "ended": True}], counts


def _child(play, seed, cases, now, into, seconds):
    status, begun, counts = 1, time.monotonic(), Counter()
    try:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        with os.fdopen(into, "w") as pipe:
            for case in cases:
                if seconds is not None and time.monotonic() - begun > seconds:
                    break
                now[:8] = struct.pack("q", case)
                found = _one(play, seed, case, counts)
                if found:
                    pipe.write(json.dumps({"findings": [{"case": case, "what": what} for what in found]}) + "\n")
                    pipe.flush()
                now[:8] = struct.pack("q", case + 1)
            pipe.write(json.dumps({"counts": counts}) + "\n")
        status = 0
    finally:
        os._exit(status)


def _one(play, seed, case, counts):
    used = resource.getrusage(resource.RUSAGE_SELF)
    limit = int(used.ru_utime + used.ru_stime) + HANG + 1
    resource.setrlimit(resource.RLIMIT_CPU, (limit, resource.RLIM_INFINITY))
    found = []
    try:
        found += play(seed, case, lambda what: counts.update([what]))
    except BaseException as error:
        found.append(f"{type(error).__name__}: {error}"[:300] + "".join(traceback.format_exc()[-900:]))
    after = resource.getrusage(resource.RUSAGE_SELF)
    if after.ru_utime + after.ru_stime - used.ru_utime - used.ru_stime > HANG:
        found.append(f"took more than {HANG} CPU s")
    if after.ru_maxrss * 1024 > MEMORY:
        found.append(f"took {after.ru_maxrss >> 10} MiB of memory")
    return found[:_SHOWN]
