"""A virtual stage that creeps and resonates, and the model identified from its records: for `loop.py`."""

from __future__ import annotations

import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine, staircase

PERIOD = 1e-4
HIGHEST = 200.0
SLOW, FAST, HOLD = 2.0, (30.0, 90.0), 0.5


class Stage:
    """Play operators that creep, seen behind a delay and a resonance; a sample every PERIOD.

    ``y'' + 2 zeta omega y' + omega^2 y = omega^2 p(t - delay)``, p what `PlayActuator` does with the voltage, taken to
    be linear between samples; the delay is whole samples. dehyst's model has stops of the displacement and viscous
    branches where this has plays of the voltage and an asymmetric map: it is no instance of it.
    """

    resonance, damping, late = 300.0, 0.03, 2
    highest = HIGHEST

    def __init__(self, seed: int = 0, noise: float = 2e-9) -> None:
        self.slow = PlayActuator(highest=HIGHEST, creep=0.01, plays=100, seed=seed, noise=0.0)
        self.stroke = self.slow.stroke
        self.sensor = np.random.default_rng(seed)
        self.noise = noise
        self.samples = 0
        start = float(self.slow.play(np.zeros(2), time=np.array([-2, -1]) * PERIOD)[-1])
        self.under_way = [start] * (self.late + 2)
        self.motion = (start, 0.0)
        omega = 2 * np.pi * self.resonance
        free = dehyst.Dynamics(omega, self.damping).transitions(np.array([PERIOD]), 0.0)[0].tolist()
        self.phi, self.before, self.after = free[:4], free[4:6], free[6:]

    def play(self, voltage: np.ndarray) -> np.ndarray:
        """Displacement (n,) [m] as it is, for voltages (n,) [V] that follow those before; see `measured`."""
        at = PERIOD * np.arange(self.samples, self.samples + voltage.size)
        self.samples += voltage.size
        pushed = self.slow.play(voltage, time=at, measured=False)
        return np.array([self._swung(p) for p in pushed.tolist()])

    def measured(self, displacement: np.ndarray) -> np.ndarray:
        """Return the displacement with the sensor's noise."""
        return displacement + self.noise * self.sensor.standard_normal(np.shape(displacement))

    def _swung(self, pushed: float) -> float:
        self.under_way = [*self.under_way[1:], pushed]
        old, new = self.under_way[:2]
        y, rate = self.motion
        a, b, c, d = self.phi
        self.motion = (
            a * y + b * rate + self.before[0] * old + self.after[0] * new,
            c * y + d * rate + self.before[1] * old + self.after[1] * new,
        )
        return self.motion[0]


def records(seed: int = 0) -> list[dehyst.Record]:
    """Descending tops at three speeds and a staircase that turns back at every level, in one run.

    The slow ones are kept at every tenth sample: more would outweigh those in which the stage swings.
    """
    stage, made = Stage(seed), []
    runs = {
        f"{one:g} Hz": (descending_tops(HIGHEST, drive=driven(one)), 10 if one == SLOW else 1) for one in (SLOW, *FAST)
    }
    runs["staircase"] = staircase(HIGHEST, steps=10, hold=HOLD, back=True, drive=driven(SLOW)), 10
    for name, (one, every) in runs.items():
        y = stage.measured(stage.play(one.voltage))
        made.append(dehyst.Record(one.time[::every], one.voltage[::every], y[::every], name))
    return made


def homing() -> np.ndarray:
    """Twice to the highest voltage and back [V]: after it the state is known."""
    return raised_cosine(HIGHEST, cycles=2, drive=driven(SLOW)).voltage


def driven(frequency: float) -> Sampling:
    return Sampling(frequency=frequency, sample_rate=1 / PERIOD)
