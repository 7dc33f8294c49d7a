"""Random actuators, states and paths for property tests.

Hypothesis draws few small numbers (a seed, sizes, a kind); NumPy makes the arrays from them. That keeps drawing quick
and lets an example shrink to few elements, few knots and a short path of a named kind.
"""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st

from dehyst import Actuator, DisplacementCreep, MaxwellSlip, Spring, State
from dehyst.model import GradedSlip, SmoothSlip, Transformer, turned

SEEDS = st.integers(0, 2**32 - 1)
STATE_KINDS = ("relaxed", "turned up", "turned down", "reached", "arbitrary", "extreme")
PATH_KINDS = ("walk", "decay", "repeated", "constant", "jumps", "noisy ramp", "nested", "break points")


def make_slip(rng, n, span, volts, *, uniform, zeros):
    """Return n elements whose largest breakaway is between a twentieth and all of the span."""
    gaps = np.ones(n) if uniform else rng.lognormal(sigma=1.5, size=n)
    rho = span * rng.uniform(0.05, 1.0) * (np.cumsum(gaps) / max(gaps.sum(), 1e-300))
    if uniform and n:
        rho = rho[0] * np.arange(1, n + 1)
    kappa = rng.exponential(volts / span / max(n, 1), size=n)
    kappa[rng.random(n) < zeros] = 0.0
    return MaxwellSlip(rho, kappa)


def make_spring(rng, m, span, volts):
    """Return a spring of m knots; slopes between a fifth and five times the mean keep the inverse well conditioned."""
    gaps = rng.uniform(0.2, 1.0, m - 1)
    knots = span * (np.concatenate([[0.0], np.cumsum(gaps)]) / gaps.sum() - rng.uniform(0, 1))
    slopes = volts / span * np.exp(rng.uniform(-1.6, 1.6, m - 1))
    values = np.concatenate([[0.0], np.cumsum(slopes * np.diff(knots))])
    return Spring(knots, values - rng.uniform(0, 1) * values[-1])


def make_actuator(seed, n, m, uniform=True, zeros=0.0):
    rng = np.random.default_rng(seed)
    span, volts = 10 ** rng.uniform(-7, -3), 10 ** rng.uniform(0, 3)
    return Actuator(make_slip(rng, n, span, volts, uniform=uniform, zeros=zeros), make_spring(rng, m, span, volts))


def actuators(min_elements=0, max_elements=40, knots=None):
    """Draw actuators of micrometres to millimetres and volts to kilovolts."""
    return st.builds(
        make_actuator,
        SEEDS,
        st.integers(min_elements, max_elements),
        st.integers(2, 30) if knots is None else st.just(knots),
        st.booleans(),
        st.sampled_from([0.0, 0.0, 0.3, 1.0]),
    )


def wide_actuators():
    """Draw mostly small sets of elements, sometimes a thousand."""
    return st.one_of(actuators(), actuators(), actuators(), actuators(1000, 1000))


def span_of(actuator):
    """Length [m] between the spring's outer knots."""
    return float(np.ptp(actuator.spring.displacement))


def volts_of(actuator):
    """Voltage [V] of the major loop over the spring's knots: the scale of rounding in the force balance."""
    return float(np.ptp(actuator.spring.voltage) + 2 * actuator.slip.friction.sum())


def slide(rho, carts, path):
    """Move carts along a path of displacements: an independent implementation."""
    for y in path:
        carts = np.clip(carts, y - rho, y + rho)
    return carts


def make_state(actuator, seed, kind):
    rng = np.random.default_rng([seed, 1])
    rho, knots = actuator.slip.breakaway, actuator.spring.displacement
    y = rng.uniform(knots[0], knots[-1])
    if kind == "relaxed":
        return State(y, np.full(rho.size, y))
    if kind.startswith("turned"):
        return turned(actuator, y, rising=kind.endswith("up"))
    if kind == "extreme":
        return State(y, y + rng.choice([-1, 1], rho.size) * rho)
    if kind == "arbitrary":
        return State(y, y + rng.uniform(-1, 1, rho.size) * rho)
    history = make_path(actuator, y, seed, "walk", 30)
    return State(history[-1], slide(rho, np.full(rho.size, y), history))


def make_path(actuator, start, seed, kind, n):
    """Return n displacements [m]; `start` is where the actuator stands before the first."""
    rng = np.random.default_rng([seed, 2])
    span, knots = span_of(actuator), actuator.spring.displacement
    middle = 0.5 * (knots[0] + knots[-1])
    reach = float(actuator.slip.breakaway[-1]) if len(actuator.slip) else span
    makers = {
        "walk": lambda: start + np.cumsum(rng.normal(scale=span * 10 ** rng.uniform(-2, 0), size=n)),
        "decay": lambda: middle + span * rng.uniform(0.3, 1.5) * _decay(n, rng.uniform(0.5, 3)),
        "repeated": lambda: np.repeat(rng.uniform(knots[0], knots[-1], n), rng.integers(1, 4, n))[:n],
        "constant": lambda: np.full(n, rng.choice([start, knots[0], middle])),
        "jumps": lambda: middle + span * rng.standard_cauchy(n).clip(-20, 20),
        "noisy ramp": lambda: np.linspace(knots[0], knots[-1], n) + span * _noise(rng, n),
        # Turn near the outermost loop in the state's memory: whether the path leaves this loop is a matter of rounding.
        "nested": lambda: start + reach * rng.choice([0.5, 1.5, 2.2, 4.0]) * rng.uniform(-1, 1, n),
        "break points": lambda: _on_break_points(actuator, start, rng, n),
    }
    return makers[kind]()


def _decay(n, power):
    return (1 - np.arange(n) / max(n, 1)) ** power * np.where(np.arange(n) % 2, -1, 1)


