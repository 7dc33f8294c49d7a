"""The shortest homing as a voltage to play: before a path, at its sample rate or a lower one, or step by step."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import RecordError
from dehyst._types import Array
from dehyst._validation import interval
from dehyst.control.compensator import Compensator
from dehyst.control.limits import VoltageLimits
from dehyst.control.planning.homing import Homing, leg_seconds, shortest_homing
from dehyst.model import Actuator
from dehyst.waveforms import Excitation, Sampling
from dehyst.waveforms import homing as homing_through
from dehyst.waveforms.excitation import volts

# Least duration of a leg of a homing [s].
FASTEST_LEG = 0.5
# A homing of more samples has longer steps: this many a leg, and a period of a resonance.
_EVEN_SAMPLES, _LEG_SAMPLES, _RESONANCE_SAMPLES = 100_000, 200, 10
# If these are still too many, most samples of a hold are left out: their times grow by this factor.
_SPARSER = 1.02


def present_voltage(limits: tuple[float, float], present: float | None) -> float:
    """Return the present voltage [V], by default 0 or the nearest limit; raise `RecordError` if it lies outside."""
    allowed = VoltageLimits(*limits)
    return (
        allowed.nearest(0.0)
        if present is None
        else allowed.within(volts(present, "present"), "present", error=RecordError)
    )


def played_homing(
    compensator: Compensator,
    rate: float,
    leg: float,
    *,
    present: float | None = None,
    drive: Sampling | None = None,
    tolerance: float | None = None,
) -> tuple[Excitation | None, Homing, tuple[str, ...]]:
    """Return the shortest homing as an excitation, None if the state is known already; the homing, and remarks.

    Raise `RecordError` if the present voltage lies outside of the limits, or there are too many samples.

    Parameters
    ----------
    compensator : Compensator
        Its actuator, limits and slew rate.
    rate : float
        Sample rate [Hz].
    leg : float
        Duration of a leg [s]; with creep it is as long as the default of `shortest_homing`.
    present : float, optional
        [V]; by default 0 V or the nearest limit.
    drive : Sampling, optional
        Instead of `leg`: speed and shape.
    tolerance : float, optional
        As in `shortest_homing`.
    """
    actuator, limits = compensator.actuator, interval(compensator.limits or ())
    now = present_voltage(limits, present)
    if drive is None:
        drive = Sampling(frequency=0.5 / leg_seconds(actuator, leg), sample_rate=rate)
    lower = _lower_rate(actuator, drive, rate)
    drive = replace(drive, sample_rate=lower, base=now, present=now, limits=limits, slew_rate=compensator.slew_rate)

    def found(drive: Sampling) -> Homing:
        return shortest_homing(actuator, limits=limits, present=now, stiff_only=True, drive=drive, tolerance=tolerance)

    homing = found(drive)
    if homing.played is None or homing.played.duration * rate <= _EVEN_SAMPLES:
        drive = replace(drive, sample_rate=rate)
        homing = found(drive)
    remarks = () if homing.certified and homing.played is None else homing.remarks
    if len(homing.turns) < 2:
        return None, homing, remarks
    played = homing.played or homing_through(turns=homing.turns, drive=drive)
    return played, homing, (*remarks, *_extrapolation_warning(actuator, played.voltage), *played.warnings)


def _extrapolation_warning(actuator: Actuator, voltage: Array) -> tuple[str, ...]:
    """Warn of a homing (n,) [V] that leaves the voltages of the model's records: they may harm the actuator."""
    if actuator.limits is None:
        return ()
    (low, high), least, most = actuator.limits, float(voltage.min()), float(voltage.max())
    if low <= least and most <= high:
        return ()
    return (
        f"the homing goes from {least:.6g} to {most:.6g} V, outside of the identified range {low:.6g} to {high:.6g} V: "
        "extrapolated; check that the actuator allows these voltages, or choose narrower limits",
    )


def rows_of(voltage: Array) -> NDArray[np.int64]:
    """Return the samples (k,) of a homing's voltage (n,) [V] to play: all, or ever fewer of a long hold."""
    rows = np.arange(voltage.size)
    return rows if rows.size <= _EVEN_SAMPLES else rows[_thinned(voltage)]


def _thinned(voltage: Array) -> NDArray[np.bool_]:
    """Return which samples (n,) to keep: those that move, and in a hold ever fewer."""
    held = np.zeros(voltage.size, dtype=np.int64)
    held[1:] = voltage[1:] == voltage[:-1]
    moving = np.flatnonzero(held == 0)
    since = np.arange(voltage.size) - np.repeat(moving, np.diff(moving, append=voltage.size))
    steps = np.unique(np.round(_SPARSER ** np.arange(int(math.log(voltage.size) / math.log(_SPARSER)) + 2)))
    kept: NDArray[np.bool_] = (since == 0) | np.isin(since, steps)
    kept[:-1] |= since[1:] == 0
    return kept


def _lower_rate(actuator: Actuator, drive: Sampling, rate: float) -> float:
    """Return the sample rate [Hz] of a long homing: `rate` over a whole number."""
    needed = 2 * _LEG_SAMPLES * drive.frequency
    if actuator.dynamics is not None:
        needed = max(needed, _RESONANCE_SAMPLES * actuator.dynamics.frequency / (2 * math.pi))
    return rate / max(1, int(rate / needed))


def homing_steps(homing: Homing, limits: VoltageLimits, period: float) -> Iterator[tuple[float, float]]:
    """Yield the voltages [V] of a homing without the present one, each with its duration [s], `period` at least."""
    largest = limits.largest_step(period)
    for (start, _), (end, seconds) in pairwise(_corners(homing, period)):
        count = max(1, math.ceil(abs(end - start) / largest * (1 - 1e-12)))
        for voltage in np.linspace(start, end, count + 1)[1:]:
            yield limits.nearest(float(voltage)), max(seconds / count, period)


def _corners(homing: Homing, period: float) -> list[tuple[float, float]]:
    """Return the voltages [V] that straight ramps join, the present one first, with their seconds; 0 if free."""
    if homing.played is None:
        return [(voltage, 0.0) for voltage in homing.turns]
    voltage, rate = homing.played.voltage, homing.played.sample_rate
    # No more often than a host can follow, but always at turns and at both ends of a hold.
    bends = np.flatnonzero(np.diff(np.sign(np.diff(voltage)))) + 1
    kept = np.unique([0, voltage.size - 1, *bends, *range(0, voltage.size, max(1, round(period * rate)))])
    seconds = np.diff(kept, prepend=0) / rate
    return list(zip(voltage[kept].tolist(), seconds.tolist(), strict=True))
