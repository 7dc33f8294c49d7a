"""The paper's experiment on a virtual actuator, beside the paper's numbers. Writes `paper.json`.

Goldfarb and Celanovic's model, the paper's reference 6, is fitted to the same first rises, relaxed and pre-energised.
"""

import json
from pathlib import Path
from typing import Any

from dehyst.paper import run
from dehyst.paper.experiment import ELEMENTS, ENERGISED, RELAXED, Experiment, PaperTrial, paper_trial
from dehyst.records import largest
from dehyst_rivals import GoldfarbCelanovic

RIVAL = {"goldfarb": RELAXED, "goldfarb_energised": ENERGISED}


def rival_trial(found: Experiment, start: str) -> PaperTrial:
    """Fit the model to the first rise from a start."""
    model = GoldfarbCelanovic.fit(found.runs[start].record, elements=ELEMENTS)
    return paper_trial(found.truth, found.runs[start], model.actuator)


def add_rival(found: Experiment, rows: list[dict[str, Any]]) -> None:
    """Add the model's numbers to the rows of the summary."""
    for key, start in RIVAL.items():
        trial = rival_trial(found, start)
        numbers = dict(trial.errors) | {"tracking": largest(trial.tracking.error)}
        if start == RELAXED:
            numbers["shift"] = 1e6 * trial.shift
        for row in rows:
            row[key] = numbers.get(row["key"])


def main() -> None:
    paper = run.run(print)
    found = paper.as_dict()
    for name, repeated in paper.experiments.items():
        add_rival(repeated, found[name]["summary"])
    target = Path(__file__).with_name("paper.json")
    target.write_text(json.dumps(found, indent=1) + "\n")
    print(target.name)


if __name__ == "__main__":
    main()
