"""Files that are easily misread, each with a harmless twin: containers, clocks, units and gains of instruments."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import openpyxl
from laboratory_files import FILES, UM, N, T, V, Writer, Y, matlab, table

# A small actuator: its stroke in nm is the same number as the stroke of a large actuator in um.
NM = UM * 25
SECONDS = "time_s,voltage_V,displacement_um"


def xlsx(dimension: str, *first: list[object]) -> Writer:
    """A workbook whose last sheet declares a range, or none; the sheet before it has the rows `first`."""

    def write(path: Path) -> None:
        book = openpyxl.Workbook()
        sheets = [book.active, book.create_sheet()] if first else [book.active]
        for row in first:
            sheets[0].append(row)
        for row in [SECONDS.split(","), *np.c_[T, V, UM].tolist()]:
            sheets[-1].append(row)
        book.save(path)
        with zipfile.ZipFile(path) as archive:
            parts = {name: archive.read(name) for name in archive.namelist()}
        last = f"xl/worksheets/sheet{len(sheets)}.xml"
        declared = f'<dimension ref="{dimension}"/>' if dimension else ""
        parts[last], count = re.subn(rb"<dimension [^>]*/>", declared.encode(), parts[last])
        assert count == 1
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, part in parts.items():
                archive.writestr(name, part)

    return write


def hdf5(groups: dict[str, str], **datasets: tuple[np.ndarray, str]) -> Writer:
    """Datasets by name ("__" for a slash), each with a unit or none; and the units of groups."""

    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, (values, unit) in datasets.items():
                kept = file.create_dataset(name.replace("__", "/"), data=values)
                if unit:
                    kept.attrs["unit"] = unit
            for name, unit in groups.items():
                file[name].attrs["unit"] = unit

    return write


def tdms(*offsets: float) -> Writer:
    def write(path: Path) -> None:
        units: list[dict[str, Any]] = [{"unit_string": "Volts"}, {"unit_string": "Meters"}]
        channels = [
            nptdms.ChannelObject("g", name, values, {"wf_increment": 0.002, "wf_start_offset": offset} | unit)
            for name, values, offset, unit in zip(("Voltage", "Position"), (V, Y), offsets, units, strict=True)
        ]
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment(channels)

    return write


INDEX = np.arange(float(N))
OLD_RUN = [SECONDS.split(","), *np.c_[T, V, UM][: N // 2].tolist()]
INDEXED = "Index,Drive (V),Pos (um)"

# Files that are misread, each beside a twin with all statements that the reader needs; what a user knows of the twin.
PAIRS: dict[str, tuple[Writer, Writer, str]] = {
    "rows.xlsx": (xlsx("A1:C1100"), xlsx("A1:C1201"), ""),
    "cell.xlsx": (xlsx("A1:C1", *OLD_RUN), xlsx("", ["Stage 7, 1 May"]), ""),
    "index.csv": (table(INDEXED, INDEX, V, UM), table(f"Index,{SECONDS}", INDEX, T, V, UM), ""),
    "scope.csv": (
        table(f"Type,raw\nPoints,1200\nXInc,0.002\n\n{INDEXED}", INDEX, V, UM),
        table(f"Type,raw\nPoints,1200\nXInc,0.002,s\n\n{SECONDS}", T, V, UM),
        "",
    ),
    "rate.csv": (
        table("Sampling Rate: 500 Hz\nSample,Drive (V),Pos (um)", INDEX, V, UM),
        table("Sampling Rate: 500 Hz\ntime_ms,voltage_V,displacement_um", T * 1e3, V, UM),
        "",
    ),
    "two.csv": (
        table(f"XInc,0.002,s\nXInc,0.004,s\n{INDEXED}", INDEX, V, UM),
        table("XInc,0.002,s\nXIncrement = 2 ms\nIndex,drive_V,y_um", INDEX, V, UM),
        "",
    ),
    "group.h5": (
        hdf5({"x": "nm"}, time=(T, "s"), voltage=(V, "V"), x__position=(NM, "")),
        hdf5({"x": "um"}, time=(T, "s"), voltage=(V, "V"), x__position=(Y * 1e9, "nm")),
        "",
    ),
    "clock.h5": (
        hdf5({"clock": "ms"}, clock__time=(T * 1e3, ""), drive__voltage=(V, "V"), sensor__position=(UM, "um")),
        hdf5({"run": "V"}, run__time_ms=(T * 1e3, ""), run__voltage=(V, ""), run__y_um=(UM, "")),
        "",
    ),
    "late.tdms": (tdms(0.0, 0.1), tdms(0.5, 0.5), ""),
    "order.npy": (
        lambda path: np.save(path, np.array([T, UM, V])),
        lambda path: np.save(path, np.rec.fromarrays([T, V, UM], names=SECONDS)),
        "",
    ),
    "regler.csv": (
        table("Zeit [ms];Ausgang Regler [mV];Weg [um]", T * 1e3, V * 66.7, UM, sign=";"),
        table("Zeit [ms];Ausgang Regler [V];Weg [um]", T * 1e3, V, UM, sign=";"),
        "voltage=Ausgang Regler [V]",
    ),
    "ao.h5": (*[hdf5({}, time=(T, "s"), AO0=(V / 20, "V"), position=(UM, "um"))] * 2, "voltage=AO0*20"),
    "small.mat": (
        matlab(data={"time_s": T, "voltage_V": V, "pos": NM}),
        matlab(data={"time_s": T, "voltage_V": V, "pos_um": UM}),
        "",
    ),
    "metres.csv": (
        table("time_s,voltage_V,displacement_m", T, V, UM),
        table("time_s,voltage_V,displacement_m", T, V, Y, number="%.15g"),
        "",
    ),
}
# Formats that no instrument writes.
PLAIN: dict[str, Writer] = {
    "tabs.tsv": table(SECONDS.replace(",", "\t"), T, V, UM, sign="\t"),
    "spaces.dat": table(SECONDS.replace(",", " "), T, V, UM, sign=" "),
    "utf16.txt": table(SECONDS, T, V, UM, encoding="utf-16"),
}


def write_sound(folder: Path) -> None:
    """Write files of each suffix; most of them have all statements that the reader needs."""
    np.savez_compressed(folder / "packed.npz", time_s=T, voltage_V=V, displacement_um=UM)
    with h5py.File(folder / "packed.hdf5", "w", libver="latest") as file:
        more: list[dict[str, Any]] = [{"compression": "gzip", "shuffle": True}, {"fletcher32": True}, {}]
        for name, values, options in zip(SECONDS.split(","), (T, V, UM), more, strict=True):
            file.create_dataset(name, data=values, chunks=(50,), **options)
    twins = {name: (twin, words) for name, (_, twin, words) in PAIRS.items()}
    for name, (write, words) in {**FILES, **twins}.items():
        if not words:
            write(folder / name)
    for name, write in PLAIN.items():
        write(folder / name)
