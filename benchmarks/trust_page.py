"""Put the coverage of bands from `coverage.json` into `docs/explanation/trust.md`, between its markers.

With --check nothing is written; the exit status is 0 if the page contains it already.
"""

import json
import re
import sys
from pathlib import Path

from readme import fill

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "explanation" / "trust.md"
BLOCK = re.compile(r"(<!-- figures: coverage -->\n).*?(<!-- end of figures -->)", re.DOTALL)
HEADS = (
    "truth",
    "use",
    "class of the model",
    "repeats",
    "in the 90 % band",
    "records of tops / random turns",
    "in the band by noise alone",
    "half width, % of the stroke",
    "90 % of the errors within",
)
TRUTHS = {
    "relays": "Preisach's relays, asymmetric",
    "bouc-wen": "Bouc and Wen",
    "domains": "Jiles and Atherton's domains",
    "stribeck": "Stribeck friction",
    "voigt": "Rayleigh's branches, creeping",
    "bristles": "Dahl's bristles before a resonance",
}


def table(rows: list[dict]) -> str:
    """Return the table of the bands."""
    lines = [f"| {' | '.join(HEADS)} |", "|" + " --- |" * len(HEADS)]
    for row in rows:
        cells = (
            TRUTHS[row["truth"]],
            row["use"],
            row["class"],
            str(row["repeats"]),
            percent(row["held"]),
            f"{percent(row['held_tops'])} / {percent(row['held_random'])}",
            percent(row["held_by_noise"]),
            f"{row['half']:.2f}",
            f"{row['error']:.2f} %",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def percent(share: float) -> str:
    """Return a share in per cent."""
    return f"{100 * share:.1f} %"


if __name__ == "__main__":
    sys.exit(fill(PAGE, BLOCK, table(json.loads((HERE / "coverage.json").read_text())["bands"])))
