"""How far a path is expected to be missed: the one judgement of identify, insight, check, compensate and the page.

A path of its own is judged by its prediction band, which wins over what the identification promised for paths like its
records; that promise, from held-out data, wins over the error on the training records.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dehyst._units import per_metre
from dehyst.control import StartError
from dehyst.model import Actuator, Identification
from dehyst.trust.prediction_band import PredictionBand

_LENGTHS = ("rms", "largest", "half_width", "start")


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

    def words(self, stroke: float) -> str:
        """Return the errors of a path like the records in percent; empty if they are not known.

        Parameters
        ----------
        stroke : float
            What they are percent of [m].
        """
        if self.rms is None or self.largest is None:
            return ""
        rms, largest = (100 * error / stroke for error in (self.rms, self.largest))
        tested = "tested on validation records" if self.tested else "not tested on validation records"
        return f"to be missed by {rms:.2g} % RMS and {largest:.2g} % at most ({tested})"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        values = {f"{key}_m" if key in _LENGTHS else key: value for key, value in asdict(self).items()}
        return {**values, "parts": {f"{name}_m": error for name, error in self.parts.items()}}


def judge(actuator: Actuator, evidence: PredictionBand | None = None, path: StartError | None = None) -> Judgement:
    """Judge how far a path is expected to be missed.

    Parameters
    ----------
    actuator : Actuator
        Its `identification` has the errors found then.
    evidence : PredictionBand, optional
        What the records show of the path, as `insight(..., trajectory=...)` returns it; default: the path is like the
        records.
    path : StartError, optional
        What the start leaves open of the path, such as `HomedPath.error`; default: the start is known.
    """
    known = actuator.identification or Identification()
    parts = {} if known.largest_error is None else {"training": known.largest_error}
    largest = known.largest_error if known.expected_largest is None else known.expected_largest
    half = coverage = None
    if evidence is not None:
        parts |= {name: error for name, error in evidence.errors().items() if name != "all"}
        largest = evidence.error
        if (likely := evidence.likely) is not None:
            half, coverage = float(0.5 * np.mean(likely[1] - likely[0])), evidence.level
    opened = 0.0 if path is None else path.largest / per_metre(path.units)
    return Judgement(known.expected_rms, largest, half, coverage, parts, opened, known.tested)
