"""A fleet of 2000 synthetic records: what is found, what is lost when processes die, and what it costs.

`fleets/records.py` makes the records: no truth is a model of dehyst. Writes `fleet.json`.
"""

import argparse
import json
import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet
from fleets.records import make

from dehyst.fleet import drifts_of, findings_of, load, open_dataset

OUTPUT = Path(__file__).parent / "fleet.json"
BY = "serial,session"
# Records of a run in which processes are killed, and on paper.
FEW, MANY = 120, 1_000_000
# Of the ageing by `auto`.
OTHERS = 600
# Of the run on a cluster: small records, samples of a cycle, workers, points in time, and a cheap identification.
SCALE, SMALL, WORKERS, STEPS = 20_000, (25, 51), 3, 10
CHEAP = ("--options", '{"elements": 4, "delay": 0}')
DEHYST = [sys.executable, "-c", "from dehyst.cli import main; main()"]
MEASURED = ("cpu_s", "wall_s", "memory_MB")
ALLOWED_MB = 350


def command(dataset: Path, output: Path, *more: str) -> list[str]:
    return [*DEHYST, "fleet", "identify", str(dataset), "-o", str(output), "--by", BY, *more]


def run(dataset: Path, output: Path, *more: str) -> dict:
    """Wall and processor seconds of a whole run, and what its tasks took."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command(dataset, output, *more), capture_output=True, text=True, check=False)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise SystemExit(done.stderr)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    rows = load(output).rows
    tasks = {name: sum(row[name] for row in rows) for name in ("cpu_s", "wall_s")}
    return {
        "records": len(rows),
        "wall_s": wall,
        "cpu_s": cpu,
        "tasks_cpu_s": tasks["cpu_s"],
        "tasks_wall_s": tasks["wall_s"],
        "task_cpu_s": {"median": float(np.median([row["cpu_s"] for row in rows])), "mean": tasks["cpu_s"] / len(rows)},
        "worker_MB": max(row["memory_MB"] for row in rows),
    }


def overhead(result: dict, jobs: int) -> dict:
    """Add what a run takes over the sum of its tasks: in wall seconds of all processes, and in processor seconds."""
    result["overhead_wall_percent"] = 100 * (jobs * result["wall_s"] / result["tasks_wall_s"] - 1)
    result["overhead_cpu_percent"] = 100 * (result["cpu_s"] / result["tasks_cpu_s"] - 1)
    return result


def found(output: Path, truth: list[dict]) -> dict:
    """Return what the report lists of what is wrong, and of what is not."""
    fleet = load(output)
    names = [fleet.name(row) for row in fleet.rows]
    findings, kinds = findings_of(fleet), {name: one["kind"] for name, one in zip(names, truth, strict=True)}
    listed = Counter(kinds[name] for name in findings.listed)
    totals = Counter(kinds.values())
    refused = Counter(kinds[n] for n, row in zip(names, fleet.rows, strict=True) if row["outcome"] == "refused")
    copies = {name for group in findings.duplicates for name in group}
    return {
        "kinds": dict(totals),
        "refused": dict(refused),
        "dead_refused_with_reason": sum(
            kinds[n] == "dead" and row["outcome"] == "refused" and bool(row["reason"])
            for n, row in zip(names, fleet.rows, strict=True)
        ),
        "listed": dict(listed),
        "false_alarm_percent": 100 * listed["healthy"] / totals["healthy"],
        "duplicates_found": sum(kind == "duplicate" and name in copies for name, kind in kinds.items()),
    }


def aged(output: Path, truth: list[dict]) -> dict:
    """Return which serials `dehyst fleet report` wants to recalibrate."""
    drifts = drifts_of(load(output), by="serial", over="session")
    by_kind = {kind: {one["serial"] for one in truth if one["kind"] == kind} for kind in {one["kind"] for one in truth}}
    wrong = by_kind["noisy"] | by_kind["drifting"] | by_kind["duplicate"]
    due = {one.serial for one in drifts.recalibrate}
    healthy = {one.serial for one in drifts.ageing} - by_kind["ageing"] - wrong
    return {
        "ageing_serials": len(by_kind["ageing"]),
        "ageing_found": len(by_kind["ageing"] & due),
        "healthy_serials": len(healthy),
        "healthy_to_recalibrate": len(healthy & due),
    }


def shards(output: Path) -> list[Path]:
    return sorted(output.with_name(f"{output.name}.parts").glob("*/*.json"))


def children(pid: int) -> list[int]:
    found = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        found += map(int, task.read_text().split())
    return [one for child in found for one in (child, *children(child))]


def is_worker(pid: int) -> bool:
    return b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()


def started(dataset: Path, output: Path, *more: str, until: int = FEW // 6) -> subprocess.Popen:
    """Start a client, and wait until it has some shards."""
    process = subprocess.Popen(command(dataset, output, *more), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    wait(process, output, until)
    return process


def wait(process: subprocess.Popen, output: Path, count: int) -> None:
    while process.poll() is None and len(shards(output)) < count:
        time.sleep(0.1)


def outcome(output: Path, reference: list, done_before: int) -> dict:
    """Whether each row is there once and the same."""
    rows = plain_rows(output)
    return {"rows": len(rows), "exactly_once": rows == reference, "done_before_the_end": done_before}


def plain_rows(output: Path) -> list[dict]:
    return [{name: value for name, value in row.items() if name not in MEASURED} for row in load(output).rows]


def killed_workers(dataset: Path, output: Path, reference: list, *more: str) -> dict:
    process, killed = started(dataset, output, *more), 0
    while process.poll() is None and killed < 4:
        for pid in [pid for pid in children(process.pid) if is_worker(pid)][:1]:
            os.kill(pid, signal.SIGKILL)
            killed += 1
        time.sleep(2)
    process.communicate()
    return {"killed": killed, **outcome(output, reference, 0)}


def killed_client(dataset: Path, output: Path, reference: list, *more: str) -> dict:
    process = started(dataset, output, *more)
    workers = children(process.pid)
    process.kill()
    process.communicate()
    time.sleep(5)
    left = sum(Path(f"/proc/{pid}").exists() for pid in workers)
    before = len(shards(output))
    run(dataset, output, *more, "--resume")
    return {"workers_left": left, **outcome(output, reference, before)}


def cluster(folder: Path, name: str, workers: int, *, profile: bool = False) -> tuple[list[subprocess.Popen], str]:
    """Start a scheduler, and workers as those of other machines; return the processes and the address.

    `profile`: whether the workers profile themselves, as they do by default.
    """
    dask, file = [sys.executable, "-m", "dask"], folder / f"{name}.json"
    nanny = {"pre-spawn-environ": {"MALLOC_TRIM_THRESHOLD_": 1 << 27}}
    settings = folder / f"{name}.yaml"
    settings.write_text(json.dumps({"distributed": {"nanny": nanny, "worker": {"profile": {"enabled": profile}}}}))
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    silent["env"] = os.environ | {"DASK_CONFIG": str(settings)}
    words = [*dask, "scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    scheduler = subprocess.Popen(words, **silent)
    while not (file.exists() and file.read_text().endswith("}")):
        time.sleep(0.1)
    address = json.loads(file.read_text())["address"]
    worker = [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--local-directory", str(folder)]
    return [scheduler, *(subprocess.Popen(worker, **silent) for _ in range(workers))], address


def killed_scheduler(dataset: Path, output: Path, reference: list, folder: Path) -> dict:
    """Begin a scheduler and two workers as processes of their own, and kill the scheduler."""
    first, address = cluster(folder, "first", 2)
    process = started(dataset, output, "--dask", address)
    ended = lost_scheduler(process, first, address)
    before = len(shards(output))
    second, another = cluster(folder, "second", 2)
    run(dataset, output, "--dask", another, "--resume")
    end(second)
    return {**ended, **outcome(output, reference, before)}


def lost_scheduler(process: subprocess.Popen, processes: list[subprocess.Popen], address: str) -> dict:
    """Kill the scheduler, the first of the processes; return how the client ends."""
    processes[0].kill()
    began = time.perf_counter()
    _, errors = process.communicate()
    seconds = time.perf_counter() - began
    end(processes)
    message = errors.decode().strip().splitlines()[-1]
    return {
        "client_status": process.returncode,
        "client_message": message.replace(address, "ADDRESS"),
        "noticed_s": seconds,
    }


def end(processes: list[subprocess.Popen]) -> None:
    for process in processes:
        workers = children(process.pid)
        process.kill()
        process.wait()
        for pid in workers:
            # A worker that has lost its nanny may have ended.
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def scale(folder: Path, count: int) -> dict:
    """Identify a fleet of small records on three workers of a scheduler, a tenth of it, and a fifth with deaths.

    The tenth also without Dask's profiler.
    """
    data, table = (folder / f"{name}.parquet" for name in ("data", "table"))
    make(data, count, seed=3, samples=SMALL)
    tenth, fifth = (first_of(data, folder / name, count // part) for name, part in (("tenth", 10), ("fifth", 5)))
    many = on_cluster(folder, data, table, profile=True)
    few = on_cluster(folder, tenth, folder / "few.parquet", profile=True)
    quiet = on_cluster(folder, tenth, folder / "quiet.parquet")
    held = client_memory(data, table)
    return {
        "many": many,
        **{name: one | {"samples": one["samples"][-1:]} for name, one in (("few", few), ("quiet", quiet))},
        "client_kB_a_record": held,
        "million": million(many, held),
        "deaths": deaths(folder, fifth, plain_rows(table)[: count // 5]),
    }


def first_of(data: Path, folder: Path, count: int) -> Path:
    """Copy the first records of a dataset to one with the same name."""
    folder.mkdir()
    file = pyarrow.parquet.ParquetFile(data)
    with pyarrow.parquet.ParquetWriter(folder / data.name, file.schema_arrow) as writer:
        for group in range(count):
            writer.write_table(file.read_row_group(group))
    return folder / data.name


def on_cluster(folder: Path, dataset: Path, output: Path, *, profile: bool = False) -> dict:
    """Run a fleet on a new cluster; watch its processes, and return what they took."""
    processes, address = cluster(folder, output.stem, WORKERS, profile=profile)
    count = len(open_dataset(dataset, BY.split(",")))
    words, began = command(dataset, output, *CHEAP, "--dask", address), time.perf_counter()
    client = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    samples, first = [], 0.0
    while client.poll() is None:
        time.sleep(2 if first else 0.1)
        done, now = len(shards(output)), time.perf_counter() - began
        first = first or (now if done else 0.0)
        if done >= count * len(samples) // STEPS:
            workers = used([pid for one in processes[1:] for pid in children(one.pid)])
            parts = {"scheduler": used([processes[0].pid]), "client": used([client.pid]), "workers": workers}
            samples.append({"records": done, "s": now, **parts})
    wall = time.perf_counter() - began
    end(processes)
    if client.returncode:
        raise SystemExit(f"{shlex.join(words)} ended with {client.returncode}")
    rows = load(output).rows
    return {
        "records": len(rows),
        "wall_s": wall,
        "first_row_s": first,
        "tasks_cpu_s": sum(row["cpu_s"] for row in rows),
        "worker_MB": max(row["memory_MB"] for row in rows),
        "table_MB": output.stat().st_size / 1e6,
        "samples": samples,
    }


def used(pids: list[int]) -> dict:
    """Return processor seconds of processes so far, and the resident memory of the largest."""
    seconds, sizes = 0.0, [0.0]
    for pid in pids:
        with suppress(OSError):
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            seconds += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
            sizes.append(int(fields[21]) * os.sysconf("SC_PAGE_SIZE") / 1e6)
    return {"cpu_s": seconds, "MB": max(sizes)}


def client_memory(dataset: Path, output: Path) -> dict:
    """Return the memory of a client for each record: of its index, and of the table's rows at the end."""
    code = (
        "import pathlib, sys\n"
        "from dehyst.fleet import load, open_dataset\n"
        "from dehyst.fleet.dataset import arrow\n"
        "def resident():\n"
        "    return int(pathlib.Path('/proc/self/statm').read_text().split()[1]) * 4.096\n"
        "arrow()\n"
        "held = [resident()]\n"
        "for read in (lambda: open_dataset(sys.argv[1], sys.argv[2].split(',')), lambda: load(sys.argv[3])):\n"
        "    held += [read(), resident()]\n"
        "print((held[2] - held[0]) / len(held[1]), (held[4] - held[2]) / len(held[3]))"
    )
    words = [sys.executable, "-c", code, dataset, BY, output]
    index, rows = map(float, subprocess.run(words, capture_output=True, text=True, check=True).stdout.split())
    return {"index": index, "rows": rows}


