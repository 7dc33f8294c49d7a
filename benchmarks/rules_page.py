"""Write the page of the decision rules from their class; with --check, fail if the page is another one.

python benchmarks/rules_page.py [--check]
"""

import argparse
import sys
from dataclasses import fields
from pathlib import Path

from dehyst.identification.rules import DecisionRules

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "decision_rules.md"
# The first rule of each table, and its heading.
HEADINGS = {
    "longest_lag": "Delay and lag",
    "datum_gain": "Sensor zero, drift and creep",
    "slowest_cycle": "Inertia",
    "part_gain": "Structure",
    "quiet": "Noise",
    "check_risk": "Checks and remarks",
    "useless": "Verdict",
}
INTRODUCTION = """# Decision rules

The thresholds by which an identification keeps a part, calls it noise, or refuses: the fields of
`dehyst.identification.rules.DecisionRules`. A ratio of errors is that with the part over that without it, unless its
reason states otherwise. This page is written by `benchmarks/rules_page.py`.
"""


def page() -> str:
    """Return the page."""
    lines = [INTRODUCTION.rstrip()]
    for rule in fields(DecisionRules):
        if rule.name in HEADINGS:
            lines += [
                "",
                f"## {HEADINGS[rule.name]}",
                "",
                "| Rule | Value | Unit | Reason |",
                "| --- | --- | --- | --- |",
            ]
        lines.append(f"| `{rule.name}` | {rule.default:g} | {rule.metadata['unit']} | {rule.metadata['reason']} |")
    return "\n".join([*lines, ""])


def main() -> int:
    """Write the page, or compare it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    if parser.parse_args().check:
        return int(PAGE.read_text() != page())
    PAGE.write_text(page())
    return 0


if __name__ == "__main__":
    sys.exit(main())
