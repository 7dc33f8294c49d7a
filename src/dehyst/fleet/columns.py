"""The columns of the table of a fleet."""

from __future__ import annotations

# What a row holds beside its keys, in the order of the table's columns.
NUMBERS = (
    *("largest_percent", "rms_percent", "expected_percent", "noise_nm", "noise_percent", "stroke_um"),
    *("width25_um", "width50_um", "width75_um", "drift_percent", "cycle_s"),
)
TEXTS = ("outcome", "detail", "reason")
PRIORS = ("prior", "held_out_own_percent", "held_out_prior_percent")
COLUMNS = (*TEXTS, *NUMBERS, *PRIORS, "samples", "coefficients", "version", "sha256", "cpu_s", "wall_s", "memory_MB")
MODEL = "model"
