"""Messages of an identification: sentences about open questions and repairs of the records."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._views.lines import percent
from dehyst.identification.preparation import Prepared, counted_samples
from dehyst.identification.regressors import epochs
from dehyst.identification.results import FEWEST_DECADES, RecordErrors
from dehyst.model import ExciteCommand

# Part of the limits' range at each end; samples in it are rare if they are fewer than this part of one passage.
_END, _LEAST_PASSAGE = 0.1, 0.25
# Least moved zero and least drift, as parts of the stroke, that get a remark.
_SMALLEST_ZERO, _SMALLEST_DRIFT = 0.1, 2e-4

STEPS = (
    "After steps of the voltage the displacement rings or overshoots. The expected error holds for paths without "
    "steps. If ringing changes the hysteresis state, the error is larger until the next full loop."
)
NO_LAG = "The records show no lag: who lags makes no difference. A higher sample rate shows a shorter one."
# `seconds`: the lead [ms].
LEADS = (
    "The displacement leads the voltage by {seconds:.3g} ms, half a sample: the sensor is read at the end of each step "
    "of the converter. The voltages were moved in time; to state this, use hold=, see dehyst.Record."
)


def of_moved_zeros(errors: Sequence[RecordErrors]) -> list[str]:
    """Return a remark for each record whose zero was moved far."""
    return [
        f"{error.record}: the zero of its sensor was moved by {error.zero * 1e6:.4g} um, "
        f"{percent(abs(error.zero), error.stroke)} of the stroke. If it was not zeroed again, the records may come "
        "from two stages: identify each alone."
        for error in errors
        if abs(error.zero) > _SMALLEST_ZERO * error.stroke
    ]


def of_offset(error: RecordErrors, offset: float) -> str:
    """Return a reason for care: a record has this `error` unless an `offset` [V] is added to its voltages."""
    return (
        f"the error on {error.record} is {percent(error.settled_largest, error.stroke)} of the stroke unless its "
        f"voltages are shifted by {offset:.3g} V: the records may come from two stages, identify each alone"
    )


def of_rare_voltages(records: Sequence[Prepared], limits: tuple[float, float]) -> list[str]:
    """Return remarks about ends of the limits [V] with few used samples."""
    low, high = limits
    width, slow = _END * (high - low), ExciteCommand(high, low, "raised-cosine", cycles=2)
    used = []
    for item in records:
        samples = counted_samples([(piece.voltage, epochs(piece, item.noise)) for piece in item.pieces])
        cycles = [cycle.stop - cycle.start - 1 for cycle in item.record.cycles()]
        used.append((np.concatenate([np.zeros(0), *samples]), float(np.median(cycles or [len(item.record)]))))
    remarks = []
    for end, inward, side in ((high, -1, "above"), (low, 1, "below")):
        edge = end + inward * width
        passages = sum(np.count_nonzero(inward * (edge - v) > 0) / cycle for v, cycle in used)
        if passages < _LEAST_PASSAGE * _END:
            remarks.append(
                f"Few samples lie {side} {edge:.4g} V; the limit is {end:.4g} V. There the model is hardly better than "
                f"an extrapolation. Record slow loops that reach the limit: {slow}"
            )
    return remarks


def repaired(
    errors: Sequence[RecordErrors], delay: float, sample: float, *, given: bool, low_pass: float = 0.0
) -> list[str]:
    """Return sentences about the delay [s] and the drift of each record; `sample`: sample time [s].

    `low_pass` [s]: the part of the delay that is a lag of first order.
    """
    sentences = []
    if delay:
        part = f", {low_pass * 1e3:.4g} ms of it as a low-pass of first order" if low_pass else ""
        sentences.append(
            f"The displacement lags the voltage by {delay * 1e3:.4g} ms ({delay / sample:.3g} samples, "
            f"{'given' if given else 'estimated'}{part}); the voltages were delayed by it."
        )
    drifted = (error for error in errors if abs(error.drift) > _SMALLEST_DRIFT * error.stroke)
    return sentences + [f"{error.record}: {_drift(error)} was removed." for error in drifted]


def _drift(error: RecordErrors) -> str:
    """Return the drift of a record in words; only creep has a rate."""
    if error.creeps:
        return f"creep of {100 * error.drift / error.stroke:.3g} % of the stroke a decade of time"
    if error.steady:
        cause = "linear in time, from the sensor, a moved zero, the temperature, or slow creep"
    elif error.decades < FEWEST_DECADES:
        cause = "over too short a time to determine a rate of creep"
    else:
        cause = "too large for creep"
    return f"a drift of {error.drifted_percent:.3g} % of the stroke, {cause},"
