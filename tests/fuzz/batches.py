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
import traceback
from collections import Counter

HANG = 10
MEMORY = 2 << 30
_SHOWN = 20


def run(play, seed, count, *, first=0):
    """Play cases `first` to `count` - 1; return what the summary holds."""
    findings, counts = [], Counter()
    for case in range(first, count):
        found, noted = _played(play, seed, case)
        findings += [{"case": case, "what": what, "ended": noted is None} for what in found]
        counts.update(noted or {})
    return {"seed": seed, "cases": count - first, "findings": findings, "counts": dict(sorted(counts.items()))}


def main(play):
    """The command line of a fuzzer."""
    parser = argparse.ArgumentParser(description=sys.modules["__main__"].__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="a finding is played again with the number of its case")
    summary = run(play, **vars(parser.parse_args()))
    print(json.dumps(summary))
    sys.exit(1 if summary["findings"] else 0)


def in_a_child(act):
    """What a function returns in a process of its own, how that ended, and what it used."""
    out, into = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(out)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (HANG, resource.RLIM_INFINITY))
        with os.fdopen(into, "w") as pipe:
            json.dump(act(), pipe)
        os._exit(0)
    os.close(into)
    with os.fdopen(out) as pipe:
        told = pipe.read()
    _, status, used = os.wait4(child, 0)
    return told, os.waitstatus_to_exitcode(status), used


def _played(play, seed, case):
    """What is wrong, and what was counted; nothing was if the process ended."""

    def act():
        counts = Counter()
        try:
            return play(seed, case, lambda what: counts.update([what]))[:_SHOWN], counts
        except BaseException as error:
            return [f"{type(error).__name__}: {error}"[:300] + "".join(traceback.format_exc()[-900:])], counts

    told, status, used = in_a_child(act)
    if status:
        return [f"hang over {HANG} CPU s" if status == -signal.SIGXCPU else f"crash: signal {-status}"], None
    found, counts = json.loads(told)
    if used.ru_maxrss * 1024 > MEMORY:
        found.append(f"took {used.ru_maxrss >> 10} MiB of memory")
    return found, counts
