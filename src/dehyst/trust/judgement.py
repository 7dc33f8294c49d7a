"""How far a path is expected to be missed: one judgement, of which insight, check, command line and page are views.

A path of its own is judged by its prediction band, which wins over what the identification promised for paths like its
records; that promise, from held-out data, wins over the error on the training records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dehyst.control import StartError
from dehyst.model import Actuator, Identification
from dehyst.trust.prediction_band import PredictionBand


@dataclass(frozen=True)
class Judgement:
    """The errors to expect on a path; a number that is not known is None.

    Attributes
    ----------
    rms : float or None
        RMS error of a path like the records of the identification [m].
    largest : float or None
        Largest error of this path; without a band of a path like the records [m].
    half_width : float or None
        Mean half width of the band that holds the share `coverage` of this path [m].
    coverage : float or None
        Share of the path that the band holds, 0 to 1.
    parts : mapping of str to float
        Largest error by cause [m]: keys of `PredictionBand.errors`, and "training", the error on the training records.
    start : float
        Largest displacement that an unknown start leaves open [m]; 0 if the start is known.
    tested : bool
        Whether `rms`, and without a band `largest`, come from validation records.
    """

    rms: float | None
    largest: float | None
    half_width: float | None
    coverage: float | None
    parts: Mapping[str, float]
    start: float
    tested: bool

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        lengths = {"rms", "largest", "half_width", "start"}
        values = {f"{key}_m" if key in lengths else key: value for key, value in asdict(self).items()}
        return {**values, "parts": {f"{name}_m": error for name, error in self.parts.items()}}


def judge(actuator: Actuator, *, band: PredictionBand | None = None, start: StartError | None = None) -> Judgement:
    """Judge how far a path is expected to be missed.

    Parameters
    ----------
    actuator : Actuator
        Its `identification` has the errors found then.
    band : PredictionBand, optional
        Of the path by the records as evidence, as `insight(..., trajectory=...)` makes it; default: a path like the
        records.
    start : StartError, optional
        What an unknown start leaves open of the path, in metres; default: the start is known.
    """
    known = actuator.identification or Identification()
    parts = {} if known.largest_error is None else {"training": known.largest_error}
    largest = known.largest_error if known.expected_largest is None else known.expected_largest
    half = coverage = None
    if band is not None:
        parts |= {name: error for name, error in band.errors().items() if name != "all"}
        largest = band.error
        if (likely := band.likely) is not None:
            half, coverage = float(0.5 * np.mean(likely[1] - likely[0])), band.level
    opened = 0.0 if start is None else start.largest
    return Judgement(known.expected_rms, largest, half, coverage, parts, opened, known.tested)
