"""Put the figures of the benchmarks' JSON files into `docs/benchmarks.md`, between its markers.

With --check nothing is written; the exit status is 0 if the page contains them already.
"""

import json
import re
import sys
from pathlib import Path

from readme import fill
from strangers.command import table as strangers_table

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "benchmarks.md"


def accuracy(data: dict) -> list[str]:
    virtual, paper = data["virtual"], data["virtual"]["paper"]
    rows = [
        "| Largest error, in % of the stroke | linear feedforward | dehyst | the paper: linear, inverse control |",
        "| --- | --- | --- | --- |",
        f"| following a path with nine reversals, virtual actuator | {virtual['linear']['largest_percent']:.2f} "
        f"| **{virtual['compensated']['largest_percent']:.2f}** | {paper['linear_largest_percent']:.2f}, "
        f"{paper['compensated_largest_percent']:.2f} (their actuator, one raised cosine) |",
    ]
    if data["measured"]:
        rows += [
            "",
            "| Measured: a PICMA stack in a micromanipulator, 1 Hz | largest % | RMS % "
            "| with its drift: largest, RMS % |",
            "| --- | --- | --- | --- |",
        ]
        names = {
            "record": "trained on both",
            "held out": "trained on major and 4500 rows of ramps",
            "breakpoints": "the paper's method, both",
        }
        for key, what in names.items():
            for error in data["measured"][key]["errors"]:
                role = "" if error["role"] == "training" else " (validation)"
                rows.append(
                    f"| {error['record']}{role}, {what} | {error['largest_percent']:.2f} | {error['rms_percent']:.3f} "
                    f"| {error['largest_with_drift_percent']:.2f}, {error['rms_with_drift_percent']:.3f} |"
                )
    return rows


