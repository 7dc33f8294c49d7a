"""Processor time of an identification on a busy machine, as shipped and with one BLAS thread forced from outside.

Two processes count beside it. Each identification is a process of its own; as it is shipped, it is free to use every
processor. Reads the measured records from `examples/measured/p885`, or from FOLDER; writes `threads.json`.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
from pathlib import Path

OUTPUT = Path(__file__).parent / "threads.json"
DATA = Path(__file__).resolve().parents[1] / "examples" / "measured" / "p885"
BUSY = 2
IDENTIFY = """
import sys, dehyst
dehyst.identify([dehyst.read(path, "voltage=drive_V") for path in sys.argv[1:]])
"""
FREE = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}


def seconds(records: list[Path], **environment: str) -> float:
    """CPU seconds of one identification, those of its children included."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", IDENTIFY, *records], check=True, env={**FREE, **environment})
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER", help="folder of the measured records")
    records = [parser.parse_args().data / f"{name}.csv" for name in ("major", "ramps")]
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(BUSY)]
    try:
        shipped, single = seconds(records), seconds(records, OPENBLAS_NUM_THREADS="1")
    finally:
        for process in busy:
            process.kill()
            process.wait()
    result = {
        "busy_processes": BUSY,
        "processors": os.cpu_count(),
        "shipped_cpu_s": shipped,
        "one_thread_cpu_s": single,
        "ratio": shipped / single,
    }
    OUTPUT.write_text(json.dumps(result, indent=1) + "\n")
    cost = f"{shipped:.1f} CPU s as shipped, {single:.1f} with OPENBLAS_NUM_THREADS=1"
    print(f"identify, {BUSY} busy processes beside it: {cost}, ratio {shipped / single:.2f}")


if __name__ == "__main__":
    main()
