"""Gain and offset by temperature, identified first, from records with a temperature channel.

By section 22 of the theory, ``y = datum + offset dT + (1 + gain dT) m(v)``. Here m is a sum of curves of plays of the
voltage. Its weights and the two numbers are fitted by least squares. The numbers are used if they predict temperatures
that were held out. Then the records are brought to the reference, and identified as at one temperature.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import play_curves
from dehyst.identification.results import Trace
from dehyst.identification.rules import RULES
from dehyst.model import Actuator, Thermal
from dehyst.records import Record, rms

# Steps of Gauss-Newton; samples at most; ridge of the weights of m, relative to the mean square of their columns.
_STEPS, _MOST, _RIDGE = 5, 6000, 1e-6
# Parts of the temperatures that are held out in turn; standard errors from which on an offset counts.
_FOLDS, _SURE = 4, 3.0
# Parts of the range of temperatures of which records must have some.
_PLACES, _FEWEST = 8, 3


@dataclass(frozen=True)
class TemperatureEffect:
    """Gain and offset by temperature, and how well they are known.

    Attributes
    ----------
    gain, offset : float
        [1/K] and [m/K], of the displacement relative to the lowest voltage.
    gain_error, offset_error : float
        Standard errors from a jackknife over held-out temperatures.
    reference : float
        [degC], the mean of the records.
    range : (float, float)
        Lowest and highest temperature of the records [degC].
    better : float
        Error at held-out temperatures, relative to the error without the effect.
    missed : float
        RMS error of the sum of plays [m].
    datums : tuple of float
        Displacement of each record at the lowest voltage and the reference [m].
    shown_within : bool
        Whether a record's temperature changes by so much that it shows an offset, whatever the sensor's zero.
    """

    gain: float
    offset: float
    gain_error: float
    offset_error: float
    reference: float
    range: tuple[float, float]
    better: float
    missed: float
    datums: tuple[float, ...]
    shown_within: bool

    def at_reference(self, record: Record, datum: float | None = None) -> Record:
        """Return a record converted to the reference temperature; a record without temperature is unchanged.

        `datum`: as in `datums`, default: their mean.
        """
        temperature = record.temperature
        if temperature is None:
            return record
        kelvins, zero = temperature - self.reference, float(np.mean(self.datums)) if datum is None else datum
        at_once = (record.displacement - zero - self.offset * kelvins) / (1 + self.gain * kelvins)
        return replace(record, displacement=zero + at_once)

    def refined(self, records: Sequence[Record], traces: Sequence[Trace]) -> TemperatureEffect:
        """Return the effect with its gain fitted again with the identified actuator, where that misses less than plays.

        `records`: measured records. `traces`: the same records converted to the reference temperature, and simulated.
        A gain that held-out temperatures do not show stays 0.
        """
        if not self.gain or rms(np.concatenate([trace.residual for trace in traces[: len(records)]])) > self.missed:
            return self
        rows, left = [], []
        for record, trace in zip(records, traces, strict=False):
            temperature = record.temperature
            assert temperature is not None
            kelvins = np.interp(trace.time, record.time, temperature) - self.reference
            motion = trace.simulated - trace.simulated.min()
            columns = np.column_stack([motion * kelvins, motion])
            # Each record has a constant of its own.
            rows.append(columns - columns.mean(axis=0))
            left.append(trace.residual - trace.residual.mean())
        every = range(len(rows))
        change, *others = (
            float(np.linalg.lstsq(np.vstack([rows[q] for q in kept]), np.concatenate([left[q] for q in kept]))[0][0])
            for kept in ([*every], *([q for q in every if q != one] for one in every if len(rows) > 1))
        )
        spread = float(np.sqrt((len(others) - 1) * np.var(others))) if others else 0.0
        # What a better model of the motion changes is a measure of the error too.
        error = float(np.hypot(spread, change)) if abs(change) > self.gain_error else max(spread, self.gain_error)
        return replace(self, gain=self.gain + change, gain_error=error)

    def of(self, actuator: Actuator) -> Thermal:
        """Return the part of an actuator that was identified at the reference."""
        low, _ = actuator.major_loop(actuator.voltage_range)
        return Thermal(self.gain, self.offset - self.gain * low, self.reference)

    @property
    def sentence(self) -> str:
        """The effect as a sentence."""
        low, high = self.range
        gain = f"the stroke changes by {100 * self.gain:+.3g} ± {100 * self.gain_error:.2g} %/K" if self.gain else ""
        offset = (
            f"the displacement at the lowest voltage changes by {1e9 * self.offset:+.3g} ± "
            f"{1e9 * self.offset_error:.2g} nm/K"
            if self.offset
            else ""
        )
        zeroed = (
            ""
            if self.shown_within
            else f" Whether it also shifts as a whole is not known: no record changes by {RULES.temperatures:g} K."
        )
        return (
            f"From {low:.3g} to {high:.3g} degC {' and '.join(one for one in (gain, offset) if one)}. Held-out "
            f"temperatures are missed by {100 * self.better:.0f} % of the error without that.{zeroed}"
        )


def temperature_effect(records: Sequence[Record]) -> tuple[TemperatureEffect | None, str]:
    """Return how the displacement of `records` of one axis depends on their temperature, and why that is not shown.

    The effect is None if it is not shown; the reason is empty if there is an effect, or no change of temperature. All
    records need a temperature, with a range of `DecisionRules.temperatures`. Held-out ones must be predicted better, by
    `DecisionRules.temperature_helps`: with the effect than without, and with a gain than with an offset alone.
    """
    given = [record.temperature for record in records]
    known = [one for one in given if one is not None]
    if not known:
        return None, ""
    every = np.concatenate(known)
    low, high = float(every.min()), float(every.max())
    if high - low < RULES.temperatures:
        return None, ""
    words = f"the temperature changes from {low:.3g} to {high:.3g} degC, which the model leaves out"
    if len(known) < len(given):
        missing = next(record.name for record, one in zip(records, given, strict=True) if one is None)
        return None, f"{words}: {missing} has none"
    if np.count_nonzero(np.histogram(every, _PLACES)[0]) < _FEWEST:
        return None, f"{words}: record {_FEWEST} temperatures or more"
    rows = _TemperatureRows(records, every)
    within = max(float(np.ptp(np.quantile(one, [0.05, 0.95]))) for one in known)
    # A sensor that is zeroed again hides the offset, but for what the temperature changes within a record.
    shown = rows.expands = within >= RULES.temperatures
    gain, offset, errors, datums, missed = rows.jackknifed()
    if rows.expands and abs(offset) < _SURE * errors[1]:
        rows.expands = False
        gain, offset, errors, datums, missed = rows.jackknifed()
    within = rms(rows.held_out())
    if rows.expands:
        rows.stretches = False
        alone = rms(rows.held_out())
        if within > RULES.temperature_helps * alone:
            gain, offset, errors, datums, missed = rows.jackknifed()
            within = alone
        else:
            rows.stretches = True
    better = within / max(rms(rows.held_out(fixed=True)), 1e-300)
    if not better <= RULES.temperature_helps or not np.all(1 + 2 * gain * rows.kelvins > 0):
        return None, f"{words}: held-out temperatures do not show its effect"
    found = gain, offset, *errors, rows.reference, (low, high), better, missed, tuple(datums), shown
    return TemperatureEffect(*found), ""


class _TemperatureRows:
    """Samples of all records that count, and the columns of m."""

    def __init__(self, records: Sequence[Record], temperatures: Array) -> None:
        self.reference = float(temperatures.mean())
        step = 1 + temperatures.size // _MOST
        lowest = min(float(record.voltage.min()) for record in records)
        span = max(float(record.voltage.max()) for record in records) - lowest
        columns, y, kelvins, own = [], [], [], []
        # m is 0 at the lowest voltage after a fall from the highest.
        bottom = play_curves(np.array([0.0, 1.0, 0.0]))[-1]
        for q, record in enumerate(records):
            u = np.ascontiguousarray((record.voltage - lowest) / span)
            # The state is known once the voltage has been at both of its ends.
            first = max(int(np.argmax(u)), int(np.argmin(u)))
            kept = slice(first, None, step)
            columns.append(play_curves(u)[kept] - bottom)
            y.append(record.displacement[kept])
            own.append(np.full(y[-1].size, q))
            temperature = record.temperature
            assert temperature is not None
            kelvins.append(temperature[kept] - self.reference)
        self.columns, self.y = np.vstack(columns), np.concatenate(y)
        self.kelvins, self.own = np.concatenate(kelvins), np.concatenate(own)
        self.datums = (self.own[:, None] == np.arange(len(records))).astype(np.float64)
        edges = np.quantile(self.kelvins, np.arange(1, _FOLDS) / _FOLDS)
        self.folds = np.searchsorted(edges, self.kelvins, side="right")
        # Whether there is an offset, and a gain.
        self.expands = self.stretches = True

    def jackknifed(self) -> tuple[float, float, tuple[float, float], Array, float]:
        """Return gain, offset, their standard errors, the datum of each record, and the RMS error [m]."""
        gain, offset, datums, weights = self.solved(np.ones(self.y.size, dtype=bool))
        missed = rms(self.errors(gain, offset, weights) - self.datums @ datums)
        found = np.array([self.solved(self.folds != k)[:2] for k in np.unique(self.folds)])
        errors = np.sqrt((len(found) - 1) * found.var(axis=0))
        return gain, offset, (float(errors[0]), float(errors[1])), datums, missed

    def solved(self, kept: Array, *, fixed: bool = False) -> tuple[float, float, Array, Array]:
        """Return gain, offset, datums and weights by the samples `kept` (n,); with `fixed` gain and offset are 0."""
        columns, kelvins, own, y = self.columns[kept], self.kelvins[kept], self.datums[kept], self.y[kept]
        size, gain = columns.shape[1], 0.0
        m = np.zeros(y.size)
        # Gauss-Newton: with the weights of before the equations are linear in the gain's change too.
        for _ in range(1 if fixed else _STEPS):
            free = [] if fixed else [self.stretches * m * kelvins, self.expands * kelvins]
            rows = np.column_stack([(1 + gain * kelvins)[:, None] * columns, own, *free])
            scale = np.sqrt(np.mean(rows**2, axis=0))
            scale[scale == 0] = 1.0
            gram, image = rows.T @ rows / np.outer(scale, scale), rows.T @ y / scale
            ridge = np.where(np.arange(len(gram)) < size, _RIDGE * len(y), 0.0)
            found = np.linalg.lstsq(gram + np.diag(ridge), image, rcond=None)[0] / scale
            weights, datums = found[:size], found[size : size + own.shape[1]]
            change, offset = (0.0, 0.0) if fixed else found[-2:]
            gain, m = gain + float(change), columns @ weights
        return float(self.stretches * gain), float(self.expands * offset), datums, weights

    def errors(self, gain: float, offset: float, weights: Array) -> Array:
        """Return the errors (n,) [m], the datums aside."""
        return np.asarray(self.y - (1 + gain * self.kelvins) * (self.columns @ weights) - offset * self.kelvins)

    def held_out(self, *, fixed: bool = False) -> Array:
        """Return the errors (n,) [m] of each fold by the others, the datums of its records aside."""
        errors = np.zeros(self.y.size)
        for k in np.unique(self.folds):
            own = self.folds == k
            gain, offset, _, weights = self.solved(~own, fixed=fixed)
            used, error = self.datums[own], self.errors(gain, offset, weights)[own]
            errors[own] = error - used @ np.linalg.lstsq(used, error, rcond=None)[0]
        return errors
