"""Files of one measurement as instruments, programs and people in laboratories write them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import nptdms
import numpy as np
import openpyxl
import pytest
import scipy.io

from dehyst.records import Record

RATE = 500.0
N = 1200
T = np.arange(N) / RATE
# Two cycles to 100 V, and two to 60 V.
V = np.where(T[N // 2] > T, 50.0, 30.0) * (1 - np.cos(2 * np.pi * T / 0.6))


def _loop() -> np.ndarray:
    """The displacement [m] of a play operator and a spring; 12 um of stroke."""
    play, now = np.empty(N), 0.0
    for k, v in enumerate(V):
        now = min(max(now, v - 8.0), v + 8.0)
        play[k] = now
    return 1.2e-5 * (0.6 * V + 0.4 * play) / 100


Y = _loop()
UM = Y * 1e6


def rows(*columns: np.ndarray, sign: str = ",", number: str = "%.9g") -> str:
    return "".join(sign.join(number % cell for cell in row) + "\n" for row in zip(*columns, strict=True))


def text(folder: Path, content: str, name: str = "a.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(content.encode(encoding))
    return path


Writer = Callable[[Path], None]


def table(
    head: str, *columns: np.ndarray, sign: str = ",", number: str = "%.9g", encoding: str = "utf-8", comma: bool = False
) -> Writer:
    """A writer of a table below the lines `head`, if any; `comma`: the decimal sign."""

    def write(path: Path) -> None:
        body = rows(*columns, sign=sign, number=number)
        lines = f"{head}\n" * bool(head) + (body.replace(".", ",") if comma else body)
        path.write_bytes(lines.encode(encoding))

    return write


def assert_measured(record: Record) -> None:
    """Assert that a record is T, V and Y; its first time may be any."""
    assert record.time - record.time[0] == pytest.approx(T, abs=1e-9)
    assert record.voltage == pytest.approx(V, abs=1e-4)
    assert record.displacement == pytest.approx(Y, abs=1e-11)


def tektronix_channels(path: Path) -> None:
    """One file for each channel, with the header beside the first rows."""
    for file, source, values in ((path, "CH1", V / 100), (path.with_name("F0001CH2.CSV"), "CH2", UM / 10)):
        head = f"Record Length,1.2e+03,|Sample Interval,2e-03,|Trigger Point,0,||,,|,,|Source,{source},|"
        head += "Vertical Units,V,|Vertical Scale,2.0e-01,|Vertical Offset,0.0,|"
        head += "Horizontal Units,s,|Horizontal Scale,2.4e-01,|"
        cells = [*head.replace("||", "|").split("|"), *[",,"] * N]
        file.write_text("".join(f"{c or ',,'},{t:.6f},{v:.8f},\n" for c, t, v in zip(cells, T, values, strict=False)))


def rigol(path: Path) -> None:
    body = "".join(f"{k},{v:.6e},{y:.6e},,\n" for k, (v, y) in enumerate(zip(V / 100, UM / 10, strict=True)))
    path.write_text("X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,0.000000e+00,2.000000e-03\n" + body)


def gcs(path: Path) -> None:
    head = {"TYPE": 1, "SEPARATOR": 32, "DIM": 2, "SAMPLE_TIME": "0.00200", "NDATA": N}
    head |= {"NAME0": "Current Position of axis 1", "NAME1": "Control Voltage of output chan 1"}
    lines = ["# REM created by PIMikroMove", "# VERSION = 1", "#", *(f"# {k} = {v}" for k, v in head.items()), "#"]
    path.write_text("\n".join([*lines, "# END_HEADER", rows(UM, V, sign=" ", number="%.6f")]))


def iso(path: Path) -> None:
    stamps = [f"2024-05-01T23:59:59.{k:03d}" for k in range(0, 1000, 2)]
    stamps += [f"2024-05-02T00:00:{k // 500:02d}.{2 * (k % 500):03d}" for k in range(N - 500)]
    lines = [f"{stamp},{v:.9g},{y:.9g}" for stamp, v, y in zip(stamps, V, UM, strict=True)]
    path.write_text("timestamp,voltage (V),position (um)\n" + "\n".join(lines))


def tdms(path: Path) -> None:
    step = {"wf_increment": 1 / RATE}
    channels = [
        nptdms.ChannelObject("Untitled", "Voltage_0", V, step | {"unit_string": "Volts"}),
        nptdms.ChannelObject("Untitled", "Position_0", Y, step | {"unit_string": "Meters"}),
    ]
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(channels)


def two_files(path: Path) -> None:
    table("time_s,voltage_V", T, V)(path)
    table("time_s,displacement_um", T, UM)(path.with_name("sensor.csv"))


def matlab(**variables: object) -> Writer:
    return lambda path: scipy.io.savemat(path, variables)


TEKTRONIX = """Model,MSO44\nFirmware Version,1.28.5

