"""How a fuzzer plays its cases: each in a process of its own, so that a crash or a hang is a finding.

A fuzzer has a function `play(seed, case, note)`: it plays one case and returns what is wrong, in sentences. What it
notes is counted. An exception that leaves it is wrong too.
"""

import argparse
import json
import os
import resource
import signal
import sys
import time
import traceback
from collections import Counter

HANG = 10
MEMORY = 2 << 30
_SHOWN = 20


def run(play, seed, count, *, first=0, seconds=None):
    """Play cases `first` to `count` - 1, as far as the seconds allow; return what the summary holds."""
    started, findings, counts = time.monotonic(), [], Counter()
    case = first
    while case < count and (seconds is None or time.monotonic() - started < seconds):
        found, noted = _played(play, seed, case)
        findings += [{"case": case, "what": what, "ended": noted is None} for what in found]
        counts.update(noted or {})
        case += 1
    return {
        "seed": seed,
        "cases": case - first,
        "findings": findings,
        "counts": dict(sorted(counts.items())),
        "seconds": round(time.monotonic() - started, 1),
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


def _played(play, seed, case):
    """What is wrong, and what was counted; nothing was if the process ended."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        _child(play, seed, case, into)
    os.close(into)
    with os.fdopen(out) as pipe:
        told = pipe.read()
    _, status, used = os.wait4(child, 0)
    if number := os.waitstatus_to_exitcode(status):
        return [f"hang over {HANG} CPU s" if number == -signal.SIGXCPU else f"crash: signal {-number}"], None
    found, counts = json.loads(told)
    if used.ru_maxrss * 1024 > MEMORY:
        found.append(f"took {used.ru_maxrss >> 10} MiB of memory")
    return found, counts


def _child(play, seed, case, into):
    counts = Counter()
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (HANG, resource.RLIM_INFINITY))
    try:
        found = play(seed, case, lambda what: counts.update([what]))[:_SHOWN]
    except BaseException as error:
        found = [f"{type(error).__name__}: {error}"[:300] + "".join(traceback.format_exc()[-900:])]
    with os.fdopen(into, "w") as pipe:
        json.dump([found, counts], pipe)
    os._exit(0)
