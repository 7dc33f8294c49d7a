"""Messages of an identification: what the records leave open, and what was repaired, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dehyst._types import Array
from dehyst.identification.preparation import Prepared, counted_samples
from dehyst.identification.regressors import epochs
from dehyst.identification.results import FEWEST_DECADES, RecordErrors
from dehyst.records import turning_points
from dehyst.waveforms import Sampling

# Least number of turning points of a protocol.
_FEWEST_TURNS = 4
# Held-out voltages may go beyond by the first part of the limits' range; the second is the outer part at each end, of
# which samples are rare if fewer than this part of one passage through it.
_MARGIN, _END, _LEAST_PASSAGE = 0.02, 0.1, 0.25
# A drift below this part of the stroke is not remarked.
_SMALLEST_DRIFT = 2e-4

STEPS = (
    "After steps of the voltage the displacement rings or overshoots. The expected error holds for paths without "
    "steps. If ringing changes the hysteresis state, the error is larger until the next full loop."
)
# `seconds`: the lead [ms].
LEADS = (
    "The displacement leads the voltage by {seconds:.3g} ms, half a sample: it is read at the end of a step of a "
    "converter that holds. The voltages were moved; state it with hold=, see dehyst.Record."
)


def drive_like(limits: tuple[float, float], records: Sequence[Prepared]) -> Sampling:
    """Return the sampling for a voltage to record: within limits [V], at the rate of the records."""
    # Records leave a lowest voltage of 1e-15 V where 0 V was meant.
    low = 0.0 if abs(limits[0]) < _MARGIN * 1e-3 * (limits[1] - limits[0]) else limits[0]
    cycle = min(item.cycle for item in records)
    return Sampling(frequency=1 / cycle, base=low, limits=(low, limits[1]))


def _command(drive: Sampling, kind: str, options: str = "") -> str:
    """Return the command that writes an excitation up to the highest voltage."""
    highest = f"{drive.limits[1]:g}" if drive.limits is not None else ""
    return drive.command(" ".join(filter(None, (kind, highest, options))))


def of_lag(delay: float, lag: float, moved: float, stroke: float) -> str:
    """Return the sentence for a delay and a lag [s], in which the displacement moves by `moved` [m]."""
    late = f"The delay of {1e3 * delay:.3g} ms is not compensated: a path is late by it if the actuator delays. "
    early = f"The lag of {1e3 * lag:.3g} ms is compensated: a path is early by it if the sensor lags. "
    return (
        f"The displacement lags by {1e3 * (delay + lag):.3g} ms, in which it moves by {100 * moved / stroke:.2g} % of "
        f"the stroke (RMS); the records do not show whether the sensor or the actuator lags. "
        f"{late if delay else ''}{early if lag else ''}The expected error includes both. Look up the time constant of "
        "the sensor, or record a step with a faster sensor, and give it (sensor_lag, --sensor-lag; 0: none)."
    )


def of_one_ended_loops(voltages: Sequence[Array], drive: Sampling) -> list[str]:
    """Return a remark if all inner loops turn at one end of the voltages [V]: a path may have others."""
    low, high = min(float(v.min()) for v in voltages), max(float(v.max()) for v in voltages)
    near = _END * (high - low)
    minima, maxima = list[float](), list[float]()
    for v in voltages:
        turns = v[turning_points(v, _MARGIN * (high - low))]
        rises = np.diff(turns, append=turns[-2:-1]) > 0
        minima += turns[rises].tolist()
        maxima += turns[~rises].tolist()
    at_low, at_high = all(v < low + near for v in minima), all(v > high - near for v in maxima)
    if at_low == at_high or len(minima) + len(maxima) < _FEWEST_TURNS:
        return []
    return [
        f"All inner loops of the records turn at the {'lowest' if at_low else 'highest'} voltage. The expected error "
        "allows for other loops; records with random turning points test them, and lower it: "
        + _command(drive, "recommended")
    ]


def of_rare_voltages(records: Sequence[Prepared], limits: tuple[float, float], drive: Sampling) -> list[str]:
    """Return remarks about ends of the limits [V] that the used samples pass for a small part of one cycle."""
    low, high = limits
    width = _END * (high - low)
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
                f"Few samples lie {side} {edge:.4g} V; the limit is {end:.4g} V. The model is little better than "
                f"extrapolated there. Record slow loops that reach it: {_command(drive, 'raised-cosine', '--cycles 2')}"
            )
    return remarks


def of_held_out(records: Sequence[Prepared], limits: tuple[float, float]) -> list[str]:
    """Return remarks about held-out records that leave the limits [V]."""
    low, high = limits
    margin, ranges = _MARGIN * (high - low), [(item.name, *item.record.voltage_range) for item in records]
    return [
        f"{name}: the model is extrapolated: its voltages, {lowest:.4g} to {highest:.4g} V, leave those of the "
        f"training records, {low:.4g} to {high:.4g} V."
        for name, lowest, highest in ranges
        if lowest < low - margin or highest > high + margin
    ]


def repaired(
    errors: Sequence[RecordErrors], delay: float, sample: float, *, given: bool, low_pass: float = 0.0
) -> list[str]:
    """Return sentences about the delay [s], for samples `sample` [s] apart, and each record's zero and drift.

    `low_pass` [s]: the part of the delay that is a lag of first order.
    """
    sentences = []
    if delay:
        part = f", {low_pass * 1e3:.4g} ms of it as a low-pass of first order" if low_pass else ""
        sentences.append(
            f"The displacement lags the voltage by {delay * 1e3:.4g} ms ({delay / sample:.3g} samples, "
            f"{'given' if given else 'estimated'}{part}); the voltages were delayed by it."
        )
    for error in errors:
        if error.datum:
            sentences.append(f"{error.record}: the zero of its sensor was moved by {error.datum * 1e6:.4g} um.")
        if abs(error.drift) > _SMALLEST_DRIFT * error.stroke:
            sentences.append(f"{error.record}: {_drift(error)} was removed.")
    return sentences


def _drift(error: RecordErrors) -> str:
    """Return the drift of a record in words; only creep has a rate."""
    if error.creeps:
        return f"creep of {100 * error.drift / error.stroke:.3g} % of the stroke a decade of time"
    if error.steady:
        cause = "in proportion to time: of the sensor, the temperature, or slow creep"
    elif error.decades < FEWEST_DECADES:
        cause = "over too short a time to determine a rate of creep"
    else:
        cause = "too large for creep"
    return f"a drift of {error.drifted_percent:.3g} % of the stroke, {cause},"
