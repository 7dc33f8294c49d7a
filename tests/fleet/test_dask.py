"""A scheduler and workers of Dask as processes of their own, some of them killed."""

import json
import subprocess
import sys
import time

import pytest

import dehyst.fleet.run
from dehyst.fleet import identify_fleet, load

pytest.importorskip("pyarrow")
pytest.importorskip("distributed", reason="needs Dask: pip install 'dehyst[fleet]'")
from command_line import DEHYST
from fleet_records import descendants, inline, kill, until, write_parquet

pytestmark = pytest.mark.slow
BY, COUNT = ("serial", "session"), 24
MEASURED = ("cpu_s", "wall_s", "memory_MB")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_parquet(tmp_path_factory.mktemp("fleet") / "d.parquet", COUNT, lambda k: None if k == 5 else {})


@pytest.fixture(scope="module")
def expected(dataset):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dehyst.fleet.run, "run_tasks", inline)
        identify_fleet(dataset, dataset.with_name("m.parquet"), by=BY)
    return rows(dataset.with_name("m.parquet"))


def rows(path):
    return [{name: value for name, value in row.items() if name not in MEASURED} for row in load(path).rows]


def client(dataset, output, *more):
    words = ["fleet", "identify", str(dataset), "-o", str(output), "--by", ",".join(BY), *more]
    return subprocess.Popen([*DEHYST, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def shards(output):
    return list(output.with_name(f"{output.name}.parts").glob("*/*.json"))


@pytest.fixture
def cluster(tmp_path):
    """A function that starts a scheduler and workers; it returns the processes and the address."""
    begun = []

    def begin(name, workers=2):
        file, silent = tmp_path / f"{name}.json", {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        dask = [sys.executable, "-m", "dask"]
        words = ["--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
        begun.append(subprocess.Popen([*dask, "scheduler", *words], **silent))
        assert until(lambda: file.exists() and file.read_text().endswith("}"), 120)
        address = json.loads(file.read_text())["address"]
        words = ["--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path)]
        begun.extend(subprocess.Popen([*dask, "worker", address, *words], **silent) for _ in range(workers))
        return begun[-1 - workers :], address

    yield begin
    for process in begun:
        for pid in descendants(process.pid):
            kill(pid)
        process.kill()
        process.wait()


@pytest.mark.nightly
def test_a_scheduler_of_others_computes_the_rows(dataset, expected, tmp_path, cluster):
    output, (_, address) = tmp_path / "m.parquet", cluster("only", workers=1)
    process = client(dataset, output, "--dask", address)
    _, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert rows(output) == expected


@pytest.mark.nightly
def test_a_scheduler_that_is_killed_ends_with_its_reason_and_resume_goes_on(dataset, expected, tmp_path, cluster):
    output, (processes, address) = tmp_path / "m.parquet", cluster("first")
    process = client(dataset, output, "--dask", address)
    assert until(lambda: len(shards(output)) >= 3, 180)
    processes[0].kill()
    began = time.monotonic()
    _, errors = process.communicate(timeout=120)
    # Nothing that was given is wrong: it is not done yet.
    assert process.returncode == 1, errors
    assert time.monotonic() - began < 110
    assert "Dask's scheduler" in errors and "Traceback" not in errors
    _, address = cluster("second")
    again = client(dataset, output, "--dask", address, "--resume")
    _, errors = again.communicate(timeout=300)
    assert again.returncode == 0, errors
    assert rows(output) == expected


def test_no_scheduler_answers(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr("dehyst.fleet.engine._PATIENCE", 2)
    with pytest.raises(OSError, match="Dask scheduler"):
        identify_fleet(dataset, tmp_path / "m.parquet", by=BY, dask="tcp://127.0.0.1:9")
