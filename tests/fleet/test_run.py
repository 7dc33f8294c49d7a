"""Runs over a fleet: rows exactly once, whatever dies."""

import json
import os
import signal
import subprocess
import threading
import time

import pytest

import dehyst.fleet.engine
from dehyst import FileFormatError, IdentifyError, identify
from dehyst.fleet import FleetOptions, identify_fleet, load, open_dataset
from dehyst.fleet.dataset import Reader, sha256_of

pytest.importorskip("pyarrow")
from command_line import DEHYST
from fleet_records import Fatal, alive, descendants, kill, noisy, until, workers_of, write_folder, write_parquet

from examples import at_night

BY = ("serial", "session")
COUNT = 24


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_parquet(
        tmp_path_factory.mktemp("fleet") / "d.parquet", COUNT, lambda k: None if k == 5 else {"gain": 1 + k / 100}
    )


@pytest.fixture(scope="module")
def complete(dataset):
    return identify_fleet(dataset, dataset.with_name("m.parquet"), by=BY, jobs=2)


def client(dataset, output, *more):
    """`dehyst fleet identify` as a process."""
    words = ["fleet", "identify", str(dataset), "-o", str(output), "--by", ",".join(BY), *more]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([*DEHYST, *words], **pipes, text=True, start_new_session=True)


def shards(output):
    return sorted(output.with_name(f"{output.name}.parts").glob("*/*.json"))


def same_rows(fleet, other):
    """Whether two tables hold the same results: all but seconds and memory."""
    measured = ("cpu_s", "wall_s", "memory_MB")
    return [
        [{name: value for name, value in row.items() if name not in measured} for row in one.rows]
        for one in (fleet, other)
    ]


def test_one_row_a_record_in_the_order_of_the_dataset(dataset, complete):
    assert [(row["serial"], row["session"]) for row in complete.rows] == [
        (f"S{k // 2:03d}", k % 2) for k in range(COUNT)
    ]
    assert complete.by == BY and len(complete) == COUNT
    assert not dataset.with_name("m.parquet.parts").exists()


def test_a_dead_actuator_is_refused_with_its_reason(complete):
    row = complete.rows[5]
    assert row["outcome"] == "refused" and "constant but for noise" in row["reason"]
    assert [one["outcome"] for one in complete.rows].count("identified") == COUNT - 1


def test_a_row_is_what_identify_finds(dataset, complete):
    task = open_dataset(dataset, BY).tasks[3]
    record = Reader({}).record(task)
    fit = identify(record, structure="maxwell_slip")
    row, actuator = complete.rows[3], complete.actuators(lambda row: row["session"] == 1)[1]
    assert actuator.as_dict() == fit.actuator.as_dict()
    assert row["rms_percent"] == fit.errors[0].rms_percent and row["sha256"] == sha256_of(record)
    assert row["coefficients"][: len(actuator.slip)] == actuator.slip.stiffness.tolist()
    # The middle of the loop of a play actuator of this width.
    assert 0.05 < row["width50_um"] / row["stroke_um"] < 0.3


def test_models_load_and_rows_select_them(dataset, complete):
    path = dataset.with_name("m.parquet")
    assert len(load(path).actuators()) == COUNT - 1
    assert [one.name for one in load(path).actuators(where=lambda row: row["serial"] == "S001")] == ["S001/0", "S001/1"]
    assert load(path).rows == complete.rows


def test_killed_workers_lose_no_row(dataset, complete, tmp_path):
    output, killed = tmp_path / "m.parquet", []

    def attack():
        while len(killed) < 4 and not output.exists():
            if workers := workers_of(os.getpid()):
                killed.append(workers[0])
                kill(workers[0])
            time.sleep(1.0)

    attacker = threading.Thread(target=attack, daemon=True)
    attacker.start()
    fleet = identify_fleet(dataset, output, by=BY, jobs=2)
    attacker.join(timeout=10)
    assert killed
    first, second = same_rows(fleet, complete)
    assert first == second


@pytest.mark.nightly
def test_a_killed_client_leaves_shards_and_no_worker_and_resumes(dataset, complete, tmp_path):
    output = tmp_path / "m.parquet"
    process = client(dataset, output, "--jobs", "2")
    assert until(lambda: len(shards(output)) >= 4)
    workers = workers_of(process.pid)
    kill(process.pid)
    process.communicate()
    assert len(workers) == 2 and until(lambda: not any(map(alive, workers)), 10)
    left = {path.name: path.stat().st_mtime_ns for path in shards(output)}
    assert 4 <= len(left) < COUNT
    with pytest.raises(FileFormatError, match=r"holds \d+ records"):
        identify_fleet(dataset, output, by=BY, jobs=2)
    with pytest.raises(FileFormatError, match="another version"):
        identify_fleet(dataset, output, by=BY, options=FleetOptions(elements=7), jobs=2, resume=True)
    # One shard was cut off, as by a disk that failed.
    cut = shards(output)[0]
    cut.write_text(cut.read_text()[:100])
    fleet = identify_fleet(dataset, output, by=BY, jobs=2, resume=True)
    first, second = same_rows(fleet, complete)
    assert first == second


