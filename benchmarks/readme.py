"""Put the README's four rows of figures between its markers, from the benchmarks' JSON files.

With --check nothing is written; the exit status is 0 if the README contains them already.
"""

import json
import re
import sys
from pathlib import Path
from statistics import median

HERE = Path(__file__).resolve().parent
README = HERE.parent / "README.md"
BLOCK = re.compile(r"(<!-- figures: benchmarks -->\n).*?(<!-- end of figures -->)", re.DOTALL)
LINEAR = "linear ratio"
OURS = ("dehyst", "dehyst, paper's", "dehyst, told the voltage only")


def table() -> str:
    """Return the table: largest and RMS error of a straight scale factor, the best other model, and dehyst."""
    compared = json.loads((HERE / "accuracy.json").read_text())["compared"]
    strangers = json.loads((HERE / "strangers.json").read_text())["cases"]
    rows = [
        "| Largest (RMS) error, % of the stroke | straight scale factor | best other model | dehyst |",
        "| --- | --- | --- | --- |",
        _row("Virtual actuator, asymmetric loops, creep: a random path", _tracking(compared, "creep")),
        _row("Virtual Bouc-Wen actuator with a resonance: a random path", _tracking(compared, "boucwen")),
        _row("Measured PICMA stage: held-out record, predicted", _predictions(compared)),
        _row(f"{len(strangers)} virtual stages of other kinds, disturbed records: median", _medians(strangers)),
    ]
    return "\n".join(rows) + "\n"


def _tracking(compared: dict, truth: str) -> dict[str, tuple[float, float]]:
    found = {}
    for name, row in compared["tracking"][truth].items():
        errors = [(one["largest_percent"], one["rms_percent"]) for one in row["tracking"].values()]
        if errors:
            found[name] = max(errors)
    return found


def _predictions(compared: dict) -> dict[str, tuple[float, float]]:
    found = {}
    for name, row in compared["measured"].items():
        errors = [one for one in row["errors"] if one["role"] == "validation"]
        if errors:
            found[name] = errors[0]["largest_percent"], errors[0]["rms_percent"]
    return found


def _medians(cases: list[dict]) -> dict[str, tuple[float, float]]:
    scored = [case for case in cases if "crashed" not in case and not case["refused"]]
    found = {}
    for name in dict.fromkeys(name for case in scored for name in case["methods"]):
        rows = [case["methods"][name] for case in scored if "rms" in case["methods"].get(name, {})]
        # A model that fails on many records has no median worth its name.
        if 2 * len(rows) > len(scored):
            key = {"auto": "dehyst", "plain": "dehyst, paper's"}.get(name, name)
            found[key] = median(row["largest"] for row in rows), median(row["rms"] for row in rows)
    return found


def _row(what: str, errors: dict[str, tuple[float, float]]) -> str:
    others = {name: pair for name, pair in errors.items() if name not in OURS and name != LINEAR}
    best = min(others, key=lambda name: others[name])
    ours, theirs = errors["dehyst"], others[best]
    cells = [f"**{_pair(pair)}**" if pair == min(ours, theirs) else _pair(pair) for pair in (theirs, ours)]
    return f"| {what} | {_pair(errors[LINEAR])} | {cells[0]}, {best} | {cells[1]} |"


def _pair(errors: tuple[float, float]) -> str:
    return f"{errors[0]:.2f} ({errors[1]:.2f})"


def fill(page: Path, block: re.Pattern[str], figures: str) -> int:
    """Put figures between a page's markers, or with --check compare them; return the exit status."""
    text = page.read_text()
    if not block.search(text):
        print(f"{page.name} has lost its markers")
        return 1
    wanted = block.sub(lambda found: found[1] + figures + found[2], text)
    if "--check" in sys.argv:
        return 0 if wanted == text else 1
    page.write_text(wanted)
    return 0


if __name__ == "__main__":
    sys.exit(fill(README, BLOCK, table()))
