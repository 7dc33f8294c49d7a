"""Random actuators and compensators for the attacks, as identifications and users make them."""

import sys
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import sanitized

sanitized.lay_over()

import numpy as np
import strategies

from dehyst import Actuator, Compensator
from dehyst.model import Dynamics, SmoothSlip, turned

KINDS = ("plain", "plain", "wide", "dynamics", "lag", "smooth", "all")


def random_model(rng, kind):
    """An actuator as identifications make them, with the parts of a kind."""
    seed, uniform = int(rng.integers(2**32)), bool(rng.integers(2))
    actuator = strategies.make_actuator(
        seed, int(rng.integers(0, 12)), int(rng.integers(2, 12)), uniform, float(rng.choice([0, 0, 0.3]))
    )
    span, volts = strategies.span_of(actuator), float(np.ptp(actuator.spring.voltage))
    if kind == "plain":
        return actuator
    graded, transformer, creep = rng.random(3) < 0.5
    actuator = strategies.make_wider(actuator, seed, graded=graded, transformer=transformer, creep=creep)
    parts = {}
    if kind in ("dynamics", "all"):
        stiffness = volts / span * rng.uniform(0.1, 3)
        parts["dynamics"] = Dynamics(10 ** rng.uniform(0, 4), rng.uniform(0.005, 1), stiffness)
    if kind in ("lag", "all"):
        parts["lag"] = 10 ** rng.uniform(-6, -2)
    if kind in ("smooth", "all"):
        lengths, stiffness = span * rng.uniform(0.02, 0.5, 2), volts / span * rng.uniform(0, 0.4, 2)
        parts["smooth"] = SmoothSlip(lengths, rng.uniform(0.5, 1, 2), stiffness)
    # Its own start has no smooth elements elongated nor a mass.
    made = Actuator(
        actuator.slip,
        actuator.spring,
        transformer=actuator.transformer,
        displacement_creep=actuator.displacement_creep,
        **parts,
    )
    return replace(made, delay=10 ** rng.uniform(-6, -3)) if rng.random() < 0.2 else made


def random_start(rng, actuator):
    """A state that a compensator begins in: its own, reached, or farther away than its limits."""
    if rng.random() < 0.5:
        return None
    y = actuator.spring.displacement[0] + strategies.span_of(actuator) * rng.uniform(-1, 2)
    return turned(actuator, float(y), rising=bool(rng.integers(2)))


def random_compensator(rng, kind):
    """One within limits that may lie beside the model's own range."""
    actuator = random_model(rng, kind)
    low = float(actuator.spring.voltage[0]) + np.ptp(actuator.spring.voltage) * rng.uniform(-0.5, 0.6)
    high = low + np.ptp(actuator.spring.voltage) * 10 ** rng.uniform(-2, 0.3)
    period = 10 ** rng.uniform(-6, 0)
    slew = None if rng.random() < 0.3 else (high - low) / period * 10 ** rng.uniform(-3, 0.5)
    preview, start = bool(rng.random() < 0.3), random_start(rng, actuator)
    return Compensator(actuator, (low, high), slew, period=period, preview=preview, state=start)
