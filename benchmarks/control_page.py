"""Put the figures of `loop.json` into `docs/how_to/control.md`, between its markers.

With --check nothing is written; the exit status is 0 if the page contains them already.
"""

import json
import re
import sys
from pathlib import Path

from readme import fill

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "how_to" / "control.md"
BLOCK = re.compile(r"(<!-- figures: loop -->\n).*?(<!-- end of figures -->)", re.DOTALL)
NAMES = {"feedback": "integral feedback", "feedforward": "feedforward (dehyst)", "both": "both"}
PATHS = ("triangle", "tones")
HEADS = (
    "",
    "lines at 5 Hz, largest, RMS error %",
    "sines of 0.7 to 17 Hz together, largest, RMS error %",
    "bandwidth, sines of 0.5 % of the stroke",
    "of 20 % of the stroke",
    "disturbances taken away up to",
    "gain of the integral",
)


def table(data: dict) -> str:
    rows = [f"| {' | '.join(HEADS)} |", "|" + " --- |" * len(HEADS)]
    for kind, name in NAMES.items():
        errors = [data["tracking"][path][kind] for path in PATHS]
        cells = [f"{one['largest_percent']:.2f}, {one['rms_percent']:.3f}" for one in errors]
        cells += [band(data["bandwidth"][size][kind]) for size in ("small", "large")]
        away = data["rejecting_to_Hz"][kind]
        cells.append(f"{away:.2g} Hz" if away else "none")
        gain = data["integral"].get(kind)
        cells.append("-" if gain is None else f"{gain['gain_per_s']:.0f} /s")
        rows.append(f"| {name} | {' | '.join(cells)} |")
    model, true = data["identified"], data["stage"]
    rows += [
        "",
        f"Identified: {model['resonance_Hz']:.1f} Hz ({true['resonance_Hz']:g}), damping {model['damping']:.4f} "
        f"({true['damping']:g}), delay {1e3 * model['delay_s']:.3f} ms ({1e3 * true['delay_s']:g}), steepest branch "
        f"{model['steepest']:.2f} times the mean slope; the path is known {model['samples_ahead']} samples ahead.",
    ]
    alone, both = (pushed(data["larger_gains"][kind]) for kind in ("feedback", "both"))
    rows += [
        "",
        f"On the lines the integral alone swings with {alone[0]} that gain (best before: {alone[1]:.2f} %), both with "
        f"{both[0]} theirs (best before: {both[1]:.2f} %).",
    ]
    return "\n".join(rows) + "\n"


def pushed(rows: list[dict]) -> tuple[str, float]:
    """How many times its gain a loop swings with, and the least largest error of smaller ones."""
    words = f"{rows[-1]['times']} times" if rows[-1]["swings"] else f"more than {rows[-1]['times']} times"
    return words, min(row["largest_percent"] for row in rows if not row["swings"])


def band(found: dict) -> str:
    """-3 dB, and where the gain rises above +3 dB before that."""
    down, up = found["down_3_dB_Hz"], found["up_3_dB_Hz"]
    words = f"{down:.3g} Hz" if down is not None else f"above {found['swept_to_Hz']:g} Hz"
    return words if up is None or (down is not None and up > down) else f"{words} (up at {up:.3g} Hz)"


if __name__ == "__main__":
    sys.exit(fill(PAGE, BLOCK, table(json.loads((HERE / "loop.json").read_text()))))
