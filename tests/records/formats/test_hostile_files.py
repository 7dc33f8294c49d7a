"""Hostile and damaged files: nothing outside of them is read, no memory is taken on their word, nothing hangs."""

import io
import os
import re
import resource
import subprocess
import threading
import time as clock
import zipfile
import zlib

import h5py
import laboratory_files
import numpy as np
import places
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from command_line import DEHYST

import dehyst
from dehyst._errors import FileFormatError, RecordError
from dehyst.records import Columns, Record, read, read_table

N = 200
T = np.arange(N) * 1e-3
V = np.abs(50.0 - np.arange(N) % 100)
Y = V * 1e-7
NAMED = {"time_s": T, "voltage_V": V, "displacement_um": Y * 1e6}
HEAD = "time_s,voltage_V,displacement_um"
BODY = "\n".join(",".join(map(repr, row)) for row in zip(*(x.tolist() for x in NAMED.values()), strict=True)) + "\n"
SECONDS = 3.0
# Of memory that a refusal may take: with the libraries, less than what any of the files declares.
KILOBYTES = 400_000


def refused(path, match, columns=None):
    """Refuse a file quickly, and before memory is taken."""
    began, peak = clock.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError, match=match):
        read(path, columns)
    assert clock.process_time() - began < SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < KILOBYTES


def text(tmp_path, content, name="a.csv"):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# Out of the file


def with_foreign(path, kind, name="displacement_um", version_7_3=False):
    """A file whose displacement is another file's bytes."""
    secret = path.with_name("secret.h5")
    with h5py.File(secret, "w") as file:
        file["x"] = Y * 1e6
    with h5py.File(path, "w", userblock_size=512 if version_7_3 else 0) as file:
        file["time_s"], file["voltage_V"] = T, V
        if kind == "external storage":
            file.create_dataset(name, shape=(N,), dtype="<f8", external=[(str(secret), 0, N * 8)])
        elif kind == "external link":
            file[name] = h5py.ExternalLink(str(secret), "x")
        elif kind == "virtual dataset":
            layout = h5py.VirtualLayout(shape=(N,), dtype="f8")
            layout[:] = h5py.VirtualSource(str(secret), "x", shape=(N,))
            file.create_virtual_dataset(name, layout)
        else:
            file[name] = h5py.SoftLink(f"/{name}")
    if version_7_3:
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file, HDF5".ljust(124) + b"\x00\x02IM")
    return path


@pytest.mark.parametrize("name", ["a.h5", "a.hdf5", "a.mat"])
@pytest.mark.parametrize("kind", ["external storage", "external link", "virtual dataset"])
def test_samples_of_other_files_are_refused(tmp_path, kind, name):
    path = with_foreign(tmp_path / name, kind, version_7_3=name.endswith("mat"))
    refused(path, rf"column 'displacement_um': (is an?|has) {kind}")


def write_npy(path, columns):
    numbers = np.zeros(N, [(name, values.dtype) for name, values in columns.items()])
    for name, values in columns.items():
        numbers[name] = values
    np.save(path, numbers)


def write_h5(path, columns):
    with h5py.File(path, "w") as file:
        file.update(columns)


def write_pairs(path, columns):
    """As MATLAB does in files of version 7.3."""
    pairs = np.zeros(N, [("real", "f8"), ("imag", "f8")])
    write_h5(path, {name: pairs if np.iscomplexobj(values) else values for name, values in columns.items()})


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.npz", lambda path, columns: np.savez(path, **columns)),
        ("a.npy", write_npy),
        ("a.h5", write_h5),
        ("pairs.h5", write_pairs),
        ("a.mat", scipy.io.savemat),
        ("structure.mat", lambda path, columns: scipy.io.savemat(path, {"data": columns})),
    ],
)
def test_complex_columns_are_refused_by_name(tmp_path, name, write):
    write(tmp_path / name, NAMED | {"displacement_um": Y * 1e6 + 1j})
    refused(tmp_path / name, "column '(data/)?displacement_um': holds complex numbers; export")
    write(tmp_path / name, NAMED | {"spectrum": Y + 1j})
    assert np.array_equal(read(tmp_path / name).voltage, V)


