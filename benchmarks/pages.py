"""Put the figures of the benchmarks' JSON files between the markers of README, paper and documentation.

    python benchmarks/pages.py [--check]

A page has a line `<!-- figures: NAME -->` for each entry of `BLOCKS`. With --check nothing is written; the exit status
is 0 if all pages contain their figures already.
"""

import re
import sys
import textwrap
from collections.abc import Callable
from dataclasses import fields
from statistics import median

from how_to_tables import coupled, creep, firmware, learning, temperature, updates
from page_tables import LINEAR, OURS, ROOT, Row, both, data, held_out, table, worst
from strangers.command import table as strangers_table

from dehyst.identification.rules import DecisionRules

# Parts of the benchmark of the promise.
PARTS = {"found": "the mechanisms that set its numbers", "made": "three made last"}


def readme() -> list[str]:
    """Largest and RMS error of a straight scale factor, the best other model, and dehyst."""
    compared, strangers = data("accuracy")["compared"], data("strangers")["cases"]
    tracked = {truth: figures(rows, worst) for truth, rows in compared["tracking"].items()}
    return table(
        ("Largest (RMS) error, % of the stroke", "straight scale factor", "best other model", "dehyst"),
        (
            best("Virtual actuator, asymmetric loops, creep: a random path", tracked["creep"]),
            best("Virtual Bouc-Wen actuator with a resonance: a random path", tracked["boucwen"]),
            best("Measured PICMA stage: held-out record, predicted", figures(compared["measured"], held_out)),
            best(f"{len(strangers)} virtual stages of other kinds, disturbed records: median", medians(strangers)),
        ),
    )


def figures(rows: dict, of: Callable[[dict], dict | None]) -> dict[str, tuple[float, float]]:
    found = {name: of(row) for name, row in rows.items()}
    return {name: (own["largest_percent"], own["rms_percent"]) for name, own in found.items() if own is not None}


def medians(cases: list[dict]) -> dict[str, tuple[float, float]]:
    scored = [case for case in cases if "crashed" not in case and not case["refused"]]
    found = {}
    for name in dict.fromkeys(name for case in scored for name in case["methods"]):
        rows = [case["methods"][name] for case in scored if "rms" in case["methods"].get(name, {})]
        # The median of a model that fails on many records means nothing.
        if 2 * len(rows) > len(scored):
            key = {"auto": "dehyst", "plain": "dehyst, paper's"}.get(name, name)
            found[key] = median(row["largest"] for row in rows), median(row["rms"] for row in rows)
    return found


def best(what: str, errors: dict[str, tuple[float, float]]) -> Row:
    others = {name: pair for name, pair in errors.items() if name not in (*OURS, LINEAR)}
    other = min(others, key=lambda name: others[name])
    cells = {name: "{:.2f} ({:.2f})".format(*errors[name]) for name in (LINEAR, other, "dehyst")}
    first = min(other, "dehyst", key=lambda name: errors[name])
    cells[first] = f"**{cells[first]}**"
    return what, cells[LINEAR], f"{cells[other]}, {other}", cells["dehyst"]


def accuracy() -> list[str]:
    virtual, measured = data("accuracy")["virtual"], data("accuracy")["measured"]
    # Sec. 4.3 and Fig. 12.
    theirs = "13.63, 0.76"
    rows = table(
        ("Largest error, in % of the stroke", "linear feedforward", "dehyst", "the paper: linear, inverse control"),
        [
            (
                "following a path with nine reversals, virtual actuator",
                f"{virtual['linear']['largest_percent']:.2f}",
                f"**{virtual['compensated']['largest_percent']:.2f}**",
                f"{theirs} (their actuator, one raised cosine)",
            )
        ],
    )
    names = {
        "record": "trained on both",
        "held out": "trained on major and 4500 rows of ramps",
    }
    found = [
        (
            f"{error['record']}{'' if error['role'] == 'training' else ' (validation)'}, {what}",
            f"{error['largest_percent']:.2f}",
            f"{error['rms_percent']:.3f}",
            f"{error['largest_with_drift_percent']:.2f}, {error['rms_with_drift_percent']:.3f}",
        )
        for key, what in names.items()
        for error in (measured[key]["errors"] if measured else ())
    ]
    stage = "Measured: a PICMA stack in a micromanipulator, 1 Hz"
    head = (stage, "largest %", "RMS %", "with its drift: largest, RMS %")
    return [*rows, "", *table(head, found)] if measured else rows


def baselines() -> list[str]:
    """Errors of every model on the worst path of every virtual actuator, and in prediction of the measured stage."""
    compared, truths = data("accuracy")["compared"], ("play", "creep", "preisach", "boucwen")
    head = (
        *("Largest and RMS error, % of the stroke", "plays, asymmetric", "the same, creeping", "Preisach"),
        *("Bouc-Wen, resonating", "measured, predicted"),
    )
    rows = [["asked of dehyst", *(both(compared["asked"][name]) for name in (*truths, "measured"))]]
    names = dict.fromkeys([*compared["tracking"]["play"], *compared["measured"]])
    for name in sorted(names, key=lambda name: not name.startswith("dehyst")):
        errors = [worst(compared["tracking"][truth].get(name)) for truth in truths]
        cells = map(both, [*errors, held_out(compared["measured"].get(name))])
        shown = (f"**{cell}**" if name == "dehyst" else cell for cell in cells)
        rows.append([name.replace("told", "given"), *shown])
    return table(head, rows)


