"""Sound files of every format that dehyst reads, small, in the variants that instruments and programs write."""

from __future__ import annotations

import io
import os
from pathlib import Path

import h5py
import nptdms
import numpy as np
import openpyxl
import scipy.io

N = 240
T = np.arange(N) * 1e-3
V = 50.0 - 50.0 * np.cos(2 * np.pi * np.arange(N) / 80)
Y = 1e-7 * (V - 8.0 * np.sin(2 * np.pi * np.arange(N) / 80)) + 1e-10 * np.sin(np.arange(N) ** 2)
COLUMNS = {"time_s": T, "voltage_V": V, "displacement_um": Y * 1e6}


def _table(delimiter: str = ",", number: str = "%.9g", head: str = "", names: tuple[str, ...] = ()) -> str:
    rows = np.column_stack(list(COLUMNS.values()))
    body = "\n".join(delimiter.join(number % cell for cell in row) for row in rows)
    return f"{head}{delimiter.join(names or COLUMNS)}\n{body}\n"


def _texts() -> dict[str, bytes]:
    brackets = ("Time [ms]", "Drive (V)", "Position [µm]")
    quoted = _table().replace("time_s,voltage_V", '"time_s","voltage_V"')
    remarks = _table().replace("\n", ",ok\n").replace("um,ok", "um,remark", 1)
    return {
        "plain.csv": _table().encode(),
        "quoted.csv": quoted.encode(),
        "remarks.csv": remarks.encode(),
        "comments.csv": _table(head="# made by a rig\n% and more\n\n").replace("\n0.01,", "\n% half\n0.01,").encode(),
        "latin.csv": _table(names=brackets).encode("latin-1"),
        "tabs.tsv": _table("\t").encode("utf-8-sig"),
        "comma.txt": _table(";").replace(".", ",").encode(),
        "utf16.txt": _table("\t").encode("utf-16"),
        **_instruments(),
        "spaces.dat": _table(" ", "%.6e").replace("\n", "\r\n").encode(),
    }


def _instruments() -> dict[str, bytes]:
    """Text of instruments, cut to the size of the other specimens."""
    rows = _table().split("\n", 1)[1]
    gcs = "# SEPARATOR = 44\n# DIM = 3\n# SAMPLE_TIME = 0.001\n# NAME0 = clock\n# NAME1 = voltage_V\n# NAME2 = y_um\n"
    clock = "".join(
        f"2024-05-01T12:00:00.{k:03d},{row.split(',', 1)[1]}\n" for k, row in enumerate(rows.split("\n")[:-1])
    )
    return {
        "recorder.dat": f"{gcs}# END_HEADER\n{rows}".encode(),
        "scope.csv": f"Model,X\nInterval,0.001\n\nTime,Drive,Position\n(s),(V),(um)\n{rows}".encode(),
        "rigol.csv": b"X,Drive,Pos,Start,Increment,\nSequence,V,um,0,1e-3\n" + rows.replace("\n", ",,\n").encode(),
        "clock.csv": f"timestamp,voltage_V,displacement_um\n{clock}".encode(),
    }


def _hdf5(path: Path) -> None:
    with h5py.File(path / "grouped.h5", "w") as file:
        for name, values in COLUMNS.items():
            file[f"run/{name}"] = values.reshape(-1, 1) if name == "voltage_V" else values
        file["run/image"] = np.eye(5)
        file["link"] = h5py.SoftLink("/run")
        file["run"].attrs["about"] = "a rig"
    with h5py.File(path / "packed.hdf5", "w", libver="latest") as file:
        more = [{"compression": "gzip", "shuffle": True}, {"compression": "lzf"}, {"fletcher32": True}]
        for (name, values), options in zip(COLUMNS.items(), more, strict=True):
            kept = file.create_dataset(name.split("_")[0], data=values, chunks=(50,), maxshape=(None,), **options)
            kept.attrs["unit"] = name.split("_")[1]


def _mat(path: Path) -> None:
    beside = {"note": "text", "image": np.eye(3), "cell": np.array(["a", 1], dtype=object), "run": {"ticks": T}}
    scipy.io.savemat(path / "plain.mat", {**COLUMNS, **beside})
    scipy.io.savemat(path / "packed.mat", {**COLUMNS, **beside}, do_compression=True)
    scipy.io.savemat(path / "struct.mat", {"data": {"run": COLUMNS, "gain": 3.0}})
    scipy.io.savemat(path / "old.mat", COLUMNS, format="4")
    with h5py.File(path / "new.mat", "w", userblock_size=512) as file:
        for name, values in COLUMNS.items():
            file.create_dataset(name, data=values.reshape(1, -1), compression="gzip")
    with (path / "new.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, HDF5".ljust(124) + b"\x00\x02IM")


def _others(path: Path) -> None:
    np.savez(path / "plain.npz", **COLUMNS, note=np.array("x"), image=np.eye(3))
    np.savez(path / "rows.npz", np.array([*COLUMNS.values()]))
    np.save(path / "rows.npy", np.array([*COLUMNS.values()]).T)
    run = np.empty(N, dtype=[(name, "f8") for name in COLUMNS])
    for name, values in COLUMNS.items():
        run[name] = values
    np.save(path / "named.npy", run)
    book = openpyxl.Workbook()
    for row in [list(COLUMNS), *np.column_stack(list(COLUMNS.values())).tolist()]:
        book.active.append(row)
    book.save(path / "plain.xlsx")
    np.savez_compressed(path / "packed.npz", **{name: values.astype("f4") for name, values in COLUMNS.items()})
    with nptdms.TdmsWriter(path / "plain.tdms") as writer:
        for part in (slice(0, 100), slice(100, N)):
            writer.write_segment([nptdms.ChannelObject("run", name, values[part]) for name, values in COLUMNS.items()])
    with nptdms.TdmsWriter(path / "wave.tdms") as writer:
        step = {"wf_increment": 1e-3, "unit_string": "V"}
        channels = [nptdms.ChannelObject("g", "voltage", V, step)]
        channels.append(nptdms.ChannelObject("g", "displacement", Y * 1e6, step | {"unit_string": "um"}))
        channels.append(nptdms.ChannelObject("g", "note", ["a", "b"]))
        writer.write_segment(channels)


def specimens(folder: Path) -> dict[str, bytes]:
    """Name -> content; written into a folder first, as programs do."""
    for name, content in _texts().items():
        (folder / name).write_bytes(content)
    # By a child: threads that libraries start would not be there in workers forked later.
    child = os.fork()
    if not child:
        _hdf5(folder)
        _mat(folder)
        _others(folder)
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        raise RuntimeError("the child could not write the specimens")
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def npz_parts(content: bytes) -> dict[str, bytes]:
    """The members of an NPZ, for edits within."""
    import zipfile

    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}