def test_what_points_elsewhere_is_set_aside_while_the_file_has_the_column(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in NAMED.items():
            file[f"run/{name}"] = values
        file["old/displacement_um"] = h5py.ExternalLink("other.h5", "x")
    assert read(tmp_path / "a.h5").displacement == pytest.approx(Y)
    refused(
        tmp_path / "a.h5",
        "'old/displacement_um': is an external link to 'other.h5'",
        "displacement=old/displacement_um",
    )


def test_links_that_go_in_circles_come_to_an_end(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in NAMED.items():
            file[f"run/{name}"] = values
        file["run/up"] = file["/"]
        file["loop"] = h5py.SoftLink("/loop")
        file["twice"] = file["run/time_s"]
    assert read(tmp_path / "a.h5").time == pytest.approx(T)


def test_groups_may_not_be_endlessly_deep(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["/".join(["g"] * 200)] = T
    refused(tmp_path / "a.h5", "groups more than 64 deep")


# On its word


def with_declared(path, kind):
    """Files of some kilobytes that declare 8 GB or more."""
    many = 10**9
    if kind == "npz header":
        head = io.BytesIO()
        np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (many,)})
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("time_s.npy", head.getvalue())
    elif kind == "npy header":
        with path.open("wb") as stream:
            np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (many,)})
    elif kind == "xlsx wide":
        laboratory_files.write_xlsx(path, [[1.0]] * 2000)
        with_cells(path, rb"<row><c>", b'<row><c r="NTP1">')
    elif kind == "npz bomb":
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("time_s.npy", "w") as stream:
            np.lib.format.write_array_header_1_0(
                stream, {"descr": "<f8", "fortran_order": False, "shape": (70_000_000,)}
            )
            for _ in range(70):
                stream.write(bytes(8_000_000))
    elif kind == "hdf5 fill":
        with h5py.File(path, "w") as file:
            file.create_dataset("time_s", shape=(many,), dtype="f8", chunks=(1 << 20,), fillvalue=1.0)
    elif kind == "hdf5 chunk":
        with h5py.File(path, "w") as file:
            file.create_dataset("time_s", shape=(N,), maxshape=(None,), dtype="f8", chunks=(1 << 28,), fillvalue=1.0)
    elif kind == "mat dimensions":
        scipy.io.savemat(path, {"time_s": T})
        path.write_bytes(path.read_bytes().replace(N.to_bytes(4, "little"), many.to_bytes(4, "little"), 1))
    elif kind == "mat bomb":
        scipy.io.savemat(path, {"note": "x", **NAMED})
        zeros = zlib.compress(bytes(600_000_000), 1)
        path.write_bytes(path.read_bytes() + b"\x0f\0\0\0" + len(zeros).to_bytes(4, "little") + zeros)
    elif kind == "mat bomb of a big-endian machine":
        zeros = zlib.compress(bytes(600_000_000), 1)
        head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x01\x00MI"
        path.write_bytes(head + b"\0\0\0\x0f" + len(zeros).to_bytes(4, "big") + zeros)
    elif kind == "parquet rows":
        values = pa.array(np.zeros(70_000_000, "i1")).cast(pa.int8())
        pq.write_table(pa.table({"time_s": values}), path, row_group_size=70_000_000)
    elif kind == "text":
        path.write_bytes(b"t" + b",x" * 9_000 + b"\n" * 10_000)
    return path