def strangers() -> list[str]:
    """Medians over truths, protocols and disturbances that dehyst was not made for."""
    return ["```text", *strangers_table(data("strangers")["cases"]).strip().splitlines(), "```"]


def paper() -> list[str]:
    head = (
        *("The paper's experiment on a virtual actuator, largest error in % of the range", "paper"),
        *("its method, N = 10", "whole records, descending tops added", "Goldfarb and Celanovic, relaxed"),
    )
    rows = []
    for key, what in (("asymmetric", ""), ("symmetric", ", a loop of symmetric width")):
        for row in data("paper")[key]["summary"]:
            if row["unit"] == "%" and row["key"] != "nominal":
                models = ("paper", "breakpoints", "record", "goldfarb")
                rows.append([f"{row['quantity']}{what}", *(f"{row[name]:.2f}" for name in models)])
    nominal = next(row for row in data("paper")["asymmetric"]["summary"] if row["key"] == "nominal")
    return [
        *table(head, rows),
        f"| Nominal ratio, no model | {nominal['paper']:.2f} | {nominal['actuator']:.2f} | | |",
    ]


def speed() -> list[str]:
    swept, noisy = "swept loops", "the same, a reversal at every other sample"
    wider = "with a transformer and 8 branches of creep"
    jobs = [
        (path, f"{job}, {what}", job)
        for path, what in (("slow", swept), ("noisy", noisy), ("random", "uniformly distributed samples"))
        for job in ("compensate", "simulate")
    ]
    jobs += [
        ("slow", f"{job} {wider}, {swept}", f"{job} with transformer and 8 creep") for job in ("compensate", "simulate")
    ]
    paths = data("speed")["paths"]
    rows = ([what, *(f"{paths[path][f'{key} {n}']['ratio']:.2f}" for n in (10, 100, 1000))] for path, what, key in jobs)
    return table(("Time a sample, in units of `numpy.interp` on the same array", "N = 10", "N = 100", "N = 1000"), rows)


def steps() -> list[str]:
    """Time of a step in a loop: N = 10, from Python, in C and on a microcontroller."""
    head = (
        *("A step of the loop, N = 10", "from Python", "in C", "of `run`", "`numpy.interp` a sample"),
        "C over `numpy.interp`",
    )
    rows = []
    for path, what in (("swept", "swept"), ("reversing", "reversing at every step")):
        latency = data("latency")["plain"]["paths"][path]
        times = [f"{latency[key]:.0f} ns" for key in ("step_ns", "c_step_ns", "run_ns")]
        rows.append([what, *times, f"{latency['interp_ns']:.1f} ns", f"{latency['c_ratio']:.1f}"])
    return table(head, rows)


def calibrations() -> list[str]:
    """Calibrations on emulated instruments."""
    links = {"pi": "a controller's text protocol over TCP", "epics": "an IOC over Channel Access"}
    names = {
        "play": "plays, asymmetric",
        "creep": "the same, creeping",
        "preisach": "Preisach",
        "boucwen": "Bouc-Wen, resonating",
    }
    rows = []
    for row in data("calibration")["calibrations"]:
        fast = "" if row["speed"] == 1 else f" (instrument {row['speed']:g} times as fast)"
        errors = [f"{row[kind]['largest_percent']:.2f}" for kind in ("nominal", "compensated")]
        what = f"{names[row['actuator']]}, {links[row['link']]}"
        rows.append([what, f"{row['seconds']:.0f}{fast}", *errors, f"{row['compensated']['rms_percent']:.3f}"])
    what = "`dehyst calibrate` over a socket, virtual actuators"
    return table((what, "seconds", "constant ratio, largest %", "compensated, largest %", "RMS %"), rows)


def faults() -> list[str]:
    found = data("faults").values()
    head = ("fault", "exit status", "ended after, s", "voltage")
    rows = [(row["words"], status(row), f"{row['seconds']:.1f}", voltage(row)) for row in found]
    put = [row["put_out"] for row in found if row["put_out"]]
    lowest, highest = min(row["lowest"] for row in put), max(row["highest"] for row in put)
    longest = max(row["seconds"] for row in found if row["status"])
    lost = sum(max(0, (row["came"] or 0) - row["on_disk"]) for row in found)
    return [
        *table(head, rows),
        "",
        f"{len(found)} faults: the emulator, whose limits are 0 to 200 V, put out {lowest:g} to {highest:g} V. Of the "
        f"samples that arrived, {lost} were not on disk. Seconds are counted from the fault. Every stopped command "
        f"ended within {longest:.0f} s; those of 5 s or more waited for an answer or a sample.",
    ]


