"""Many records identified at once: the rows of the table, and a run that is continued."""

import json
import re
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from command_line import run

import dehyst
import dehyst.fleet
from dehyst import FileFormatError, Record
from dehyst.fleet import NUMBERS, identify_fleet
from dehyst.virtual import PlayActuator
from examples import at_night

parquet = pytest.importorskip("pyarrow.parquet")
distributed = pytest.importorskip("distributed", reason="needs Dask: pip install 'dehyst[fleet]'")


def record(seed, stroke=10e-6, samples=60):
    """Two cycles through 0 to 100 V, two smaller ones and two that hang from the top."""
    turns = np.array([0, 100, 0, 100, 0, 60, 0, 30, 0, 100, 40, 100, 0])
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples // 2 + 1) / (samples // 2))
    v = np.concatenate([[0.0], *(a + (b - a) * rise for a, b in pairwise(turns))])
    truth = PlayActuator(stroke=stroke, highest=100.0, plays=50, noise=2e-9, seed=seed, width=0.5)
    return Record(np.arange(v.size) / 1000, v, truth.play(v))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Records of two actuators, one of noise, and what is no record."""
    made = tmp_path_factory.mktemp("records")
    (made / "A").mkdir()
    (made / ".hidden").mkdir()
    again = record(0)
    dehyst.write_record(made / "A" / "1.csv", again)
    dehyst.write_record(made / "A" / "2.csv", record(1, stroke=8e-6))
    dead = np.random.default_rng(0).normal(0, 2e-9, len(again))
    dehyst.write_record(made / "dead.csv", Record(again.time, again.voltage, dead))
    dehyst.write_record(made / ".hidden" / "3.csv", again)
    (made / "bad.csv").write_text("hello\nworld\n")
    (made / "notes.txt.bak").write_text("no record")
    return made


@contextmanager
def connected(_):
    yield None


@pytest.fixture
def in_this_process(monkeypatch):
    """Compute in this process; return the names that were computed."""
    names = []

    def computed(_, paths, read):
        for name, path in paths.items():
            names.append(name)
            yield dehyst.fleet.row_of(read, name, path)

    monkeypatch.setattr(dehyst.fleet, "_connected", connected)
    monkeypatch.setattr(dehyst.fleet, "_computed", computed)
    return names


def rows(path):
    return {row["record"]: row for row in parquet.read_table(path).to_pylist()}


def test_each_record_has_a_row_with_its_numbers_or_a_reason(folder, tmp_path, in_this_process):
    found = identify_fleet(folder, tmp_path / "t.parquet")
    table = rows(found.path)
    assert list(table) == ["A/1.csv", "A/2.csv", "bad.csv", "dead.csv"]
    assert found[1:] == (4, 4, 2)
    first, second = table["A/1.csv"], table["A/2.csv"]
    assert (first["reason"], second["reason"]) == ("", "")
    assert second["stroke_um"] / first["stroke_um"] == pytest.approx(0.8, rel=2e-3)
    assert second["loop_width_um"] / first["loop_width_um"] == pytest.approx(0.8, rel=0.01)
    assert first["noise_nm"] == pytest.approx(2.0, rel=0.3)
    fit = dehyst.identify(dehyst.read(folder / "A" / "1.csv"))
    assert first["promise_percent"] == fit.promise.largest_percent
    assert dehyst.Actuator.from_dict(json.loads(first["model"])).voltage() == fit.actuator.voltage()
    assert [table["bad.csv"][name] for name in (*NUMBERS, "model")] == [None] * 7
    assert table["bad.csv"]["reason"] and table["dead.csv"]["reason"]
    assert table["dead.csv"]["noise_nm"] == pytest.approx(2.0, rel=0.3)


def test_only_records_without_a_row_are_computed(folder, tmp_path, in_this_process):
    output, files = tmp_path / "t.parquet", [folder / "bad.csv", folder / "dead.csv"]
    identify_fleet(files[0], output)
    before, in_this_process[:] = rows(output), []
    assert identify_fleet(files, output)[1:] == (2, 1, 2)
    assert in_this_process == [files[1].as_posix()]
    assert rows(output)[files[0].as_posix()] == before[files[0].as_posix()]
    for more, computed in (((), 0), (("--force",), 2)):
        status, said, _ = run("fleet", *files, "-o", output, *more, keep=True)
        numbers = [int(number) for number in re.findall(r"\d+", said.splitlines()[0])]
        assert (status, numbers) == (1, [2, computed, 2 - computed, 2])


def test_rows_are_written_at_once_and_kept_if_the_run_ends_early(folder, tmp_path, in_this_process, monkeypatch):
    monkeypatch.setattr(dehyst.fleet, "_OFTEN", 0.0)
    monkeypatch.setattr(dehyst.fleet, "_SELDOM", 0.0)
    output, seen = tmp_path / "t.parquet", []

    def read(path):
        if path.name == "dead.csv":
            # A run that is killed here has this row.
            seen.extend(rows(output))
            raise KeyboardInterrupt
        return dehyst.read(path)

    with pytest.raises(KeyboardInterrupt):
        identify_fleet([folder / "bad.csv", folder / "dead.csv"], output, read=read)
    assert [*rows(output)] == seen == [(folder / "bad.csv").as_posix()]


def test_an_unexpected_error_in_one_record_is_a_row(folder, tmp_path, in_this_process):
    def read(path):
        raise ZeroDivisionError(path.name)

    found = identify_fleet(folder / "bad.csv", tmp_path / "t.parquet", read=read)
    assert found.refused == 1


@pytest.mark.parametrize("records", [[], "nowhere", ["a.csv", "a.csv"]])
def test_no_records_or_one_name_twice_are_refused(records, tmp_path):
    (tmp_path / "nowhere").mkdir()
    given = tmp_path / records if isinstance(records, str) else records
    with pytest.raises(FileFormatError):
        identify_fleet(given, tmp_path / "t.parquet")
    assert not (tmp_path / "t.parquet").exists()


def test_an_output_that_is_no_table_is_refused(folder, tmp_path):
    output = tmp_path / "t.parquet"
    output.write_text("else")
    with pytest.raises(FileFormatError):
        identify_fleet(folder, output)
    with pytest.raises(FileFormatError):
        identify_fleet(folder, tmp_path / "t.csv")
    assert output.read_text() == "else"


@pytest.mark.parametrize("local", [False, at_night(True)])
def test_workers_of_a_scheduler_compute_the_rows(folder, tmp_path, in_this_process, monkeypatch, local):
    """And those of this computer, which are started without one."""
    files = [folder / "A" / "1.csv", folder / "bad.csv"]
    identify_fleet(files, tmp_path / "here.parquet")
    monkeypatch.undo()
    given = {"n_workers": 1, "threads_per_worker": 1, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(protocol="tcp", **given) as cluster:
        address = None if local else cluster.scheduler_address
        identify_fleet(files, tmp_path / "there.parquet", scheduler=address)
    assert rows(tmp_path / "there.parquet") == rows(tmp_path / "here.parquet")


def test_an_unreachable_scheduler_is_reported(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(dehyst.fleet, "_PATIENCE", 1)
    with pytest.raises(OSError, match="Dask scheduler"):
        identify_fleet(folder, tmp_path / "t.parquet", scheduler="tcp://127.0.0.1:9")


@pytest.mark.parametrize("name", ["folder", "absent.csv"])
def test_a_folder_among_files_and_an_absent_file_are_refused_before_a_table_is_written(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "a.csv").write_text("time_s,voltage_V,displacement_um\n")
    with pytest.raises(FileFormatError):
        identify_fleet([tmp_path / "a.csv", tmp_path / name], tmp_path / "table.parquet")
    assert not (tmp_path / "table.parquet").exists()