def paper(data: dict) -> list[str]:
    rows = [
        "",
        "| The paper's experiment on a virtual actuator, largest error in % of the range | paper "
        "| its method, N = 10 | whole record, the same loops | whole record, descending tops added "
        "| Goldfarb and Celanovic, relaxed |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for key, what in (("asymmetric", ""), ("symmetric", ", a loop of symmetric width")):
        for row in data[key]["summary"]:
            if row["unit"] == "%" and row["key"] != "nominal":
                cells = " | ".join(f"{row[name]:.2f}" for name in ("breakpoints", "record", "record_tops", "goldfarb"))
                rows.append(f"| {row['quantity']}{what} | {row['paper']:.2f} | {cells} |")
    nominal = next(row for row in data["asymmetric"]["summary"] if row["key"] == "nominal")
    rows.append(f"| Nominal ratio, no model | {nominal['paper']:.2f} | {nominal['actuator']:.2f} | | | |")
    return rows


def baselines(data: dict) -> list[str]:
    """Every model on every virtual actuator, the worst of its paths, and its prediction of the measured stage."""
    compared, truths = data["compared"], ("play", "creep", "preisach", "boucwen")
    asked = [pair(compared["asked"][one]) for one in (*truths, "measured")]
    rows = [
        "",
        "| Largest and RMS error, % of the stroke | plays, asymmetric | the same, creeping | Preisach "
        "| Bouc-Wen, resonating | measured, predicted |",
        "| --- | --- | --- | --- | --- | --- |",
        f"| asked of dehyst | {' | '.join(asked)} |",
    ]
    names = dict.fromkeys([*compared["tracking"]["play"], *compared["measured"]])
    for name in sorted(names, key=lambda name: not name.startswith("dehyst")):
        cells = [pair(worst(compared["tracking"][truth].get(name))) for truth in truths]
        errors = [
            one for one in compared["measured"].get(name, {"errors": ()})["errors"] if one["role"] == "validation"
        ]
        cells.append(pair(errors[0] if errors else None))
        shown = [f"**{cell}**" if name == "dehyst" else cell for cell in cells]
        rows.append(f"| {name.replace('told', 'given')} | {' | '.join(shown)} |")
    return rows


def worst(row: dict | None) -> dict | None:
    return max((row or {"tracking": {}})["tracking"].values(), key=lambda one: one["largest_percent"], default=None)


def pair(error: dict | None) -> str:
    return "-" if error is None else f"{error['largest_percent']:.2f}, {error['rms_percent']:.3f}"


def speed(data: dict) -> list[str]:
    rows = [
        "",
        "| Time a sample, in units of `numpy.interp` on the same array | N = 10 | N = 100 | N = 1000 |",
        "| --- | --- | --- | --- |",
    ]
    for path, what in (
        ("slow", "swept loops"),
        ("noisy", "the same, a reversal at every other sample"),
        ("random", "uniformly distributed samples"),
    ):
        rows += [f"| {job}, {what} | {ratios(data, path, job)} |" for job in ("compensate", "simulate")]
    for path, what in (("slow", "swept loops"), ("noisy", "the same, a reversal at every other sample")):
        for job in ("compensate", "simulate"):
            wider = ratios(data, path, f"{job} with transformer and 8 creep")
            rows.append(f"| {job} with a transformer and 8 branches of creep, {what} | {wider} |")
    return rows


def ratios(data: dict, path: str, job: str) -> str:
    return " | ".join(f"{data['paths'][path][f'{job} {n}']['ratio']:.2f}" for n in (10, 100, 1000))


def steps(latency: dict, size: dict) -> list[str]:
    """Time of a step in a loop: N = 10, from Python, in C and on a microcontroller."""
    rows = [
        "",
        "| A step of the loop, N = 10 | from Python | in C | of `run` | `numpy.interp` a sample "
        "| C over `numpy.interp` |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for path, what in (("swept", "swept"), ("reversing", "reversing at every step")):
        one = latency["plain"]["paths"][path]
        rows.append(
            f"| {what} | {one['step_ns']:.0f} ns | {one['c_step_ns']:.0f} ns | {one['run_ns']:.0f} ns "
            f"| {one['interp_ns']:.1f} ns | {one['c_ratio']:.1f} |"
        )
    rows += ["", "| Bytes of firmware, N = 10, `-Os -flto` | flash | RAM | stack |", "| --- | --- | --- | --- |"]
    for one in size["firmware"]:
        if one["structure"] == "plain" and one["flags"].startswith("-Os -flto"):
            rows.append(f"| {one['number']}, {one['processor']} | {one['flash']} | {one['ram']} | {one['stack']} |")
    return rows


def banks(data: dict) -> list[str]:
    """Many actuators at once: nanoseconds an actuator and sample, a mirror, bits."""
    rows = [
        "",
        "| Nanoseconds an actuator and sample | compensate | over `numpy.interp` | simulate | over `numpy.interp` |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name in ("21 knots", "2 knots", "100 elements", "transformer and 8 creep"):
        for build, what in (("avx2", "AVX2"), ("baseline", "without AVX2")):
            pair = [data["speed"][f"{do} {name}, {build}"] for do in ("compensate", "simulate")]
            cells = " | ".join(f"{one['ns']:.1f} | {one['ratio']:.2f}" for one in pair)
            rows.append(f"| {name}, {what} | {cells} |")
    bits, scaling = data["bits"], data["scaling"]
    wrong = sum(count for name, count in bits.items() if "other than" in name)
    for knots, mirror in data["mirror"].items():
        rows += [
            "",
            f"A mirror of {mirror['actuators']} actuators with springs of {knots}, one core, {mirror['steps']} steps "
            f"from Python: {mirror['median us']:.0f} us a step (median), {mirror['99.9 % us']:.0f} us in 99.9 %, "
            f"{mirror['worst us']:.0f} us at worst; {mirror['cores at 1000 Hz']:.2f} of a core at 1 kHz.",
        ]
    rows += [
        "",
        f"Of {bits['steps']:.0e} steps, {bits['clamped']} of them clamped, and of as many beside a compiled export, "
        f"{wrong} differ in a bit.",
        "",
        f"Two threads are {scaling['compensate']:.2f} times as fast as one (compensate), {scaling['simulate']:.2f} "
        "times (simulate).",
        "",
    ]
    return rows


def saturation(data: dict) -> list[str]:
    """Errors after clamped voltages."""
    volts = f"{data['allowed_V'][1]:.0f} V allowed, {data['needed_V']:.0f} V needed"
    rows = ["", f"| {volts} | largest error after saturation, % |", "| --- | --- |"]
    return rows + [f"| {name} | {percent:.2f} |" for name, percent in data["after_saturation_percent"].items()]


def calibrations(data: dict) -> list[str]:
    """Return the rows of calibrations on emulated instruments."""
    rows = [
        "",
        "| `dehyst calibrate` over a socket, virtual actuators | seconds | constant ratio, largest % "
        "| compensated, largest % | RMS % |",
        "| --- | --- | --- | --- | --- |",
    ]
    links = {"pi": "a controller's text protocol over TCP", "epics": "an IOC over Channel Access"}
    names = {
        "play": "plays, asymmetric",
        "creep": "the same, creeping",
        "preisach": "Preisach",
        "boucwen": "Bouc-Wen, resonating",
    }
    for one in data["calibrations"]:
        fast = "" if one["speed"] == 1 else f" (instrument {one['speed']:g} times as fast)"
        rows.append(
            f"| {names[one['actuator']]}, {links[one['link']]} | {one['seconds']:.0f}{fast} "
            f"| {one['nominal']['largest_percent']:.2f} | {one['compensated']['largest_percent']:.2f} "
            f"| {one['compensated']['rms_percent']:.3f} |"
        )
    return rows


def strangers(data: dict) -> list[str]:
    """Medians over truths, protocols and disturbances that dehyst was not made for."""
    lines = strangers_table(data["cases"]).strip().splitlines()
    return ["", "```text", *lines, "```"]


def tables() -> dict[str, list[str]]:
    """Return the page's tables, each by the name of its markers."""
    names = ("accuracy", "paper", "speed", "latency", "size", "saturation", "calibration", "strangers", "banks")
    data = {name: json.loads((HERE / f"{name}.json").read_text()) for name in names}
    return {
        "accuracy": accuracy(data["accuracy"]),
        "baselines": baselines(data["accuracy"]),
        "strangers": strangers(data["strangers"]),
        "paper": paper(data["paper"]),
        "speed": speed(data["speed"]),
        "steps": steps(data["latency"], data["size"]),
        "banks": banks(data["banks"]),
        "saturation": saturation(data["saturation"]),
        "calibrations": calibrations(data["calibration"]),
    }


def main() -> int:
    """Fill all blocks of the page."""
    statuses = []
    for name, rows in tables().items():
        block = re.compile(rf"(<!-- figures: {name} -->\n).*?(<!-- end of figures -->)", re.DOTALL)
        statuses.append(fill(PAGE, block, "\n".join(["", *rows, "", ""]).replace("\n\n\n", "\n\n")))
    return max(statuses)


if __name__ == "__main__":
    sys.exit(main())