def status(row: dict) -> str:
    words = "killed" if row["status"] < 0 else str(row["status"])
    return words if row["again"] is None else f"{words}; once more: {row['again']['status']}"


def voltage(row: dict) -> str:
    """Return the outcome for the voltage, as reported by the command or else by the emulator."""
    put, notes = row["put_out"], " ".join(row["said"])
    if put is None:
        return "nothing was sent"
    if "could not be brought" in notes:
        return f"left to the device: {put['now']:g} V"
    if put["highest"] == 0:
        return "nothing was put out"
    if row["again"] is not None and row["status"] < 0:
        return f"its wave went on; the next call brought it to {put['now']:g} V"
    return f"brought to {put['now']:g} V"


def promise() -> list[str]:
    """Coverage and sharpness of the promise."""
    found = data("promise")
    head = (
        *("", "paths", "largest error kept, %", "with its offset, from a sensor zeroed at the start, %"),
        *("RMS error kept, %", "sharpness, RMS", "over three times, %", "ready, missed by twice"),
    )
    rows = []
    for part, name in ((part, name) for part, name in PARTS.items() if part in found):
        tables = found[part]["tables"]
        for by, values in tables.items():
            if by not in ("all", "protocol") and (by != "truth" or part == "found"):
                continue
            for value, row in values.items():
                keys = ("kept", "kept_zeroed", "kept_rms", "over_three")
                kept, zeroed, kept_rms, over = (f"{100 * row[key]:.0f}" for key in keys)
                sharp = f"{row['sharpness']:.2f}, {row['sharpness_rms']:.2f}"
                title = f"**{name}**" if by == "all" else f"{by} {value}"
                missed = str(row["ready_and_missed_by_twice"])
                rows.append([title, str(row["paths"]), kept, zeroed, kept_rms, sharp, over, missed])
    return table(head, rows)


def rules() -> list[str]:
    """Return the fields of the class of the rules."""
    # The first rule of each table, and its heading.
    headings = {
        "longest_lag": "Delay and lag",
        "zero_gain": "Sensor zero and drift",
        "slowest_cycle": "Inertia",
        "creep_gain": "Creep",
        "static_gain": "Static parts",
        "temperatures": "Temperature",
        "useless": "Verdict",
    }
    lines, heading = [], table(("Rule", "Value", "Unit", "Reason"), ())
    for rule in fields(DecisionRules):
        if rule.name in headings:
            lines += ["", f"## {headings[rule.name]}", "", *heading]
        row = f"`{rule.name}`", f"{rule.default:g}", rule.metadata["unit"], rule.metadata["reason"]
        lines.append(f"| {' | '.join(row)} |")
    return lines[1:]


def costs() -> list[str]:
    """Return a paragraph on how often the promise is kept, and on the time of a step."""
    kept = data("promise")["made"]["tables"]["all"][""]["kept"]
    steps = data("latency")["plain"]["paths"]
    in_c, in_python = ([steps[path][key] for path in ("swept", "reversing")] for key in ("c_step_ns", "step_ns"))
    text = (
        "Of the paths on virtual actuators whose mechanisms had no part in setting the error bounds, "
        f"{100 * kept:.0f} % stay within them; the bounds are meant for 90 %. A step of the inverse with ten elements "
        f"takes {in_c[0]:.0f} to {in_c[1]:.0f} ns in C and {in_python[0]:.0f} to {in_python[1]:.0f} ns from Python on "
        "one processor core."
    )
    return textwrap.wrap(text.replace(" %", "\N{NO-BREAK SPACE}%"), 120)


# Page, name of its markers, and the function that returns the lines between them.
BLOCKS: dict[str, dict[str, Callable[[], list[str]]]] = {
    "README.md": {"benchmarks": readme},
    "paper/paper.md": {"benchmarks": readme, "costs": costs},
    "docs/benchmarks.md": {
        make.__name__: make
        for part in (
            (accuracy, baselines, strangers, paper, speed),
            (steps, firmware, temperature, calibrations, promise),
            (coupled, creep, learning, updates, faults),
        )
        for make in part
    },
    "docs/reference/decision_rules.md": {"rules": rules},
}


def filled(page: str) -> str:
    """Return the text of a page with its present figures."""
    text = (ROOT / page).read_text()
    for name, lines in BLOCKS[page].items():
        block = re.compile(rf"(<!-- figures: {name} -->\n).*?(<!-- end of figures -->)", re.DOTALL)
        if not block.search(text):
            raise SystemExit(f"{page} has lost its markers of {name}")
        inside = "\n".join([*lines(), ""])
        text = block.sub(lambda found, inside=inside: found[1] + inside + found[2], text)
    return text


def main() -> int:
    """Fill all pages, or compare them."""
    stale = [page for page in BLOCKS if filled(page) != (ROOT / page).read_text()]
    if "--check" in sys.argv:
        print(*(f"{page} has other figures: run benchmarks/pages.py" for page in stale), sep="\n")
        return len(stale)
    for page in stale:
        (ROOT / page).write_text(filled(page))
    return 0


if __name__ == "__main__":
    sys.exit(main())
