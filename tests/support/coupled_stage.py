"""Records of virtual stages with coupled axes."""

import numpy as np
from truths import PreisachActuator

from dehyst.records import Record
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, stage_excitation

COUPLING = np.array([[1.0, 0.04], [-0.03, 1.0]])
HIGHEST = (100.0, 120.0)


def actuators():
    return PlayActuator(stroke=16e-6, highest=100.0, noise=0.0), PreisachActuator(
        stroke=20e-6, highest=120.0, noise=0.0
    )


def played(time, voltage, seed=0, coupling=COUPLING, noise=3e-9):
    """Return a record of two axes after one cycle of both."""
    rise = np.sin(np.linspace(0, np.pi, 200)[:, None]) ** 2 * np.array(HIGHEST)
    both, moved = np.vstack([rise, voltage]), []
    for j, actuator in enumerate(actuators()):
        moved.append(actuator.play(both[:, j], measured=False)[len(rise) :])
    y = np.column_stack(moved) @ coupling.T
    return Record(time, voltage, y + np.random.default_rng(seed).normal(0, noise, y.shape))


def excited(seed=0, *, steps=8, cycles=8, base=(0.0, 0.0), **options):
    drive = [Sampling(0.5, sample_rate=50.0, base=volts) for volts in base]
    found = stage_excitation(HIGHEST, drive=drive, steps=steps, cycles=cycles, seed=seed)
    return played(found.time, found.voltage, seed, **options), found
