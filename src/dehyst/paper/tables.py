"""Comparison of the paper's numbers with this package: the summary and Table 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.model import Physical
from dehyst.paper.experiment import PEAKS, PRE_ENERGISED, Experiment
from dehyst.records import largest

# Sec. 4.2: T [N/V], km and ke [N/m].
CONSTANTS = {"transformer_ratio": 0.042, "mechanical_stiffness": 1.4e6, "electrical_stiffness": 8.82e4}
# Secs. 4.2 and 4.3: errors in % of the range, lengths in um.
PAPER = {
    "major": 0.2,
    "medium": 1.0,
    "small": 1.25,
    "tracking": 0.76,
    "nominal": 13.63,
    "spacing": 1.615,
    "range": 16.152,
}
MODELS = {
    "breakpoints": ("The paper's method", "N = 10"),
    "record": ("Whole records", "N = 40, descending tops added"),
}


def summary(found: Experiment) -> list[dict[str, Any]]:
    """Return the numbers of the paper and of one virtual actuator, as JSON values; errors are against the truth.

    A row has a `key`, a `quantity`, a `unit`, the number of the `paper`, the number of each of `MODELS`, and the number
    of the `actuator` if no model is needed.
    """
    trials = {key: found.trials[key] for key in MODELS}
    shift = f"Shift of the loop by {PRE_ENERGISED:g} V before (Eq. 10)"
    tracked = {key: largest(trial.tracking.error) for key, trial in trials.items()}
    spacing = {key: 2e6 * float(trial.actuator.slip.breakaway[0]) for key, trial in trials.items()}
    shifted = {key: 1e6 * trial.shift for key, trial in trials.items()}
    rows: list[tuple[str, str, str, float | None, Mapping[str, float]]] = [
        (loop, f"Model error, {loop} loop ({peak:g} V)", "%", None, {key: trials[key].errors[loop] for key in MODELS})
        for loop, peak in PEAKS.items()
    ]
    rows += [
        ("tracking", "Tracking error, inverse control", "%", None, tracked),
        ("nominal", "Tracking error, nominal ratio", "%", largest(found.nominal.error), {}),
        ("spacing", "Spacing of break points", "µm", None, spacing),
        ("range", "Range of the major loop", "µm", 1e6 * found.loops[0].range, {}),
        ("shift", shift, "µm", 1e6 * float(found.shift.mean()), shifted),
    ]
    return [
        {"key": key, "quantity": quantity, "unit": unit, "actuator": actuator, "paper": PAPER.get(key)}
        | {name: models.get(name) for name in MODELS}
        for key, quantity, unit, actuator, models in rows
    ]


def physical(found: Experiment) -> Physical:
    """Return the model of the paper's method in the paper's symbols, with the paper's constants."""
    return Physical.of(found.trials["breakpoints"].actuator, **CONSTANTS)


def table1(found: Experiment) -> dict[str, Array]:
    """Return the columns of Table 1, N = 10, by the paper's method."""
    ours = physical(found)
    return {
        "i": np.arange(1.0, ours.stiffness.size + 1),
        "r_um": 1e6 * ours.breakaway,
        "k_N_per_m": ours.stiffness,
        "f_N": ours.friction,
    }


def as_dict(found: Experiment) -> dict[str, Any]:
    """Return all tables of one actuator as JSON values."""
    return {
        "summary": summary(found),
        "table1": {key: column.tolist() for key, column in table1(found).items()},
    }