@pytest.mark.parametrize(("number", "status"), [at_night(signal.SIGINT, 130), at_night(signal.SIGTERM, 143)])
def test_a_stopped_client_ends_cleanly_and_names_resume(dataset, complete, tmp_path, number, status):
    output = tmp_path / "m.parquet"
    process = client(dataset, output, "--jobs", "2")
    assert until(lambda: len(shards(output)) >= 2)
    workers = descendants(process.pid)
    # Ctrl-C at a terminal reaches the workers too.
    (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == status
    assert "with --resume to go on" in errors and "Traceback" not in errors
    assert until(lambda: not any(map(alive, workers)), 10) and not output.exists()
    done = len(shards(output))
    again = client(dataset, output, "--jobs", "2", "--resume", "--json")
    words, _ = again.communicate(timeout=120)
    assert again.returncode == 0 and json.loads(words)["identified"] == COUNT - 1
    assert done < COUNT and same_rows(load(output), complete)[0] == same_rows(load(output), complete)[1]


@pytest.mark.usefixtures("in_this_process")
def test_a_finished_run_is_not_repeated(dataset, tmp_path):
    few = write_parquet(tmp_path / "few.parquet", 2)
    output = tmp_path / "m.parquet"
    identify_fleet(few, output, by=BY, jobs=1)
    before = output.stat().st_mtime_ns
    assert len(identify_fleet(few, output, by=BY, jobs=1, resume=True)) == 2
    assert output.stat().st_mtime_ns == before


@pytest.mark.parametrize("deaths", [2, 3])
@pytest.mark.nightly
def test_a_record_that_ends_its_workers_is_lost_at_the_third_time_and_the_others_are_not(
    dataset, complete, tmp_path, monkeypatch, deaths
):
    monkeypatch.setattr(dehyst.fleet.engine, "run_one", Fatal(3, deaths))
    fleet = identify_fleet(dataset, tmp_path / "m.parquet", by=BY, jobs=2)
    lost = {k: row["detail"] for k, row in enumerate(fleet.rows) if row["outcome"] == "lost"}
    assert lost == ({3: "worker"} if deaths == 3 else {})
    first, second = same_rows(fleet, complete)
    assert [row for k, row in enumerate(first) if k not in lost] == [
        row for k, row in enumerate(second) if k not in lost
    ]
    # Rows of others are kept, and the lost one is tried again.
    monkeypatch.undo()
    again = identify_fleet(dataset, tmp_path / "m.parquet", by=BY, jobs=2, resume=True)
    assert same_rows(again, complete)[0] == second and not (tmp_path / "m.parquet.parts").exists()


def test_workers_that_never_begin_end_the_run(dataset, tmp_path, monkeypatch):
    (tmp_path / "sitecustomize.py").write_text("import os\nos._exit(9)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with pytest.raises(OSError, match="started"):
        identify_fleet(dataset, tmp_path / "m.parquet", by=BY, jobs=2)
    assert not workers_of(os.getpid())


@pytest.mark.nightly
def test_a_worker_that_prints_leaves_the_output_to_the_client(dataset, tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(dehyst.fleet.engine, "run_one", noisy)
    identify_fleet(dataset, tmp_path / "m.parquet", by=BY, jobs=1)
    out, errors = capfd.readouterr()
    assert out == "" and "a library prints" in errors


@pytest.mark.nightly
def test_a_record_that_takes_too_long_is_lost_and_tried_again_on_resume(tmp_path):
    few, output = write_parquet(tmp_path / "few.parquet", 2), tmp_path / "m.parquet"
    fleet = identify_fleet(few, output, by=BY, jobs=1, time_limit=1e-3)
    assert {row["outcome"] for row in fleet.rows} <= {"lost", "identified"}
    lost = [row["detail"] for row in fleet.rows if row["outcome"] == "lost"]
    assert lost and set(lost) == {"time limit"}
    again = identify_fleet(few, output, by=BY, jobs=1, resume=True)
    assert [row["outcome"] for row in again.rows] == ["identified"] * 2


@pytest.mark.usefixtures("in_this_process")
def test_nothing_of_one_record_stops_the_others(tmp_path):
    folder = write_folder(tmp_path / "d", 4)
    (folder / "S000" / "0.csv").write_bytes(b"\0\1 no table")
    (folder / "S000" / "1.csv").write_text("time_s,voltage_V\n0,1\n1,2\n")
    fleet = identify_fleet(folder, tmp_path / "m.parquet", by=BY, jobs=1)
    assert [row["outcome"] for row in fleet.rows] == ["refused", "refused", "identified", "identified"]
    assert "displacement" in fleet.rows[1]["reason"]


def test_options_that_are_impossible(dataset, tmp_path):
    for arguments, words in (
        ({"jobs": 0}, "jobs"),
        ({"jobs": 2, "dask": "tcp://127.0.0.1:1"}, "jobs"),
        ({"time_limit": 0.0}, "time_limit"),
    ):
        with pytest.raises(IdentifyError) as caught:
            identify_fleet(dataset, tmp_path / "m.parquet", **arguments)
        assert caught.value.argument == words
    with pytest.raises(FileFormatError, match=r"ends in \.parquet"):
        identify_fleet(dataset, tmp_path / "m.csv")
    with pytest.raises(IdentifyError, match="'auto' takes neither"):
        FleetOptions(structure="auto", elements=3)


def scaled(path, count, factors):
    """Write the records of `write_parquet`, some of them with other gains."""
    return write_parquet(path, count, lambda k: {"gain": factors.get(k, 1.0)})


@pytest.mark.usefixtures("in_this_process")
def test_a_resumed_run_computes_changed_records_again(tmp_path):
    path, output, remarks = write_parquet(tmp_path / "d.parquet", 4), tmp_path / "m.parquet", []
    before = identify_fleet(path, output, by=BY, jobs=1)
    models = [one.as_dict() for one in before.actuators()]
    scaled(path, 4, {1: 1.5, 3: 1.5})
    after = identify_fleet(path, output, by=BY, jobs=1, resume=True, remark=remarks.append)
    assert remarks == ["2 records changed since the run that is resumed, as S000/1: computed again"]
    ratios = [new["stroke_um"] / old["stroke_um"] for new, old in zip(after.rows, before.rows, strict=True)]
    assert ratios[::2] == [1.0, 1.0] and all(1.45 < ratio < 1.55 for ratio in ratios[1::2])
    # Rows and models of the others are as they were, seconds included.
    assert after.rows[::2] == before.rows[::2]
    assert [one.as_dict() for one in after.actuators()[::2]] == models[::2]


@pytest.mark.usefixtures("in_this_process")
def test_shards_of_changed_records_are_computed_again(tmp_path, monkeypatch):
    path, output, remarks = write_parquet(tmp_path / "d.parquet", 3), tmp_path / "m.parquet", []
    monkeypatch.setattr(dehyst.fleet.run.Shards, "remove", lambda shards: None)
    identify_fleet(path, output, by=BY, jobs=1)
    scaled(path, 3, {2: 1.5})
    again = identify_fleet(path, output, by=BY, jobs=1, resume=True, remark=remarks.append)
    assert remarks == ["1 record changed since the run that is resumed, as S001/0: computed again"]
    assert again.rows[2]["stroke_um"] > 14


@pytest.mark.usefixtures("in_this_process")
def test_a_touched_file_changes_nothing(tmp_path):
    path, output, remarks = write_parquet(tmp_path / "d.parquet", 2), tmp_path / "m.parquet", []
    before = identify_fleet(path, output, by=BY, jobs=1)
    os.utime(path, (1, 1))
    assert identify_fleet(path, output, by=BY, jobs=1, resume=True, remark=remarks.append).rows == before.rows
    assert not remarks


@pytest.mark.usefixtures("in_this_process")
def test_a_table_of_another_run_is_not_resumed(tmp_path):
    path, output = write_parquet(tmp_path / "d.parquet", 2), tmp_path / "m.parquet"
    identify_fleet(path, output, by=BY, jobs=1)
    before, other = output.read_bytes(), write_parquet(tmp_path / "other.parquet", 2)
    for dataset, options in ((path, FleetOptions(elements=7)), (other, FleetOptions())):
        with pytest.raises(FileFormatError, match="table of another"):
            identify_fleet(dataset, output, by=BY, options=options, jobs=1, resume=True)
    assert output.read_bytes() == before and not output.with_name("m.parquet.parts").exists()


@pytest.mark.nightly
def test_records_with_the_same_keys_are_remarked_by_the_command(tmp_path):
    path, output = write_parquet(tmp_path / "d.parquet", 2), tmp_path / "m.parquet"
    words = [*DEHYST, "fleet", "identify", str(path), "-o", str(output), "--by", "serial", "--jobs", "1", "--json"]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert "share their keys" in done.stderr and "share their keys" in json.loads(done.stdout)["remarks"][0]


def test_a_table_is_not_written_into_its_dataset(tmp_path):
    folder = write_folder(tmp_path / "d", 2)
    for output in (folder / "m.parquet", folder / "S000" / "m.parquet"):
        process = client(folder, output, "--jobs", "1")
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 2 and "lies in the dataset" in errors
    assert not list(folder.rglob("*.parquet*"))
    path = write_parquet(tmp_path / "d.parquet", 2)
    with pytest.raises(FileFormatError, match="the dataset"):
        identify_fleet(path, path, by=BY, jobs=1)


def test_a_run_that_is_refused_leaves_no_empty_folder(dataset, tmp_path):
    output = tmp_path / "m.parquet"
    with pytest.raises(IdentifyError, match="scheduler"):
        identify_fleet(dataset, output, by=BY, dask="tcp://127.0.0.1:1", jobs=2)
    assert not list(tmp_path.iterdir())
