"""Small fleets: Parquet, Zarr and folders of records, and the processes of a client."""

import os
import signal
import time
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import numpy as np

from dehyst import Record, write_record
from dehyst.fleet.engine import run_one
from dehyst.fleet.table import Shards
from dehyst.fleet.task import TaskRunner
from dehyst.virtual import PlayActuator


def voltage(samples=60):
    """Two cycles through 0 to 100 V, two smaller ones and two that hang from the top."""
    turns = np.array([0, 100, 0, 100, 0, 60, 0, 30, 0, 100, 40, 100, 0])
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples // 2 + 1) / (samples // 2))
    return np.concatenate([[0.0], *(a + (b - a) * rise for a, b in pairwise(turns))])


def columns(number, gain=1.0, noise=2e-9, drift=0.0, samples=60, width=0.5):
    """Time [s], voltage [V] and displacement [um] of a record."""
    v = voltage(samples)
    t = np.arange(v.size) / 1000
    stage = PlayActuator(stroke=10e-6 * gain, highest=100.0, plays=50, noise=noise, seed=number, width=width)
    y = 1e6 * stage.play(v)
    return t, v, y + drift * np.ptp(y) * t / t[-1]


def write_parquet(path, count, change=lambda number: {}, sessions=2):
    """Write records in row groups; `change` returns arguments of `columns`, or None for a dead actuator."""
    import pyarrow
    import pyarrow.parquet

    kinds = [("serial", pyarrow.string()), ("session", pyarrow.int64())]
    schema = pyarrow.schema(kinds + [(name, pyarrow.float64()) for name in ("time_s", "voltage_V", "displacement_um")])
    with pyarrow.parquet.ParquetWriter(path, schema) as writer:
        for number in range(count):
            given = change(number)
            t, v, y = columns(number, **(given or {}))
            y = np.random.default_rng(number).normal(0, 2e-3, t.size) if given is None else y
            keys = [[f"S{number // sessions:03d}"] * t.size, [number % sessions] * t.size]
            writer.write_table(pyarrow.table([*keys, t, v, y], schema=schema))
    return path


def write_zarr(path, count):
    """Write records as groups named SERIAL/SESSION."""
    import zarr

    root = zarr.open_group(str(path), mode="w")
    for number in range(count):
        group = root.require_group(f"S{number // 2:03d}/{number % 2}")
        for name, unit, values in zip(
            ("time", "voltage", "displacement"), ("s", "V", "um"), columns(number), strict=True
        ):
            array = group.create_array(name, data=values)
            array.attrs["units"] = unit
    return path


def write_folder(path, count):
    """Write records as files SERIAL/SESSION.csv."""
    for number in range(count):
        folder = path / f"S{number // 2:03d}"
        folder.mkdir(parents=True, exist_ok=True)
        t, v, y = columns(number)
        write_record(folder / f"{number % 2}.csv", Record(t, v, y * 1e-6))
    return path


def children(pid):
    """Process ids of the children of a process."""
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found += map(int, task.read_text().split())
    return found


def descendants(pid):
    """Process ids of the children, their children and so on."""
    return [one for child in children(pid) for one in (child, *descendants(child))]


def workers_of(pid):
    """Process ids of the workers of a client."""
    found = []
    for one in children(pid):
        with suppress(OSError):
            found += [one] if b"spawn_main" in Path(f"/proc/{one}/cmdline").read_bytes() else []
    return found


class Fatal:
    """The function of tasks, with a record at a position that ends its process in the first trials."""

    def __init__(self, position, deaths):
        self.position, self.deaths = position, deaths

    def __call__(self, head, task):
        file = Shards(Path(head["folder"]), head["digest"]).path(task).with_suffix(".tried")

        def fail(*_):
            os._exit(9)

        if task.position != self.position or (file.exists() and file.stat().st_size >= self.deaths):
            return run_one(head, task)
        with patch("dehyst.fleet.task.run_task", fail):
            return run_one(head, task)


def inline(head, tasks, *, jobs, scheduler):
    """Run tasks in this process."""
    yield from map(TaskRunner(head).run, tasks)


def noisy(head, task):
    """The function of tasks, which prints."""
    os.write(1, b"a library prints\n")
    return run_one(head, task)


def alive(pid):
    """Whether a process runs."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill(pid):
    """End a process as the system does when memory runs out."""
    os.kill(pid, signal.SIGKILL)


def until(condition, seconds=60.0):
    """Wait for a condition; whether it came."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return False
