"""Put the faults of `faults.json` into `docs/explanation/safety.md`, between its markers.

With --check nothing is written; the exit status is 0 if the page contains them already.
"""

import json
import re
import sys
from pathlib import Path

from readme import fill

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "explanation" / "safety.md"
BLOCK = re.compile(r"(<!-- figures: faults -->\n).*?(<!-- end of figures -->)", re.DOTALL)
HEADS = ("fault", "message", "exit status", "ended after", "voltage", "samples from the device, on disk")
_LONGEST = 150


def table(data: dict) -> str:
    rows = [f"| {' | '.join(HEADS)} |", "|" + " --- |" * len(HEADS)]
    for one in data.values():
        cells = (one["words"], message(one), status(one), f"{one['seconds']:.1f} s", voltage(one), samples(one))
        rows.append(f"| {' | '.join(cells)} |")
    put = [one["put_out"] for one in data.values() if one["put_out"]]
    lowest, highest = min(one["lowest"] for one in put), max(one["highest"] for one in put)
    longest = max(one["seconds"] for one in data.values() if one["status"])
    rows += [
        "",
        f"{len(data)} faults: the emulator, whose limits are 0 to 200 V, put out {lowest:g} to {highest:g} V. Seconds "
        f"are counted from the fault on, where it comes while the command runs. Every command that was stopped ended "
        f"within {longest:.0f} s; those that took 5 s or more waited for an answer or a sample that did not come.",
    ]
    return "\n".join(rows) + "\n"


def message(one: dict) -> str:
    """Return the first sentence, without the controller's name, shortened if it is long."""
    if not one["said"]:
        return "-"
    words = one["said"][0].replace("dehyst,emulated piezo controller,0,0.1.0 at ", "")
    if len(words) > _LONGEST:
        words = words[:_LONGEST].rsplit(" ", 1)[0] + " ..."
    return "`" + words.replace("|", "\\|").replace("`", "'") + "`"


def status(one: dict) -> str:
    words = "killed" if one["status"] < 0 else str(one["status"])
    return words if one["again"] is None else f"{words}; once more: {one['again']['status']}"


def voltage(one: dict) -> str:
    """Return what happened to the voltage, as the command or else the emulator reports it."""
    put, notes = one["put_out"], " ".join(one["said"])
    if put is None:
        return "nothing was sent"
    if "could not be brought" in notes:
        return f"left to the device: {put['now']:g} V"
    if put["highest"] == 0:
        return "nothing was put out"
    if one["again"] is not None and one["status"] < 0:
        return f"its wave went on; the next call brought it to {put['now']:g} V"
    return f"brought to {put['now']:g} V"


def samples(one: dict) -> str:
    put = one["put_out"]
    if one["again"] is None:
        return "-" if not put else f"{put['told']}, {one['on_disk']}"
    return f"{one['came']} written by then, {one['on_disk']}; in the end {one['again']['on_disk']}"


if __name__ == "__main__":
    sys.exit(fill(PAGE, BLOCK, table(json.loads((HERE / "faults.json").read_text()))))
