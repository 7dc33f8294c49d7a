"""Records of one plain actuator, with known differences between its path and the measured displacement."""

from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import structured_records as wide

from dehyst import DisplacementCreep, Dynamics, Record, Thermal
from dehyst.identification.preparation import prepare
from dehyst.model import turned

STROKE, STEP = plain_records.STROKE, 1 / wide.RATE
STRUCTURE = wide.STRUCTURES["plain"]
CREEP = DisplacementCreep([0.05, 0.5, 5.0], [0.01, 0.02, 0.015])
THERMAL = Thermal(-2.5e-3, 4e-9, 30.0)
DYNAMICS = Dynamics(25.0, 0.04)


@cache
def plant(samples=40, hold=0):
    """The actuator along random branches of a number of samples, with holds between them."""
    return wide.plant(STRUCTURE, path=wide.wandering(40, samples=samples, hold=hold))


def still(noise=0.0, **path):
    """The record without any difference between path and measurement."""
    return plant(**path).record(noise=noise)


def seen(record, displacement, noise=0.0, seed=1, **changes):
    """A record with another displacement."""
    noisy = displacement + noise * np.random.default_rng(seed).normal(size=len(record))
    return replace(record, displacement=noisy, **changes)


def delayed(samples, noise=0.0):
    """The displacement late by a number of samples."""
    record = still()
    return seen(record, np.interp(record.time - samples * STEP, record.time, record.displacement), noise)


def drifting(rate, noise=0.0):
    """The displacement with a drift [parts of the stroke a unit of the drift curve]."""
    record = still()
    return seen(record, record.displacement + rate * STROKE * prepare(record).drift_curve(record), noise)


def creeping(strains=(0.0, 0.0, 0.0), noise=0.0):
    """The displacement with creep whose strains [m] at the first sample are `strains`."""
    record = still(hold=20)
    return seen(record, CREEP.added(record.time, record.displacement, np.array(strains))[0], noise)


def swinging(noise=0.0, dynamics=DYNAMICS):
    """The displacement after a resonance."""
    moved, record = replace(plant().actuator, dynamics=dynamics), still()
    first = float(record.displacement[0])
    state = replace(turned(moved, first), motion=[first, 0.0])
    played = moved.simulate(record.voltage, time=record.time, state=state, extrapolate=True)
    return seen(record, played.displacement, noise)


def warmed(first, last, noise=0.0, seed=1):
    """The displacement while the temperature goes from `first` to `last` [degC]."""
    record = still()
    temperature = np.linspace(first, last, len(record))
    y = THERMAL.warmed(record.displacement, temperature)
    return seen(record, y, noise, seed, others={"temperature_C": temperature}, name=f"{first:g}")


def shifted(zero):
    """Two records of which the second has another zero."""
    record = still()
    return [record, Record(record.time, record.voltage, record.displacement - zero, "shifted")[400:]]
