"""Truths that are no model of ours: their records for identification, and how well a model makes them follow a path."""

from itertools import pairwise

import numpy as np

from dehyst import Record

VOLTS = 200.0


def cosine(turns, samples):
    """Values through turning points, half a cosine of so many samples for each branch."""
    u = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples + 1) / samples)
    return np.concatenate([[float(turns[0])], *(a + (b - a) * u for a, b in pairwise(turns))])


def tops(steps, samples):
    """Voltages: two major loops, then tops that descend to naught, each branch as long as the others."""
    lower = [VOLTS * (1 - k / steps) for k in range(steps)]
    return cosine([0, *([VOLTS, 0] * 2), *(v for top in lower for v in (top, 0))], samples)


def staircase(step, samples, hold):
    """Voltages two steps up, one down, until the top, and the mirror image back; a hold after each."""
    levels = [0.0]
    while levels[-1] < VOLTS:
        levels.append(min(levels[-1] + 2 * step, VOLTS))
        if levels[-1] < VOLTS:
            levels.append(levels[-1] - step)
    levels += [VOLTS - level for level in levels][1:]
    path = cosine(levels, samples)
    branches = np.split(path[1:], np.arange(samples, path.size - 1, samples))
    return np.concatenate([path[:1], *(np.append(branch, np.full(hold, branch[-1])) for branch in branches)])


def records(truth, step, fast, slow, hold, steps=20):
    """Descending tops at two speeds and a staircase, one after the other: cycles of so many seconds."""
    played = (
        tops(steps, round(fast / step / 2)),
        tops(10, round(slow / step / 2)),
        staircase(25, round(fast / step / 4), round(hold / step)),
    )
    found, begin = [], 0.0
    for name, v in zip(("fast", "slow", "staircase"), played, strict=True):
        time = begin + np.arange(v.size) * step
        found.append(Record(time, v, truth.play(v, time=time), name))
        begin = time[-1] + step
    return found


def wanted(lowest, stroke, samples, seed, branches=40):
    """A random path [m] from the middle of the stroke."""
    rng, turns = np.random.default_rng(seed), [0.5]
    for k in range(branches):
        a = turns[-1]
        turns.append(rng.uniform(min(a + 0.05, 0.96), 0.97) if k % 2 == 0 else rng.uniform(0.03, max(a - 0.05, 0.04)))
    return lowest + stroke * cosine(turns, samples)


def tracked(actuator, truth, learnt, step, period, seed=3):
    """Largest and RMS error in % of the stroke of a random path, compensated by the model and played into the truth.

    Both begin relaxed and are homed by a major loop; the path is sent earlier by the delay that the model knows.
    """
    from scipy.interpolate import CubicSpline

    lowest = min(float(record.displacement[len(record) // 4 :].min()) for record in learnt)
    stroke = max(float(record.displacement.max()) for record in learnt) - lowest
    samples, slow = round(period / step / 2), 4 if actuator.dynamics else 1
    truth.relax()
    homing = cosine([0, VOLTS, 0, VOLTS, VOLTS / 2], slow * samples)
    time = np.arange(homing.size) * step
    truth.play(homing, time=time, measured=False)
    state = actuator.simulate(homing, time=time, state=actuator.relaxed()).state
    path = wanted(lowest, stroke, samples, seed)
    now = actuator.displacement(state)
    path = np.concatenate([cosine([now, path[0]], slow * samples)[:-1], path])
    time = time[-1] + np.arange(path.size) * step
    ahead = CubicSpline(time, path)(np.minimum(time + actuator.delay, time[-1]))
    v = actuator.compensate(ahead, time=time, state=state).voltage
    made = truth.play(np.clip(v, 0, VOLTS)[1:], time=time[1:], measured=False)
    error = 100 * (made - path[1:]) / stroke
    return float(np.abs(error).max()), float(np.sqrt(np.mean(error**2)))
