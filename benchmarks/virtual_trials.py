"""Tracking tests of models on virtual actuators: records as on a bench, then a path that is in no record."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from dehyst._types import Array
from dehyst._views.fields import json_values
from dehyst.model import AbstractModel, beginning, simulated, timed
from dehyst.records import Record, largest, percent, rms
from dehyst.virtual import PlayActuator, VirtualActuator
from dehyst.waveforms import Excitation, Sampling, descending_tops, raised_cosine, staircase

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
from truths import BoucWenActuator, PreisachActuator

_SAMPLES_A_FAST_CYCLE = 100
_REVERSALS = 40
# Turning points lie within these parts of the stroke, and a branch is at least this long.
_LOWEST, _HIGHEST, _SHORTEST = 0.02, 0.98, 0.08


class TrackingErrors(NamedTuple):
    """Wanted minus reached displacement [% of the stroke], and excess of the voltage over the recorded range [%]."""

    largest: float
    rms: float
    beyond: float

    def as_dict(self) -> dict[str, float]:
        """Return JSON values."""
        return json_values(self, "largest_percent=largest rms_percent=rms beyond_voltage_percent=beyond")


@dataclass(frozen=True)
class TrackingTrial:
    """One virtual actuator and the rates at which it is driven.

    `truth`: noise seed -> a new actuator. `slow`, `fast`: cycles per second [Hz] of the two records with descending
    tops; each branch of the path takes half a cycle of a rate between them. `hold`: hold at each step of the staircase
    [s].
    """

    name: str
    truth: Callable[[int], VirtualActuator]
    slow: float
    fast: float
    hold: float

    @property
    def _rate(self) -> float:
        return _SAMPLES_A_FAST_CYCLE * self.fast

    def _drive(self, frequency: float) -> Sampling:
        return Sampling(frequency=frequency, sample_rate=self._rate)

    def records(self) -> tuple[Record, ...]:
        """Return training records, in one run: descending tops at both rates and a staircase with steps back."""
        truth, slow, fast = self.truth(0), self._drive(self.slow), self._drive(self.fast)
        tops = [descending_tops(truth.highest, drive=drive) for drive in (slow, fast)]
        stairs = staircase(truth.highest, steps=10, hold=self.hold, back=True, drive=slow)
        return self._played(truth, f"{self.name}-0", *tops, stairs)

    def held_out(self) -> tuple[Record, ...]:
        """Return held-out records: a major loop and loops of other heights, at the slow rate."""
        truth = self.truth(1)
        peaks = [truth.highest, 0.75 * truth.highest, 0.45 * truth.highest]
        return self._played(truth, f"{self.name}-1", raised_cosine(peaks, cycles=2, drive=self._drive(self.slow)))

    def _played(self, truth: VirtualActuator, name: str, *excitations: Excitation) -> tuple[Record, ...]:
        records = []
        for letter, excitation in zip("abc", excitations, strict=False):
            y = truth.play(excitation.voltage, time=excitation.time)
            records.append(Record(excitation.time, excitation.voltage, y, f"{name}{letter}"))
        return tuple(records)

    def track(self, model: AbstractModel, seed: int = 7) -> TrackingErrors:
        """Home model and actuator, compensate a random path of 40 reversals, and play the voltage on the actuator.

        Homing, up to the highest voltage and back, makes the state known; a creeping actuator continues to creep. The
        first branch leads from the end of homing onto the path and does not count. A model with a delay compensates the
        path that much earlier.
        """
        truth = self.truth(1000 + seed)
        homing = raised_cosine(truth.highest, cycles=2, drive=self._drive(self.slow)).voltage
        wanted = truth.stroke * self.path(seed)
        first_branch = int(np.argmax(np.diff(wanted) < 0))
        time = np.arange(homing.size + wanted.size) / self._rate
        voltage = self._sent(model, homing, wanted, time, first_branch)
        reached = truth.play(np.concatenate([homing, voltage]), time=time, measured=False)[homing.size :]
        error = (wanted - reached)[first_branch:]
        beyond = max(float(voltage.max()) - truth.highest, -float(voltage.min()), 0.0)
        figures = percent(largest(error), truth.stroke), percent(rms(error), truth.stroke)
        return TrackingErrors(*figures, percent(beyond, truth.highest))

    def _sent(self, model: AbstractModel, homing: Array, wanted: Array, time: Array, first_branch: int) -> Array:
        """Return the voltage for homing and path, which are compensated in one piece to avoid a jump."""
        homed = simulated(model, homing, time[: homing.size]).displacement
        when = time[homing.size :]
        delay = float(getattr(model, "delay", 0.0))
        ahead = np.asarray(CubicSpline(when, wanted)(np.minimum(when + delay, when[-1])))
        # Begin at the model's own displacement after homing.
        ahead[:first_branch] += (homed[-1] - ahead[0]) * (1 - _smooth(np.arange(first_branch) / first_branch))
        path, start = np.concatenate([homed, ahead]), beginning(model, homing)
        return model.compensate(path, state=start, **timed(model, time)).voltage[homing.size :]

    def path(self, seed: int = 7) -> Array:
        """Return a path of 40 reversals from 0, in parts of the stroke, with no velocity or acceleration at a turn."""
        rng = np.random.default_rng(seed)
        turns = [0.0]
        while len(turns) < _REVERSALS + 2:
            here, rising = turns[-1], len(turns) % 2 == 1
            room = (here + _SHORTEST, _HIGHEST) if rising else (_LOWEST, here - _SHORTEST)
            if room[0] >= room[1]:
                turns.pop()
                continue
            turns.append(float(rng.uniform(*room)))
        branches = [np.zeros(1)]
        for a, b in pairwise(turns):
            seconds = 0.5 / float(np.exp(rng.uniform(np.log(self.slow), np.log(self.fast))))
            n = max(8, round(seconds * self._rate))
            branches.append(a + (b - a) * _smooth(np.arange(1, n + 1) / n))
        return np.concatenate(branches)


def _smooth(u: Array) -> Array:
    """Return a curve from 0 to 1 with no velocity or acceleration at either end."""
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


TRIALS: Mapping[str, TrackingTrial] = {
    "play": TrackingTrial("play", lambda seed: PlayActuator(seed=seed), 0.01, 0.05, 20.0),
    "creep": TrackingTrial("creep", lambda seed: PlayActuator(seed=seed, creep=0.01), 0.01, 0.05, 20.0),
    "preisach": TrackingTrial("preisach", lambda seed: PreisachActuator(seed=seed), 0.01, 0.05, 20.0),
    "boucwen": TrackingTrial("boucwen", lambda seed: BoucWenActuator(seed=seed), 6.0, 60.0, 0.05),
}
