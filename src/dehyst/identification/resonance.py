"""The resonance, tuned by simulation: derivatives of a measured displacement show it less exactly."""

from __future__ import annotations

from dataclasses import replace
from math import exp

import numpy as np

from dehyst._types import Array
from dehyst.identification.frame import Frame
from dehyst.identification.program import Program, Solution
from dehyst.identification.regressors import RowSource
from dehyst.identification.rules import RULES
from dehyst.model import Dynamics
from dehyst.records import rms

# Finite differences of the search.
_STEP = 1e-3


def tuned(frame: Frame, source: RowSource, program: Program, found: Solution) -> Frame:
    """Return the records with the frequency, damping and delay of least simulation error; as they are without one."""
    from scipy.optimize import least_squares

    actuator, motion = frame.actuator(program, found), frame.motion
    start = actuator.dynamics
    if start is None:
        return frame
    base = float(actuator.spring.voltage[0])
    epochs = [one for one in frame.judged(source) if one.number in found.offsets]
    states = [frame.state(source, one.piece, one.epoch, actuator) for one in epochs]

    def numbers(x: Array) -> tuple[float, float, float]:
        # Numbers near 1, because finite differences are relative to them.
        frequency, damping, delay = (x - 1).tolist()
        return (
            start.frequency * exp(frequency),
            max(start.damping + damping, 0.0),
            motion.delay + delay / start.omega,
        )

    def error(x: Array) -> Array:
        frequency, damping, delay = numbers(x)
        model, left = replace(actuator, dynamics=Dynamics(frequency, damping)), []
        late = [path.voltage for item in frame.training for path in item.acting(delay, motion.lag)]
        for one, state in zip(epochs, states, strict=True):
            offset = found.offsets[one.number] - base
            missed = frame.missed(one.piece, one.epoch, model, state, offset, late[one.piece])[1]
            left.append(missed - missed.mean())
        return np.concatenate(left) / frame.stroke

    # What a resonance delays is no lead: only one that was there before stays.
    lead = max(motion.delay, 0.0)
    least = 1 - np.array([np.inf, start.damping, lead * start.omega])
    first = np.maximum(np.ones(3), least + 2 * _STEP)
    best = least_squares(error, first, x_scale=0.1, diff_step=np.full(3, _STEP), bounds=(least, np.inf), max_nfev=15)
    if not rms(best.fun) < rms(error(np.ones(3))):
        return frame
    frequency, damping, delay = numbers(best.x)
    omega = Dynamics(frequency, damping).omega
    if abs(delay) < RULES.shortest_lag * frame.times[0]:
        delay = 0.0
    changed = replace(motion, mass=1 / omega**2, damping=2 * damping / omega, delay=delay)
    return replace(frame, motion=changed)
