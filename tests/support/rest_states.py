"""Actuators at rest in any state, voltages to drive them through, and whether a state is known after."""

from itertools import pairwise

import numpy as np
import plain_records
import strategies as our
from hypothesis import strategies as st

from dehyst import State
from dehyst._native import slip_elongations
from dehyst.control import StateBounds

EXACT = 1e-12
PLANT = plain_records.plant(10, seed=4)
SOME = our.actuators(1, 15)
SHAPES = ("walk", "scatter", "growing", "dying", "steps up")
# Enough for the steepest spring that the strategies draw.
PLENTY = 40.0


def equilibrium(actuator, voltage, rng):
    """Any elongations at all; the spring holds the rest of the voltage."""
    rho = actuator.slip.breakaway
    s = rng.uniform(-1, 1, rho.size) * rho * rng.choice([0.1, 1.0])
    at_ends = rng.random(rho.size) < rng.choice([0.0, 0.0, 0.5, 1.0])
    s = np.where(at_ends, np.where(rng.random(rho.size) < 0.5, -rho, rho), s)
    y = actuator.core.spring_inverse(voltage - float(actuator.slip.stiffness @ s))
    return State(y, y - s)


def voltages(actuator, start, seed, shape, n):
    rng = np.random.default_rng([seed, 4])
    size = our.volts_of(actuator) * 10 ** rng.uniform(-2, 0.7)
    makers = {
        "walk": lambda: np.cumsum(rng.normal(size=n)),
        "scatter": lambda: rng.normal(size=n),
        "growing": lambda: np.arange(n) / max(n, 1) * (-1.0) ** np.arange(n),
        "dying": lambda: (1 - np.arange(n) / max(n, 1)) * (-1.0) ** np.arange(n),
        "steps up": lambda: np.linspace(0, 1, n),
    }
    return start + size * makers[shape]()


@st.composite
def drives(draw, bank=SOME, max_samples=60):
    """Draw an actuator, the voltage it rests at, and voltages to go through."""
    actuator, seed = draw(bank), draw(our.SEEDS)
    start = float(np.random.default_rng([seed, 5]).uniform(-1, 1)) * our.volts_of(actuator)
    path = voltages(actuator, start, seed, draw(st.sampled_from(SHAPES)), draw(st.integers(0, max_samples)))
    return actuator, start, path, seed


def metres(actuator, *paths):
    """Rounding in the motion: the longest of the lengths that took part."""
    lengths = [
        our.span_of(actuator),
        2 * actuator.slip.breakaway.max(initial=0.0),
        np.abs(actuator.spring.displacement).max(),
    ]
    return EXACT * float(max([*lengths, *(np.abs(path).max(initial=0.0) for path in paths)]))


def carts_along(actuator, voltage, state):
    y = actuator.simulate(voltage, state=state, extrapolate=True).displacement
    return y, y[:, None] - slip_elongations(actuator.slip.breakaway, state.carts, y)[0]


def range_of(actuator):
    return our.span_of(actuator)


def travel(turns):
    return sum(abs(b - a) for a, b in pairwise(turns))


def ends_known(actuator, turns, stiff_only=False):
    """Whether two simulations meet, by the carts alone and without the stack."""
    start = StateBounds.at_rest(actuator, turns[0])
    low, high = (
        actuator.simulate(turns, state=state, stack=False, extrapolate=True).state
        for state in (start.lower, start.upper)
    )
    counted = actuator.slip.stiffness > 0 if stiff_only else slice(None)
    widest = np.abs(high.carts - low.carts)[counted].max(initial=0.0)
    return max(widest, abs(high.deformation - low.deformation)) <= EXACT * range_of(actuator)


def roomy(actuator, seed):
    """Limits that allow every homing, and a present voltage anywhere between."""
    rng = np.random.default_rng([seed, 6])
    volts = our.volts_of(actuator)
    present = float(rng.uniform(-1, 1) * volts)
    below, above = rng.choice([(PLENTY, PLENTY), (0.0, PLENTY), (PLENTY, 0.0), (0.2, PLENTY), (PLENTY, 0.2)])
    end = None if rng.random() < 0.5 else float(rng.uniform(-1, 1) * volts)
    ends = (present, present if end is None else end)
    return (min(ends) - below * volts, max(ends) + above * volts), present, end