Waveform Type,ANALOG,,\nPoint Format,Y,,\nHorizontal Units,s,,\nHorizontal Scale,0.24,,\nSample Interval,0.002,,
Record Length,1200,,\nProbe Attenuation,1,1,\nVertical Units,V,V,\n\nLabel,drive,sensor,\nTIME,CH1,CH2"""
LECROY = """LECROYHDO4024,12345,Waveform\nSegments,1,SegmentSize,1200\nSegment,TrigTime,TimeSinceSegment1
#1,17-Apr-2015 12:03:02,0\nTime,Ampl,Pos_um"""
RUN = {"time_s": T.reshape(-1, 1), "voltage_V": V, "displacement_um": UM}
# Decimals of Germany, with semicolons.
GERMAN: dict[str, Any] = {"sign": ";", "comma": True}
lecroy = table(LECROY, T, V, UM)
headerless = table("", T, V, UM)
monitor = table("Zeit [ms];Monitor [mV];Sensor [V]", T * 1e3, V * 10, UM / 10, encoding="cp1252", **GERMAN)
GAINS = "voltage=*100, displacement=*10 um/V"

# For each file: its writer, and the options that a user knows before the first try.
FILES: dict[str, tuple[Writer, str]] = {
    "tek.csv": (table(TEKTRONIX, T, V / 100, UM / 10), GAINS),
    "F0000CH1.CSV": (tektronix_channels, f"join=F0001CH2.CSV, {GAINS}"),
    "keysight.csv": (table("x-axis,1,2\nsecond,Volt,Volt", T, V / 100, UM / 10, number="%+.9E"), GAINS),
    "rigol.csv": (rigol, GAINS),
    "pico.csv": (table("Time,Channel A,Channel B\n(ms),(V),(mV)\n", T * 1e3, V / 100, UM * 100, number="%.8f"), GAINS),
    "lecroy.csv": (lecroy, ""),
    "recorder.dat": (gcs, ""),
    "zeit.csv": (table("Zeit [s];Spannung [V];Weg [µm]\r", T, V, UM, encoding="cp1252", **GERMAN), ""),
    "messung.csv": (
        table(
            "Messung 12\nDatum;01.05.2024\n\nZeit in s;Ansteuerung in V;Kapazitiver Sensor in µm",
            *(T, V, UM),
            encoding="utf-8-sig",
            **GERMAN,
        ),
        "",
    ),
    "bare.csv": (headerless, ""),
    "savetxt.txt": (lambda path: np.savetxt(path, np.c_[T, V, UM], header="time_s voltage_V displacement_um"), ""),
    "iso.csv": (iso, ""),
    "letters.mat": (matlab(t=T, u=V, y=UM), ""),
    "struct.mat": (matlab(data={"t": T, "u": V, "y": UM, "info": {"who": "me", "gain": 3.0}}), ""),
    "packed.mat": (
        lambda path: scipy.io.savemat(path, {"run": {"first": RUN}, "image": np.eye(4)}, do_compression=True),
        "",
    ),
    "daq.tdms": (tdms, ""),
    "units.txt": (table("Time\tDrive\tDisplacement\ns\tV\tnm", T, V, Y * 1e9, sign="\t"), ""),
    "slashes.csv": (table("Time / ms,Voltage / V,Position / um", T * 1e3, V, UM), ""),
    "monitor.csv": (monitor, GAINS),
    "drive.csv": (two_files, "join=sensor.csv"),
    "untimed.csv": (table("voltage_V,displacement_um", V, UM), "rate=500"),
    "channels.csv": (
        table("t_s,CH1 (V),CH2 (V),gauge x (um),gauge y (um),T (C)", T, V, 0 * V, UM, 0 * V, 0 * V + 21),
        "voltage=CH1 (V), displacement=gauge x (um)",
    ),
}


def write_xlsx(path: Path, table: Iterable[Iterable[object]]) -> None:
    """Write a workbook of one sheet."""
    book = openpyxl.Workbook()
    for row in table:
        book.active.append([*row])
    book.save(path)