def million(run: dict, held: dict) -> dict:
    """Extrapolate a run linearly to a million records, from its growth after the first tenth."""
    steady = [one for one in run["samples"] if one["records"] >= run["records"] / STEPS]

    def slope(part: str, what: str) -> float:
        return float(np.polyfit([one["records"] for one in steady], [one[part][what] for one in steady], 1)[0])

    cpu, last = {part: slope(part, "cpu_s") for part in ("scheduler", "client", "workers")}, steady[-1]
    return {
        "cpu_ms_a_record": {part: 1e3 * one for part, one in cpu.items()},
        "records_a_second_at_most": 1 / max(cpu["scheduler"], cpu["client"]),
        "workers_at_most": cpu["workers"] / max(cpu["scheduler"], cpu["client"]),
        "scheduler_MB": last["scheduler"]["MB"] + slope("scheduler", "MB") * (MANY - last["records"]),
        "client_MB": last["client"]["MB"] + ((MANY - run["records"]) * held["index"] + MANY * held["rows"]) / 1e3,
        "table_GB": MANY * run["table_MB"] / run["records"] / 1e3,
    }


def deaths(folder: Path, dataset: Path, reference: list) -> dict:
    """Kill a third of the workers for good, then the scheduler, and resume on another cluster."""
    output, count = folder / "deaths.parquet", len(reference)
    processes, address = cluster(folder, "dying", WORKERS)
    process = started(dataset, output, *CHEAP, "--dask", address, until=count // 3)
    end(processes[1 : 1 + WORKERS // 3])
    worker = len(shards(output))
    wait(process, output, 2 * count // 3)
    ended = lost_scheduler(process, processes, address)
    before = len(shards(output))
    others, another = cluster(folder, "after", WORKERS)
    run(dataset, output, *CHEAP, "--dask", another, "--resume")
    end(others)
    return {"worker_killed_after": worker, **ended, **outcome(output, reference, before)}


def on_paper(folder: Path, dataset: Path, output: Path, plain: dict, auto: dict) -> dict:
    """Calculate a million records from what was measured."""
    began = time.perf_counter()
    count = len(open_dataset(dataset, BY.split(",")))
    index = (time.perf_counter() - began) / count
    many, groups = folder / "groups.parquet", 5000
    schema = pyarrow.parquet.read_schema(dataset)
    few = pyarrow.parquet.ParquetFile(dataset).read_row_group(0).slice(0, 2)
    with pyarrow.parquet.ParquetWriter(many, schema) as writer:
        for _ in range(groups):
            writer.write_table(few)
    code = (
        "import pathlib, pyarrow.parquet, sys\n"
        "def resident():\n"
        "    return int(pathlib.Path('/proc/self/statm').read_text().split()[1]) * 4\n"
        "before = resident()\n"
        "file = pyarrow.parquet.ParquetFile(sys.argv[1])\n"
        "print(resident() - before, file.metadata.serialized_size)"
    )
    text = subprocess.run([sys.executable, "-c", code, many], capture_output=True, text=True, check=True).stdout
    memory_kb, footer = map(int, text.split())
    room = ALLOWED_MB - plain["worker_MB"]
    return {
        "records": MANY,
        "plain_core_hours": MANY * plain["task_cpu_s"]["mean"] / 3600,
        "auto_core_hours": MANY * auto["task_cpu_s"]["mean"] / 3600,
        "cores_for_a_day": MANY * plain["task_cpu_s"]["mean"] / 86400,
        "dataset_GB": MANY * dataset.stat().st_size / count / 1e9,
        "table_GB": MANY * output.stat().st_size / count / 1e9,
        "index_minutes": MANY * index / 60,
        "footer_bytes_a_row_group": footer / groups,
        "footer_memory_bytes_a_row_group": 1e3 * memory_kb / groups,
        "row_groups_a_file_at_most": int(1e6 * room / (1e3 * memory_kb / groups)),
        "breaks_first": "the footer of one Parquet file, which each worker holds: split the dataset into files",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--scale", type=int, nargs="?", const=SCALE, help="measure only so many small records on Dask")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--resume", action="store_true", help="measure only what fleet.json lacks")
    given = parser.parse_args()
    stored = json.loads(OUTPUT.read_text()) if OUTPUT.exists() else {}
    kept = stored if given.resume or given.scale else ("rehearsal", "scale")
    result = {"processors": os.cpu_count(), "jobs": given.jobs} | {
        name: stored[name] for name in kept if name in stored
    }
    with tempfile.TemporaryDirectory() as name:
        if given.scale:
            write(result | {"scale": scale(Path(name), given.scale)})
        else:
            measure(Path(name), given.count, given.jobs, result)


def write(result: dict) -> None:
    OUTPUT.write_text(json.dumps(result, indent=1) + "\n")


def measure(folder: Path, count: int, jobs: int, result: dict) -> None:
    """Measure what the result lacks, and write it after each part."""
    data, few = (folder / f"{what}.parquet" for what in ("data", "few"))
    truth, _ = make(data, count), make(few, FEW, seed=2)

    def part(name: str, measured: Callable[[], dict]) -> dict:
        if name not in result:
            result[name] = measured()
            write(result)
            print(json.dumps({name: result[name]}, indent=1), flush=True)
        return result[name]

    way = ("--jobs", str(jobs))
    reference = folder / "reference.parquet"
    run(few, reference, *way)
    rows = plain_rows(reference)
    output = folder / "killed.parquet"
    part("killed_workers", partial(killed_workers, few, output, rows, *way))
    output.unlink(missing_ok=True)
    part("killed_client", partial(killed_client, few, output, rows, *way))
    part("killed_scheduler", lambda: killed_scheduler(few, folder / "e.parquet", rows, folder))
    table = folder / "table.parquet"
    plain = part("processes", lambda: overhead(run(data, table, *way), jobs))
    part("found", lambda: found(table, truth))
    part("aged", lambda: aged(table, truth))
    selected, wide = ("--structure", "auto", *way), folder / "auto.parquet"
    slow = part("auto", lambda: overhead(run(data, wide, *selected), jobs))
    part("auto_found", lambda: found(wide, truth))
    part("auto_aged", lambda: auto_aged(folder, selected))
    part("paper", lambda: on_paper(folder, few, reference, plain, slow))


def auto_aged(folder: Path, selected: tuple[str, ...]) -> dict:
    """Identify other serials by auto, and see which have aged."""
    data, output = folder / "others.parquet", folder / "others.table.parquet"
    truth = make(data, OTHERS, seed=8)
    run(data, output, *selected)
    return aged(output, truth)


if __name__ == "__main__":
    main()
