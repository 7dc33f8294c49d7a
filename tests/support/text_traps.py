"""Text files of laboratories that are easily misread, each with a harmless twin that must be read."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from pathlib import Path
from typing import NamedTuple

import numpy as np
from laboratory_files import UM, N, T, V, rows, write_xlsx

HEAD = "time_s,voltage_V,displacement_um"
RATE = "rate=500"
# White noise of a sensor [um], and the times [s] at which it is sampled: 3.6 for each sample of the voltage.
NOISE = 0.006
FAST = np.arange(0, 2.39, 1 / 1777)
NOISY = np.interp(FAST, T, UM) + NOISE * np.random.default_rng(3).standard_normal(FAST.size)


class Trap(NamedTuple):
    """A file that is easily misread; `twin`: a harmless file that looks alike; and what a user knows of both."""

    trap: Callable[[Path], None]
    twin: Callable[[Path], None]
    options: str = ""
    suffix: str = ".csv"


def point(values: np.ndarray, digits: int) -> list[str]:
    return [f"{value:.{digits}f}" for value in values]


def comma(values: np.ndarray, digits: int) -> list[str]:
    return [text.replace(".", ",") for text in point(values, digits)]


def table(
    sign: str, head: str, *columns: Iterable[str], cut: int = 0, encoding: str = "utf-8"
) -> Callable[[Path], None]:
    """A writer of a table; `cut`: number of bytes that are missing at the end."""

    def write(path: Path) -> None:
        lines = [head.replace(",", sign), *(sign.join(cells) for cells in zip(*columns, strict=True))]
        data = ("\n".join(lines) + "\n").encode(encoding)
        path.write_bytes(data[: len(data) - cut])

    return write


def with_lines(head: str, body: str, lines: dict[int, str], lost: bool = False) -> Callable[[Path], None]:
    """A writer of a table with more `lines`, each before its number, or if `lost` in its place; the header is 1."""

    def write(path: Path) -> None:
        text = [head, *body.strip().split("\n")]
        for number, line in sorted(lines.items(), reverse=True):
            text[number - 1 : number - 1 + lost] = [line]
        path.write_text("\n".join(text) + "\n")

    return write


def sheet(table: Iterable[Iterable[object]]) -> Callable[[Path], None]:
    return lambda path: write_xlsx(path, table)


def both(first: Callable[[Path], None], second: Callable[[Path], None]) -> Callable[[Path], None]:
    """A writer of a file and of `second.csv` beside it, which is joined to it."""

    def write(path: Path) -> None:
        first(path)
        second(path.with_name("second.csv"))

    return write


def stamps(times: np.ndarray, day: str = "2026-03-04T12:00:00", form: str = "%Y-%m-%dT%H:%M:%S.%f") -> list[str]:
    first = datetime.fromisoformat(day)
    return [(first + timedelta(microseconds=round(time * 1e6))).strftime(form) for time in times]


def channel(times: Iterable[str], name: str, values: np.ndarray, clock: str = "timestamp") -> Callable[[Path], None]:
    return table(",", f"{clock},{name}", times, point(values, 6))


def drive(times: Iterable[str], clock: str = "timestamp") -> Callable[[Path], None]:
    return channel(times, "voltage_V", V, clock)


def sensor(times: Iterable[str], clock: str = "timestamp") -> Callable[[Path], None]:
    return channel(times, "displacement_um", UM, clock)


NM = 1e3 * UM
SECONDS, VOLTS, MICROMETRES = point(T, 3), point(V, 4), point(UM, 5)
BODY, PAIRS = rows(T, V, UM), rows(V, UM)
JOIN = "join=second.csv"
SEVENTH, PAIRED = range(9, N - 3, 7), list(enumerate(np.c_[V, UM].tolist()))
LATE, HOLE, FEW, THIRD = T >= 0.1, (T < 0.5) | (T > 2.0), np.arange(N) % 100 == 0, np.arange(N) % 3 == 0
TIMES_NM = "time_s,voltage_V,displacement_nm"
DAY_FIRST = "%d/%m/%Y %H:%M:%S.%f"
# From the middle on, the clock is an hour ahead, as in summer time.
SUMMER = [text if k < 600 else text.replace("T12", "T13") for k, text in enumerate(stamps(T))]

TRAPS: dict[str, Trap] = {
    "thousands as text in a workbook": Trap(
        sheet(
            [TIMES_NM.split(","), *zip(T.tolist(), V.tolist(), [f"{value:,.0f}" for value in NM + 1e4], strict=True)]
        ),
        sheet([HEAD.split(","), *np.c_[T, V, UM].tolist()]),
        suffix=".xlsx",
    ),
    "a row of units against the names": Trap(
        with_lines(HEAD, BODY, {2: "ms,mV,nm"}), with_lines(HEAD, BODY, {2: "Seconds,V,µm"})
    ),
    "no value in the first column": Trap(
        with_lines(HEAD, BODY, {700: "#N/A,1,2"}, lost=True), with_lines(HEAD, BODY, {700: "# a pause, then on"})
    ),
    "no value in the first row": Trap(
        with_lines(HEAD, BODY, {2: "#DIV/0!,#DIV/0!,#DIV/0!"}, lost=True), with_lines(HEAD, BODY, {2: "# s,V,um"})
    ),
    "no value in every seventh row": Trap(
        with_lines("displacement_um,voltage_V", rows(UM, V), dict.fromkeys(SEVENTH, "#N/A,1"), lost=True),
        with_lines("displacement_um,voltage_V", rows(UM, V), dict.fromkeys(SEVENTH, "# pause,")),
        RATE,
    ),
    "rows behind a percent sign": Trap(
        with_lines("displacement_um,voltage_V", rows(UM, V), dict.fromkeys(SEVENTH, "%,1"), lost=True),
        with_lines("% made, by, a rig", f"voltage_V,displacement_um\n{PAIRS}", {40: "% half of it"}),
        RATE,
    ),
    "empty rows": Trap(
        with_lines("voltage_V,displacement_um", PAIRS, dict.fromkeys(SEVENTH, ","), lost=True),
        with_lines("voltage_V,displacement_um", PAIRS, {2: ",", N + 2: ",", N + 3: ","}),
        RATE,
    ),
    "empty lines in single columns": Trap(
        both(
            with_lines("voltage_V", rows(V), dict.fromkeys(SEVENTH, ""), lost=True),
            with_lines("displacement_um", rows(UM), {k + 3: "" for k in SEVENTH}, lost=True),
        ),
        both(with_lines("voltage_V", rows(V), {N + 2: ""}), with_lines("displacement_um", rows(UM), {})),
        f"{JOIN}, {RATE}",
    ),
    "empty rows of a workbook": Trap(
        sheet([["voltage_V", "displacement_um"], *(["", ""] if k % 7 == 6 else [*row] for k, row in PAIRED)]),
        sheet([["run 7"], [], ["voltage_V", "displacement_um"], *np.c_[V, UM].tolist(), ["", ""]]),
        RATE,
        ".xlsx",
    ),
    "timestamps of which one file starts later": Trap(
        both(drive(stamps(T)), channel(stamps(T[LATE]), "displacement_um", UM[LATE])),
        both(drive(SECONDS, "time_s"), channel(point(1e3 * FAST, 6), "displacement_um", NOISY, "time_ms")),
        JOIN,
    ),
    "timestamps two hours apart": Trap(
        both(drive([f"{text}Z" for text in stamps(T)]), sensor([f"{text}+02:00" for text in stamps(T)])),
        both(
            drive([f"{text}Z" for text in stamps(T)]),
            sensor([f"{text}+02:00" for text in stamps(T, "2026-03-04T14:00:00")]),
        ),
        JOIN,
    ),
    "timestamps in one of two files": Trap(
        both(drive(stamps(T)), channel(point(T[LATE] - 0.1, 3), "displacement_um", UM[LATE], "time_s")),
        both(drive(stamps(T, form="%H:%M:%S.%f")), sensor(stamps(T, form="%H:%M:%S.%f"))),
        JOIN,
    ),
    "a gap of the second file": Trap(
        both(sensor(SECONDS, "time_s"), channel(point(T[HOLE], 3), "voltage_V", V[HOLE], "time_s")),
        both(drive(SECONDS, "time_s"), channel(point(T[HOLE], 3), "displacement_um", UM[HOLE], "time_s")),
        JOIN,
    ),
    "a second file of few samples": Trap(
        both(sensor(SECONDS, "time_s"), channel(point(T[FEW], 3), "voltage_V", V[FEW], "time_s")),
        both(sensor(SECONDS, "time_s"), channel(point(T[THIRD], 3), "voltage_V", V[THIRD], "time_s")),
        JOIN,
    ),
    "days and months": Trap(
        table(",", HEAD, stamps(T, "2026-03-04T23:59:59", DAY_FIRST), VOLTS, MICROMETRES),
        table(",", HEAD, stamps(T, "2026-03-04T23:59:59"), VOLTS, MICROMETRES),
    ),
    "an hour of summer time": Trap(
        table(",", HEAD, SUMMER, VOLTS, MICROMETRES),
        table(",", HEAD, [f"{text}+0{1 + (k >= 600)}:00" for k, text in enumerate(SUMMER)], VOLTS, MICROMETRES),
    ),
    "UTF-16 without its mark, cut off": Trap(
        table("\t", HEAD, SECONDS, VOLTS, MICROMETRES, cut=3, encoding="utf-16-le"),
        table("\t", HEAD, SECONDS, VOLTS, MICROMETRES, encoding="utf-16"),
    ),
}
