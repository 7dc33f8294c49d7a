"""A plant that ages, and the cycles of a path over most of its stroke."""

from dataclasses import replace

import numpy as np
import plain_records

from dehyst import Actuator, MaxwellSlip, Spring

PLANT = replace(plain_records.plant(10, seed=4), limits=(-20.0, 220.0))
LIMITS, PERIOD, STROKE = (-20.0, 220.0), 1e-3, plain_records.STROKE
TURNS = (0.85, 0.35, 0.65, 0.05)


def aged(age, gain=-0.07, width=0.25):
    """The plant with less gain, a wider loop and a bent spring; its lowest point stays."""
    slip, spring = PLANT.slip, PLANT.spring
    kappa = slip.stiffness * (1 + width * age) / (1 + gain * age)
    part = np.linspace(0, 1, spring.slopes.size)
    slopes = spring.slopes * (1 + 0.1 * age * (part - 0.5)) / (1 + gain * age)
    first = spring.voltage[0] + (kappa - slip.stiffness) @ slip.breakaway
    return Actuator(MaxwellSlip(slip.breakaway, kappa), Spring.of_slopes(spring.displacement, slopes, float(first)))


def cycle(seed, scale=1.0, middle=0.45):
    turns = [TURNS[-1], *(np.array(TURNS) + 0.02 * np.random.default_rng(seed).random(4))]
    return middle * STROKE * (1 - scale) + scale * plain_records.path(turns, 40)[1:]
