"""The judgement of a path: its expected error, from the model, the evidence and the path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._units import per_metre
from dehyst._views.fields import json_values
from dehyst.control import HomedPath, StartError
from dehyst.model import APART, Actuator, Identification, Promise
from dehyst.records import largest as largest_of
from dehyst.records import rms as rms_of
from dehyst.trust.prediction_band import PredictionBand

# Of the promised error: what a homing may leave open without a word.
_IN_PROMISE = 0.05
# The start of a path as text; a known start of another name has its name.
_BEGINS = {
    "": "",
    "homed": ", from a homed start",
    "unknown": ", from an unknown start",
    "top": ", from the top, after a rise",
    "bottom": ", from the bottom, after a fall",
}


@dataclass(frozen=True)
class Judgement:
    """The errors to expect on a path; None if a number is not known.

    Attributes
    ----------
    rms, largest : float or None
        RMS and largest error of the path, less its mean [m], bounds that nine of ten paths should keep. Without a path:
        of any path within the recorded voltages.
    parts : mapping of str to float
        Largest error by cause [m]: keys of `PredictionBand.errors`; "training", the error on the training records; and
        "temperature", what a temperature adds that was not tested, or is not known.
    start : float
        Largest displacement error due to an unknown start [m], which adds to `rms` and `largest`; 0 if the start is
        known.
    untested : tuple of str
        Sentences on the parts of the path that the records do not test.
    validated : bool
        Whether the errors come from validation records.
    begins : str
        The start of the path: "homed", "unknown", or the name of a known start; empty without a path.
    """

    rms: float | None
    largest: float | None
    parts: Mapping[str, float]
    start: float
    untested: tuple[str, ...]
    validated: bool
    begins: str = ""

    @property
    def bounds(self) -> tuple[float, float] | None:
        """RMS and largest error of the path [m] from its start; None if they are not known."""
        if self.rms is None or self.largest is None:
            return None
        return float(np.hypot(self.rms, self.start)), self.largest + self.start

    def words(self, stroke: float) -> str:
        """Return the errors from the start of the path as text, in percent of a stroke [m]; empty if not known."""
        if self.bounds is None:
            return ""
        rms, largest = (100 * error / stroke for error in self.bounds)
        # A homing leaves a little open always: what is small beside the promise is not mentioned.
        open_ = self.start > (_IN_PROMISE * (self.largest or 0.0) if self.begins == "homed" else 0.0)
        share = f"; the start causes up to {100 * self.start / stroke:.2g} %" if open_ else ""
        begins = _BEGINS.get(self.begins, f", from the start {self.begins}")
        return f"to be missed by {rms:.2g} % RMS and {largest:.2g} % at most of the stroke{begins}, {APART}{share}"

    def lines(self, stroke: float) -> list[str]:
        """Return the promise of a path in a line; no line if it is not known."""
        words = self.words(stroke)
        return [f"expect this path {words}"] if words else []

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; lengths in metres."""
        values = json_values(self, "rms_m=rms largest_m=largest start_m=start begins untested validated")
        return {**values, "parts": {f"{name}_m": error for name, error in self.parts.items()}}


def judge(
    actuator: Actuator,
    evidence: PredictionBand | None = None,
    path: StartError | None = None,
    *,
    promised: Promise | None = None,
    missed: ArrayLike = (),
    begins: str = "",
) -> Judgement:
    """Judge the error to expect on a path.

    Parameters
    ----------
    actuator : Actuator
        Its `identification` holds what the records tested.
    evidence : PredictionBand, optional
        The prediction band of the path, as `insight(..., trajectory=...)` returns it.
    path : StartError, optional
        Error of the path due to its unknown start, such as `HomedPath.error`; default: the start is known.
    promised : Promise, optional
        Promise of the path, such as `HomedPath.promise`; default: that of the evidence, or else of any path within the
        recorded voltages.
    missed : (n,) array_like, optional
        Error of the model itself on the path where its voltage was clamped [m].
    begins : str, optional
        The start of the path, as in `Judgement`.
    """
    known = actuator.identification or Identification()
    parts = {} if known.largest_error is None else {"training": known.largest_error}
    rms, largest, untested = known.expected_rms, known.expected_largest, tuple[str, ...]()
    promised = promised or (None if evidence is None else evidence.promise)
    if promised is None and known.validity is not None:
        promised = known.validity.anywhere
    if promised is not None:
        rms, largest, untested = promised.rms, promised.largest, promised.untested
        parts |= {"temperature": promised.by_temperature} if promised.by_temperature else {}
    if evidence is not None:
        parts |= evidence.errors()
        largest, missed = largest or evidence.misfit, evidence.displacement - evidence.wanted
    largest = known.largest_error if largest is None else largest
    if np.size(missed):
        largest = None if largest is None else largest + largest_of(missed)
        rms = None if rms is None else float(np.hypot(rms, rms_of(missed)))
    opened = 0.0 if path is None else path.largest / per_metre(path.units)
    return Judgement(rms, largest, parts, opened, untested, known.validated, begins)


def judge_planned(actuator: Actuator, path: HomedPath) -> Judgement:
    """Judge the error to expect on a planned path, from its start: that after its homing, if there is one."""
    return judge(
        actuator,
        path=path.left_open,
        promised=path.promise,
        missed=(path.expected - path.displacement)[path.first :] / per_metre(path.units),
        begins=path.start.name if path.homing is None else "homed",
    )