def _noise(rng, n):
    return rng.normal(scale=10 ** rng.uniform(-6, -1), size=n)


def _on_break_points(actuator, start, rng, n):
    """Turn where elements begin to slide or segments of the spring meet: compared numbers are nearly equal."""
    hops, path = np.concatenate([2 * actuator.slip.breakaway, [0.0]]), [start]
    for _ in range(n):
        at_knot = rng.choice(actuator.spring.displacement)
        path.append(at_knot if rng.random() < 0.5 else path[-1] + rng.choice([-1, 1]) * rng.choice(hops))
    bits = rng.integers(-2, 3, n) * (rng.random() < 0.5)
    return np.array(path[1:]) * (1 + bits * np.finfo(float).eps)


@st.composite
def motions(draw, bank=None, states=STATE_KINDS, paths=PATH_KINDS, max_samples=120):
    """Draw an actuator, a state of it and a path of displacements [m] from there."""
    actuator = draw(wide_actuators() if bank is None else bank)
    seed = draw(SEEDS)
    state = make_state(actuator, seed, draw(st.sampled_from(states)))
    kind, n = draw(st.sampled_from(paths)), draw(st.integers(0, max_samples))
    return actuator, state, make_path(actuator, state.deformation, seed, kind, n)


def voltages_like(actuator, state, path, seed):
    """Return voltages [V] over the same range as the path's compensation, but other ones."""
    if not len(path):
        return np.zeros(0)
    v = actuator.compensate(path, state=state, extrapolate=True).voltage
    return v + np.random.default_rng([seed, 3]).normal(scale=0.05 * volts_of(actuator)) * (1 + 0 * v)


def make_wider(actuator, seed, *, graded, transformer, creep):
    """Return the actuator with parts of the wider class; graded elements leave every branch 20 % of its slope."""
    rng = np.random.default_rng([seed, 4])
    slip, spring = actuator.slip, actuator.spring
    span, volts, parts = span_of(actuator), float(np.ptp(spring.voltage)), {}
    if graded:
        n, m = len(slip), int(rng.integers(1, 9))
        knots = spring.displacement[0] + span * np.sort(rng.uniform(-0.2, 1.2, m + 1))
        more = 0.8 * spring.slopes.min() / max(n, 1) * rng.uniform(0, 1, (n, m))
        slip = GradedSlip(slip.breakaway, knots, more + rng.choice([0.0, 1.0]) * slip.stiffness[:, None])
    if transformer:
        steps = rng.uniform(0.3, 1.0, int(rng.integers(1, 12)))
        at = spring.voltage[0] + volts * np.append(0, np.cumsum(steps)) / steps.sum()
        rises = np.diff(at) * np.exp(rng.uniform(-0.7, 0.7, steps.size))
        parts["transformer"] = Transformer(at, at[0] + np.append(0, np.cumsum(rises)))
    if creep:
        j = int(rng.integers(1, 20))
        parts["displacement_creep"] = DisplacementCreep(10 ** rng.uniform(-3, 3, j), rng.exponential(0.2 / j, j))
    return Actuator(slip, spring, **parts)


def make_smooth(seed, span, volts, count):
    """Return elements whose lengths lie between a thousandth and ten times the span, some without stiffness."""
    rng = np.random.default_rng([seed, 4])
    closing = rng.choice([0.5, 1.0, rng.uniform(0.5, 1)], count)
    stiffness = volts / span * 10 ** rng.uniform(-2, 1.5, count) * (rng.random(count) < 0.9)
    return SmoothSlip(span * 10 ** rng.uniform(-3, 1, count), closing, stiffness)


def make_time(seed, n):
    """Return n times [s]: even steps, uneven ones, or runs of even ones."""
    rng = np.random.default_rng([seed, 5])
    steps = 10 ** rng.uniform(-3, 1) * np.ones(n)
    kind = rng.integers(3)
    if kind == 1:
        steps *= rng.uniform(0.1, 10, n)
    if kind == 2:
        steps *= np.repeat(rng.uniform(0.1, 10, n), rng.integers(1, 60, n))[:n]
    # Whole multiples of 2^-30 s: their differences are exact, so that even steps are even.
    return np.round((rng.uniform(-10, 10) + np.cumsum(np.ceil(steps * 2.0**30) / 2.0**30)) * 2.0**30) / 2.0**30


@st.composite
def wider_motions(draw, parts=None, max_elements=20, states=STATE_KINDS, max_samples=120):
    """Draw an actuator of the wider class, a state of it, time [s] and a path [m]."""
    plain = draw(actuators(0, max_elements))
    seed, flags = draw(SEEDS), draw(st.tuples(*[st.booleans()] * 4))
    named = dict(zip(("graded", "transformer", "creep", "smooth"), flags, strict=True)) | (parts or {})
    count = draw(st.integers(1, 5)) if named.pop("smooth") else 0
    actuator = make_wider(plain, seed, **named)
    state = make_state(plain, seed, draw(st.sampled_from(states)))
    rng, inner = np.random.default_rng([seed, 6]), {}
    if actuator.displacement_creep is not None:
        strains = 0.1 * span_of(plain) * rng.normal(size=len(actuator.displacement_creep)) * rng.choice([0, 1])
        inner["displacement_creep"] = strains
    if count:
        smooth = make_smooth(seed, span_of(plain), volts_of(plain), count)
        actuator = replace(actuator, smooth=smooth, state=None)
        inner["smooth"] = rng.uniform(-1, 1, count).round(draw(st.integers(0, 3))) * smooth.length
    state = State(state.deformation, state.carts, **inner)
    path = make_path(
        plain, state.deformation, seed, draw(st.sampled_from(PATH_KINDS)), draw(st.integers(0, max_samples))
    )
    return actuator, state, make_time(seed, len(path)), path
