"""Files: what writes each, and the record or the refusal that it gives, before memory is taken on its word."""

import hashlib
import os
import resource
import struct
import sys
import time as clock
import zipfile
from functools import partial

import h5py
import laboratory_files
import nptdms
import numpy as np
import pytest
import scipy.io

from dehyst._errors import FileFormatError, MissingExtraError, RecordError
from dehyst.records import read, read_table, write_columns

N = 60
T = np.arange(N) * 0.01
V = 50 - 50 * np.cos(T * 20)
Y = 1e-5 * np.sin(T * 20)
NAMED = {"time_ms": T * 1e3, "voltage_V": V, "displacement_um": Y * 1e6}
TABLE = np.array([T, V, Y * 1e6])
AXES = "time=1:s, voltage=2:V, displacement=3:um"
SECONDS, KILOBYTES = 3.0, 400_000


def assert_refused(path, change, columns=None):
    """Refuse a file quickly, and before memory is taken; `change`: what the user may change."""
    began, peak = clock.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(FileFormatError) as caught:
        read(path, columns)
    assert caught.value.change == change
    assert path.name in str(caught.value)
    assert clock.process_time() - began < SECONDS
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < KILOBYTES
    return str(caught.value)


def hdf5(datasets, attributes=(), **options):
    """Datasets by name, and attributes by the name of an item, a dot and their own."""

    def write(path):
        with h5py.File(path, "w", **options) as file:
            for name, values in datasets.items():
                file[name] = values
            for name, value in dict(attributes).items():
                item, _, key = name.partition(".")
                file[item].attrs[key] = value
        if options:
            with path.open("r+b") as stream:
                stream.write(b"MATLAB 7.3 MAT-file, HDF5".ljust(124) + b"\x00\x02IM")

    return write


matlab73 = partial(hdf5, userblock_size=512)


def matlab(variables, opaque=False, **options):
    """A MAT file; `opaque`: with an instance of a class behind its variables, as MATLAB writes strings and tables."""

    def write(path):
        scipy.io.savemat(path, variables, **options)
        if opaque:
            numbers = struct.pack("<12I", 6, 8, 13, 0, 5, 8, 1, 1, 1, 0, 6, 4) + bytes(8)
            words = b"\x01\0\3\0obj\0" + b"\x01\0\4\0MCOS" + struct.pack("<II8s", 1, 6, b"string")
            element = struct.pack("<4I", 6, 8, 17, 0) + words + struct.pack("<II", 14, len(numbers)) + numbers
            with path.open("ab") as stream:
                stream.write(struct.pack("<II", 14, len(element)) + element)

    return write


def tdms(*segments, **properties):
    """Segments of channels by name, with the start of each [s] or None, and further properties of all."""

    def write(path):
        with nptdms.TdmsWriter(path) as writer:
            for channels, start in segments:
                have = dict(properties)
                if start is not None:
                    have["wf_start_time"] = np.datetime64("2024-05-01", "us") + np.timedelta64(round(start * 1e6), "us")
                writer.write_segment([nptdms.ChannelObject("g", name, x, have) for name, x in channels.items()])

    return write


def structured(columns=NAMED):
    return np.rec.fromarrays([*columns.values()], names=[*columns])