def with_cells(path, old, new):
    """Replace text in the sheets of a workbook."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, re.sub(old, new, part) if "sheet1" in name else part)


def test_a_sheet_has_no_more_rows_than_a_spreadsheet(tmp_path):
    for old, new, what in (
        (rb"<row>(?=<c><v>3)", b'<row r="1000000000">', "more than 1048576 rows"),
        (rb"<c>(?=<v>3)", b'<c r="XFD3">', "more than 10000 columns"),
    ):
        laboratory_files.write_xlsx(tmp_path / "a.xlsx", [["time_s"], [1.0], [2.0], [3.0]])
        with_cells(tmp_path / "a.xlsx", old, new)
        refused(tmp_path / "a.xlsx", what)


@pytest.mark.parametrize(
    ("kind", "name", "what"),
    [
        ("npy header", "a.npy", "array 'a' declares 8000 MB"),
        ("xlsx wide", "a.xlsx", "the cells of sheet 'run' declares 500"),
        ("npz header", "a.npz", "array 'time_s' declares 8000 MB"),
        ("npz bomb", "a.npz", "array 'time_s' declares 560 MB"),
        ("hdf5 fill", "a.h5", "dataset 'time_s' declares 8000 MB"),
        ("hdf5 chunk", "a.h5", "a chunk of dataset 'time_s' declares 2147 MB"),
        ("mat dimensions", "a.mat", "variable 'time_s' declares 8000 MB"),
        ("mat bomb", "a.mat", "its compressed variables declares 5.* MB"),
        ("mat bomb of a big-endian machine", "a.mat", "its compressed variables declares 5.* MB"),
        ("parquet rows", "a.parquet", "column 'time_s' declares 560 MB"),
        ("text", "a.csv", "the number of its lines declares 720.* MB"),
    ],
)
def test_declared_sizes_are_checked_first(tmp_path, kind, name, what):
    path = with_declared(tmp_path / name, kind)
    refused(path, f"{re.escape(name)}: {what}.*500 MB that a file may take.*max_size=")


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".h5", ".mat", ".parquet"])
def test_the_limit_is_named_and_can_be_raised(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    writers = {
        ".csv": lambda: path.write_text(f"{HEAD}\n{BODY}"),
        ".npz": lambda: np.savez(path, **NAMED),
        ".h5": lambda: write_h5(path, NAMED),
        ".mat": lambda: scipy.io.savemat(path, NAMED),
        ".parquet": lambda: pq.write_table(pa.table(NAMED), path),
    }
    writers[suffix]()
    with pytest.raises(FileFormatError, match="max_size"):
        read(path, f"max_size={N / 1e6}")
    with pytest.raises(FileFormatError, match="max_size"):
        read_table(path, Columns(max_size=(path.stat().st_size - 1) / 1e6))
    assert len(read(path, "max_size=1")) == N
    for nonsense in (0, -1, float("nan"), float("inf"), "5", True):
        with pytest.raises(FileFormatError) as caught:
            Columns(max_size=nonsense)
        assert caught.value.argument == "max_size"


def test_an_array_with_less_than_it_declares(tmp_path):
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (1000,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("time_s.npy", head.getvalue() + bytes(100))
    refused(tmp_path / "a.npz", r"array 'time_s' declares 1000 numbers, but has only \d+ bytes")


# For ever


@pytest.mark.parametrize(
    "content",
    [
        "time_s," + "x" * 2_000_000 + "\n1,2\n",
        HEAD + "\n" + "1" * 3_000_000,
        '"' * 2_000_000 + "\n" + BODY,
        "#" * 5_000_000,
    ],
)
def test_endless_lines(tmp_path, content):
    refused(text(tmp_path, content), r"line \d is longer than 1000000 bytes")


def test_columns_without_number(tmp_path):
    row = ",".join("1" for _ in range(20_000))
    refused(
        text(tmp_path, ",".join(f"c{i}" for i in range(20_000)) + f"\n{row}\n{row}\n"), "has 20000 columns, at most"
    )


RUNS = [mark * 20_000 for mark in (" ", "_", "[", "(", "]", "\t", " _", "[ ", "]]", ") ")]


@pytest.mark.parametrize("run", RUNS, ids=lambda run: repr(run[:2]))
def test_hostile_cells_take_no_time(tmp_path, run):
    began = clock.process_time()
    for content in (
        f"{HEAD},x [{run}y\n" + BODY.replace("\n", ",0\n"),
        f"time_s voltage_V{run}x\n1 2\n",
        f"{HEAD},{run}\n" + BODY.replace("\n", f",{run}\n", 3),
        f"{HEAD}\n{run}\n{run}%\n{BODY}",
        f"{HEAD}\n" + "\n".join([run] * 20) + "%",
    ):
        try:
            read(text(tmp_path, content))
        except dehyst.DehystError as error:
            assert len(str(error)) < 3000  # a message is read by a person
    assert clock.process_time() - began < SECONDS


def test_many_blank_lines_before_a_comment(tmp_path):
    began = clock.process_time()
    assert len(read(text(tmp_path, f"{HEAD}\n{BODY}" + "\n" * 200_000 + "% end\n"))) == N
    assert clock.process_time() - began < SECONDS


@pytest.mark.parametrize("cell", ["5_0", "\u0665\u0660", "\u22125"])
def test_numbers_that_only_python_writes(tmp_path, cell):
    refused(text(tmp_path, f"{HEAD}\n{BODY.replace('50.0', cell, 1)}"), f"line 2 holds '{cell}', which is no number")


# Once


def sent(path, content):
    """Write into a named pipe; a reader that came twice would wait for ever."""
    thread = threading.Thread(target=path.write_bytes, args=(content,), daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize("name", ["a.csv", "pipe"])
def test_a_named_pipe_is_read_once(tmp_path, name):
    os.mkfifo(tmp_path / name)
    writer = sent(tmp_path / name, f"{HEAD}\n{BODY}".encode())
    record = read(tmp_path / name)
    writer.join(5)
    assert not writer.is_alive()
    assert record.voltage.tolist() == V.tolist()
    assert record.meta["sha256"] == read_sha(f"{HEAD}\n{BODY}".encode())


def read_sha(content):
    import hashlib

    return hashlib.sha256(content).hexdigest()


@pytest.mark.parametrize("suffix", [".h5", ".npz", ".mat", ".parquet"])
def test_a_pipe_without_a_suffix_is_known_by_its_first_bytes(tmp_path, suffix):
    whole = tmp_path / f"whole{suffix}"
    {
        ".h5": lambda: write_h5(whole, NAMED),
        ".npz": lambda: np.savez(whole, **NAMED),
        ".mat": lambda: scipy.io.savemat(whole, NAMED),
        ".parquet": lambda: pq.write_table(pa.table(NAMED), whole),
    }[suffix]()
    os.mkfifo(tmp_path / "pipe")
    writer = sent(tmp_path / "pipe", whole.read_bytes())
    record = read(tmp_path / "pipe")
    writer.join(5)
    assert record.displacement == pytest.approx(Y)
    assert record.name == "pipe"


def test_a_pipe_that_never_ends(tmp_path):
    os.mkfifo(tmp_path / "a.csv")
    endless = subprocess.Popen(["sh", "-c", f"exec cat /dev/zero > '{tmp_path / 'a.csv'}'"])
    try:
        refused(
            tmp_path / "a.csv",
            r"a\.csv: the file has at least 10 MB, more than the 10 MB that are allowed",
            columns="max_size=10",
        )
    finally:
        endless.kill()
        endless.wait()


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/null", "/dev/random"])
def test_devices_are_refused(tmp_path, device):
    (tmp_path / "a.csv").symlink_to(device)
    refused(tmp_path / "a.csv", r"a\.csv: this is a device, need a file or a pipe")


def test_the_command_line_takes_pipes_and_limits(tmp_path):
    path = text(tmp_path, f"{HEAD}\n{BODY}")
    with path.open("rb") as stream:
        command = [*DEHYST, "compare", "/dev/stdin", "--columns", "max_size=0.001"]
        done = subprocess.run(
            ["sh", "-c", 'cat | "$0" "$@"', *command],
            stdin=stream,
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "the 1000 bytes" in done.stderr


# Numbers


@pytest.mark.parametrize("column", ["time", "voltage", "displacement"])
@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 1e31])
def test_numbers_that_are_no_measurement(column, value):
    columns = {"time": T.copy(), "voltage": V.copy(), "displacement": Y.copy()}
    at = 0 if column == "time" and value < 0 else N - 1
    columns[column][at] = value
    unit = {"time": "s", "voltage": "V", "displacement": "m"}[column]
    with pytest.raises(
        RecordError, match=rf"'r': {column}\[{at}\] = {re.escape(f'{value:.6g}')} {unit} is no {column}"
    ):
        Record(**columns, name="r")
    columns[column][at] = value / abs(value) * 1e30
    record = Record(**columns)
    record.problems(), record.cycles(), record.gaps(), repr(record)


def test_times_that_no_clock_tells_apart():
    time = T.copy()
    time[1] = 5e-324
    with pytest.raises(RecordError, match=r"4.94e-324 s after time\[0\]"):
        Record(time, V, Y)


def test_times_since_1970_in_nanoseconds(tmp_path):
    def rows(step):
        lines = (f"{1763780000000000000 + i * step},{v},{y}" for i, (v, y) in enumerate(zip(V, Y, strict=True)))
        return "time_ns,voltage_V,displacement_m\n" + "\n".join(lines)

    with pytest.raises(RecordError, match=r"resolution of 2.4e-07 s only:"):
        read(text(tmp_path, rows(1)))
    coarse = read(text(tmp_path, rows(3000)))
    assert any("resolution of 2.4e-07 s only" in sentence for sentence in coarse.problems())
    assert not any("kept to" in sentence for sentence in read(text(tmp_path, rows(1_000_000))).problems())


def test_a_stroke_below_a_nucleus_is_constant():
    with pytest.raises(RecordError, match="is constant"):
        Record(T, V, Y * 1e-200).check_usable()


# By dice


def test_mutated_files(monkeypatch):
    """A small share of `python tests/fuzz/files.py`."""
    monkeypatch.syspath_prepend(places.FUZZ)
    import files

    found = files.attack(seed=13, count=150)
    assert found["cases"] == 150
    assert found["findings"] == []
    assert found["ends"]["prepared"] > 5


@pytest.mark.fuzz
def test_ten_thousand_mutated_files(monkeypatch):
    monkeypatch.syspath_prepend(places.FUZZ)
    import files

    assert files.attack(seed=1, count=10_000)["findings"] == []
