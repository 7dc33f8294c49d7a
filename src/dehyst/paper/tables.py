"""Comparison of the paper's numbers with this package: the summary, the limits of the errors, and Table 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.model import Physical
from dehyst.paper import experiment
from dehyst.paper.experiment import CYCLES, DRIVE, PEAKS, PLANS, PRE_ENERGISED, Experiment

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
    "record": ("Whole record", "N = 40, same records"),
    "record_tops": ("Whole record", "N = 40, descending tops added"),
}
_ACTUATOR = "highest_V=highest width asymmetry bend plays"


@dataclass(frozen=True)
class Quantity:
    """A row of the summary.

    `actuator`: value measured on the virtual actuator, if no model is needed. `models`: value by model, where it
    applies; errors are against the truth. `against_noise`: the same against the noisy measurement.
    """

    key: str
    words: str
    unit: str
    actuator: float | None = None
    models: Mapping[str, float] = field(default_factory=dict)
    against_noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def paper(self) -> float | None:
        """The paper's number, if it gives one."""
        return PAPER.get(self.key)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        models = {key: self.models.get(key) for key in MODELS}
        against = json_values(self, "against_measurement=against_noise")
        return {**json_values(self, "key quantity=words unit paper actuator"), **models, **against}


def summary(found: Experiment) -> tuple[Quantity, ...]:
    """Return the paper's numbers and those of one virtual actuator."""
    trials = {key: found.trials[key] for key in MODELS}
    errors = [
        Quantity(
            loop,
            f"Model error, {loop} loop ({peak:g} V)",
            "%",
            models={key: trial.errors[loop].true for key, trial in trials.items()},
            against_noise={key: trial.errors[loop].measured for key, trial in trials.items()},
        )
        for loop, peak in PEAKS.items()
    ]
    tracked = {key: trial.tracking.largest for key, trial in trials.items()}
    spacing = {key: 2e6 * float(trial.actuator.slip.breakaway[0]) for key, trial in trials.items()}
    moved = {key: 1e6 * trial.shift for key, trial in trials.items()}
    shift = f"Shift of the loop by {PRE_ENERGISED:g} V before (Eq. 10)"
    return (
        *errors,
        Quantity("tracking", "Tracking error, inverse control", "%", models=tracked),
        Quantity("nominal", "Tracking error, nominal ratio", "%", found.nominal.largest),
        Quantity("spacing", "Spacing of break points", "µm", models=spacing),
        Quantity("range", "Range of the major loop", "µm", 1e6 * found.loops[0].range),
        Quantity("shift", shift, "µm", 1e6 * found.shift.loop, models=moved),
    )


def limits(found: Experiment) -> list[dict[str, Any]]:
    """Return every identification with its errors against the truth [% of the range], as JSON values."""
    rows = []
    for plan in PLANS:
        trial = found.trials[plan.key]
        plan_values = json_values(plan, "key whole elements norm descending_tops=tops perfect_sensor=noiseless")
        errors = {loop: trial.errors[loop].true for loop in PEAKS} | {"tracking": trial.tracking.largest}
        rows.append({**plan_values, **errors, "outcome": trial.outcome})
    return rows


def floors(found: Experiment) -> dict[str, float]:
    """Return lower bounds of the error of any model [% of the range]; see `dehyst.paper.experiment`."""
    symmetric = experiment.symmetric_width_floor(found.exact)
    chords = {f"chords_{n}": experiment.chord_error(found.exact, n) for n in (10, 20, 40)}
    parabola = experiment.parabola_chord_error(PAPER["nominal"], 10)
    return {"symmetric_width": symmetric, **chords, "parabola_chords_10": parabola}


def physical(found: Experiment, key: str) -> Physical:
    """Return a trial's model in the paper's symbols, with the paper's constants."""
    return found.trials[key].actuator.physical(**CONSTANTS)


def table1(found: Experiment) -> dict[str, Array]:
    """Return the columns of Table 1, N = 10: by the paper's method, and by the whole-record method."""
    ours, record = physical(found, "breakpoints"), physical(found, "record_10")
    return {
        "i": np.arange(1.0, ours.stiffness.size + 1),
        "r_um": 1e6 * ours.breakaway,
        "k_N_per_m": ours.stiffness,
        "f_N": ours.friction,
        "whole_record_k_N_per_m": record.stiffness,
        "whole_record_f_N": record.friction,
    }


def as_dict(found: Experiment) -> dict[str, Any]:
    """Return all results of one actuator as JSON values."""
    truth, moved = found.truth, found.shift
    noise = {"noise_nm": 1e9 * truth.noise, "seed": truth.seed}
    return {
        "actuator": {"stroke_um": 1e6 * truth.stroke, **json_values(truth, _ACTUATOR), **noise},
        "summary": [row.as_dict() for row in summary(found)],
        "limits": limits(found),
        "floors_percent": floors(found),
        "shift_um": {"loop": 1e6 * moved.loop, "deviation": 1e6 * moved.deviation, "rest": 1e6 * moved.rest},
        "table1": {key: column.tolist() for key, column in table1(found).items()},
        "remarks": {key: list(trial.remarks) for key, trial in found.trials.items()},
        "clamped_samples": {key: trial.tracking.clamped for key, trial in found.trials.items()},
    }


def protocol() -> dict[str, Any]:
    """Return the protocol as JSON values."""
    return {
        "frequency_Hz": DRIVE.frequency,
        "sample_rate_Hz": DRIVE.rate,
        "cycles": CYCLES,
        "peaks_V": dict(PEAKS),
        "pre_energised_V": PRE_ENERGISED,
        "constants": dict(CONSTANTS),
    }