def halves(*starts):
    parts = zip((slice(0, N // 2), slice(N // 2, N)), starts, strict=True)
    return [({"voltage_V": V[part], "displacement_um": Y[part] * 1e6}, start) for part, start in parts]


WAVE = {"wf_increment": 0.01, "wf_start_offset": 0.0}
PIECES = {**WAVE, "wf_samples": N // 2}
# netCDF packs numbers, and has a dimension without coordinates as zeros.
PACKED = {
    "time": np.round(T * 100).astype("i8"),
    "voltage": np.round(V * 300).astype("i2"),
    "displacement": np.round(Y * 1e9).astype("i2"),
    "t": np.zeros(N, "f4"),
}
ATTRIBUTES = {
    "time.units": "seconds since 2024-05-01 12:00:00",
    "time.scale_factor": 0.01,
    "voltage.units": "V",
    "voltage.scale_factor": np.array([1 / 300]),
    "voltage._FillValue": np.array([-1], "i2"),
    "displacement.units": b"um",
    "displacement.scale_factor": 1e-3,
    "displacement.missing_value": -2e4,
    "t.NAME": np.bytes_("This is a netCDF dimension but not a netCDF variable.        60"),
}


def linked(path):
    """Links that go in circles, and one that leads out of the file and is not needed."""
    hdf5({f"run/{name}": values for name, values in NAMED.items()})(path)
    with h5py.File(path, "a") as file:
        file["run/up"] = file["/"]
        file["loop"] = h5py.SoftLink("/loop")
        file["twice"] = file["run/time_ms"]
        file["old/displacement_um"] = h5py.ExternalLink("other.h5", "x")


READ = {
    "a.mat": matlab({**NAMED, "note": "text", "image": np.eye(3)}),
    "old.mat": matlab(NAMED, format="4"),
    "beside.mat": matlab({**NAMED, "cell": np.array(["a", 1], dtype=object)}, opaque=True, do_compression=True),
    "new.mat": matlab73(
        {**{k: x[None] for k, x in NAMED.items()}, "#refs#/time_s": T, "voltage": V[:5], "time": T, "y_um": T[:2]},
        {"voltage.MATLAB_class": b"char", "time.MATLAB_object_decode": 3, "y_um.MATLAB_empty": 1},
    ),
    "a.h5": hdf5({f"run/{name}": values for name, values in NAMED.items()}),
    "a.hdf5": hdf5({"x": structured()}),
    "unknown.h5": hdf5(NAMED, {f"{name}.unit": "volts" for name in NAMED}),
    "packed.h5": hdf5(PACKED, ATTRIBUTES),
    "shifted.h5": hdf5(
        {**PACKED, "displacement": PACKED["displacement"] + np.int16(500)},
        {**ATTRIBUTES, "displacement.add_offset": -0.5},
    ),
    "linked.h5": linked,
    "a.tdms": tdms((NAMED, None)),
    "wave.tdms": tdms((dict([*NAMED.items()][1:]), None), **WAVE),
    "on.tdms": tdms(*halves(0, 0.30002), **PIECES),
    "fields.npz": lambda path: np.savez(path, x=structured()),
    "a.npy": lambda path: np.save(path, structured()),
}


@pytest.mark.parametrize("name", READ)
def test_binary_files_are_read(name, tmp_path):
    path = tmp_path / name
    READ[name](path)
    record = read(path)
    assert record.time == pytest.approx(T, abs=1e-9)
    assert record.voltage == pytest.approx(V, abs=2e-3)
    assert record.displacement == pytest.approx(Y, abs=1e-9)
    assert record.meta["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (record.name, record.meta["source"], "guesses" in record.meta) == (path.stem, name, False)


@pytest.mark.parametrize(
    ("name", "write"),
    {
        "rows.npy": lambda path: np.save(path, TABLE),
        "columns.npy": lambda path: np.save(path, TABLE.T),
        "a.npz": lambda path: np.savez(path, TABLE, image=np.eye(4), note=np.array("x")),
        "rows.mat": matlab({"data": TABLE}),
        "columns.mat": matlab({"data": TABLE.T, "n": 3.0}, do_compression=True),
        "struct.mat": matlab({"run": {"data": TABLE}}),
        "new.mat": matlab73({"data": TABLE}),
        "a.h5": hdf5({"run/data": TABLE.T}),
    }.items(),
)
def test_the_one_matrix_of_a_file_is_split(name, write, tmp_path):
    write(tmp_path / name)
    columns = read_table(tmp_path / name).columns
    assert [column.name for column in columns] == ["1", "2", "3"]
    assert all(column.unnamed for column in columns)
    assert np.array_equal(read(tmp_path / name, AXES).voltage, V)


def test_a_matrix_beside_a_series_of_its_length_is_split(tmp_path):
    for name, other, split in (("a.mat", T, True), ("b.mat", T[:-1], False)):
        scipy.io.savemat(tmp_path / name, {"t": other, "data": TABLE[1:].T})
        assert set(read_table(tmp_path / name).names) == {"t", *["data/1", "data/2"] * split}


def test_missing_numbers_are_refused_with_their_row(tmp_path):
    gone = PACKED["voltage"].copy()
    gone[7] = -1
    hdf5({**PACKED, "voltage": gone}, ATTRIBUTES)(tmp_path / "a.h5")
    assert np.flatnonzero(np.isnan(read_table(tmp_path / "a.h5").column("voltage"))).tolist() == [7]
    with pytest.raises(RecordError, match=r"voltage\[7\]"):
        read(tmp_path / "a.h5")


def test_pieces_without_times_of_their_own_are_a_guess(tmp_path):
    for name, starts in (("none", (None, None)), ("same", (0, 0))):
        tdms(*halves(*starts), **PIECES)(tmp_path / f"{name}.tdms")
        assert read(tmp_path / f"{name}.tdms").meta["guesses"].keys() == {"time"}


def elsewhere(kind, name="displacement_um"):
    """A file whose displacement is another file's bytes."""

    def write(path):
        secret = path.with_name("secret.h5")
        hdf5({"x": Y * 1e6})(secret)
        (matlab73 if path.suffix == ".mat" else hdf5)({"time_ms": T * 1e3, "voltage_V": V})(path)
        with h5py.File(path, "a") as file:
            if kind == "storage":
                file.create_dataset(name, shape=(N,), dtype="<f8", external=[(str(secret), 0, N * 8)])
            else:
                layout = h5py.VirtualLayout(shape=(N,), dtype="f8")
                layout[:] = h5py.VirtualSource(str(secret), "x", shape=(N,))
                file.create_virtual_dataset(name, layout)

    return write


@pytest.mark.parametrize(
    ("name", "write"),
    {
        **{f"{kind}{suffix}": elsewhere(kind) for kind in ("storage", "virtual") for suffix in (".h5", ".mat")},
        "objects.npz": lambda path: np.savez(path, **NAMED | {"displacement_um": np.array([{}] * N)}),
        "cell.mat": matlab(NAMED | {"displacement_um": np.array([Y, V], dtype=object)}),
        "object.mat": matlab73(NAMED | {"displacement_um": T}, {"displacement_um.MATLAB_object_decode": 3}),
    }.items(),
)
def test_unreadable_columns_state_their_fault(name, write, tmp_path):
    write(tmp_path / name)
    (faulty,) = (column for column in read_table(tmp_path / name).columns if column.fault)
    assert (faulty.leaf, faulty.data.size) == ("displacement_um", 0)
    assert_refused(tmp_path / name, ())
    assert_refused(tmp_path / name, (), f"displacement={faulty.name}")


def test_units_come_from_names_and_attributes(tmp_path):
    columns = {"time": "", "voltage_mV": "mV", "y": "nm", "z": "mm", "w": "um"}
    values = {f"run/{name}": np.arange(3.0) for name in columns}
    hdf5(values, {"run.unit": "nm", "run/z.unit": "mm", "run/w.units": np.bytes_("um")})(tmp_path / "a.h5")
    assert {column.leaf: column.parts[1] for column in read_table(tmp_path / "a.h5").columns} == columns
    tdms(({"y": Y}, None), unit_string="Millimeters")(tmp_path / "a.tdms")
    assert read_table(tmp_path / "a.tdms").column("displacement") == pytest.approx(Y * 1e-3)


LIBRARIES = {"a.h5": "h5py", "new.mat": "h5py", "a.mat": "scipy.io", "a.tdms": "nptdms"}


@pytest.mark.parametrize(("name", "module"), LIBRARIES.items())
def test_a_missing_library_is_named(name, module, tmp_path, monkeypatch):
    READ[name](tmp_path / name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"{module.partition('.')[0]}.*dehyst\[files\]"):
        read(tmp_path / name)


def test_text_needs_no_library(tmp_path, monkeypatch):
    for module in {*LIBRARIES.values()}:
        monkeypatch.setitem(sys.modules, module, None)
    write_columns(tmp_path / "a.csv", NAMED)
    assert np.array_equal(read(tmp_path / "a.csv").voltage, V)


# Sizes

MANY = 10**9


def npy_header(stream, count):
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": (count,)})


def npy_bomb(path):
    with path.open("wb") as stream:
        npy_header(stream, MANY)


def npz_bomb(count, zeros):
    def write(path):
        with zipfile.ZipFile(path, "w", 8, compresslevel=1) as archive, archive.open("time_s.npy", "w") as stream:
            npy_header(stream, count)
            for _ in range(zeros):
                stream.write(bytes(8_000_000))

    return write


def with_cells(rows, old, new):
    """A workbook with a text of its sheet replaced."""

    def write(path):
        laboratory_files.write_xlsx(path, rows)
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, part in parts.items():
                archive.writestr(name, part.replace(old, new) if "sheet1" in name else part)

    return write


def hdf5_bomb(**options):
    def write(path):
        with h5py.File(path, "w") as file:
            file.create_dataset("time_s", dtype="f8", fillvalue=1.0, **options)

    return write


def mat_dimensions(path):
    scipy.io.savemat(path, {"time_s": T})
    path.write_bytes(path.read_bytes().replace(N.to_bytes(4, "little"), MANY.to_bytes(4, "little"), 1))


@pytest.mark.parametrize(
    ("name", "write"),
    {
        "bomb.npz": npz_bomb(70_000_000, 70),
        "wide.xlsx": with_cells([[1.0]] * 2000, b"<row><c>", b'<row><c r="NTP1">'),
        "rows.xlsx": with_cells([[1.0], [2.0], [3.0]], b"<row><c><v>3", b'<row r="1000000000"><c><v>3'),
        "fill.h5": hdf5_bomb(shape=(MANY,), chunks=(1 << 20,)),
        "chunk.h5": hdf5_bomb(shape=(N,), maxshape=(None,), chunks=(1 << 28,)),
        "lines.csv": lambda path: path.write_bytes(b"t" + b",x" * 9_000 + b"\n" * 10_000),
    }.items(),
)
def test_declared_sizes_are_checked_first(name, write, tmp_path):
    write(tmp_path / name)
    assert_refused(tmp_path / name, ())


def written(text):
    return lambda path: path.write_text(text)


LONG, STRANGE = "is longer than 1000000 characters", "is a device, a pipe or a socket"


@pytest.mark.parametrize(
    ("name", "write", "words"),
    [
        ("name.csv", written("time_s," + "x" * 2_000_000 + "\n1,2\n"), LONG),
        ("number.csv", written("time_s,voltage_V\n" + "1" * 3_000_000), LONG),
        ("quotes.csv", written('"' * 2_000_000 + "\n1,2\n"), LONG),
        ("comment.csv", written("#" * 5_000_000), LONG),
        *((f"{device}.csv", partial(os.symlink, f"/dev/{device}"), STRANGE) for device in ("zero", "null", "random")),
        ("pipe.csv", os.mkfifo, STRANGE),
        # Numbers that only Python writes.
        *(
            (
                f"{ord(cell[0])}.csv",
                written(f"time_s,voltage_V\n0,{cell}\n1,3\n"),
                f"row 2 holds '{cell}', which is no n",
            )
            for cell in ("5_0", "\u0665\u0660", "\u22125")
        ),
        ("object.mat", matlab({"note": "x"}, opaque=True), "MATLAB object"),
        ("object73.mat", matlab73({"a": T}, {"a.MATLAB_object_decode": 3}), "MATLAB object"),
        ("cell.mat", matlab({"a": np.array([T, 1], dtype=object)}), "cell array"),
        ("objects.npy", lambda path: np.save(path, np.array([{}, {}], dtype=object)), "Python objects"),
        ("square.npy", lambda path: np.save(path, np.eye(4)), "numeric columns"),
        ("header.npy", npy_bomb, "cannot be read"),
        ("header.npz", npz_bomb(MANY, 0), "cannot be read"),
        ("dimensions.mat", mat_dimensions, "cannot be read"),
        ("pause.tdms", tdms(*halves(0, 47.3), **PIECES), "47 s after"),
        ("back.tdms", tdms(*halves(0, 0.1), **PIECES), "0.2 s before"),
    ],
)
def test_unreadable_files_are_refused(name, write, words, tmp_path):
    write(tmp_path / name)
    assert words in assert_refused(tmp_path / name, ())
