"""Voltages that are played for an identification, and the random path that is tracked afterwards."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Part:
    """One record: u (n,), the voltage as a part of its range; and its speed, in slow periods a period."""

    u: Array
    speed: float = 1.0


@dataclass(frozen=True)
class Protocol:
    """A way to excite: `parts(rng, fast)` gives the records, `samples` is their number in a period."""

    name: str
    parts: Callable[[np.random.Generator, float], list[Part]]
    samples: int = 200


def through(turns: Sequence[float], samples: Sequence[int]) -> Array:
    """Return cosines from turn to turn, each of so many samples."""
    branches = [np.array([turns[0]])]
    for (a, b), n in zip(pairwise(turns), samples, strict=True):
        branches.append(a + (b - a) * (0.5 - 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)))
    return np.concatenate(branches)


def _cycles(turns: Sequence[float], samples: int = 200) -> list[Part]:
    return [Part(through(turns, [samples // 2] * (len(turns) - 1)))]


def _tops(samples: int, tops: Sequence[float]) -> list[Part]:
    return _cycles([0.0, *(turn for top in (1.0, 1.0, *tops) for turn in (top, 0.0))], samples)


def _descending(rng: np.random.Generator, fast: float) -> list[Part]:
    return _tops(200, np.linspace(0.95, 0.1, 12).tolist())


def _sparse(rng: np.random.Generator, fast: float) -> list[Part]:
    return _tops(60, np.linspace(0.97, 0.1, 33).tolist())


def _staircase(rng: np.random.Generator, fast: float) -> list[Part]:
    """Two major loops, then steps up and down, each moved along within 20 samples and held for 80."""
    levels = [*np.linspace(0, 1, 11), *np.linspace(0.9, 0, 10), *np.linspace(0.2, 0.8, 4), *np.linspace(0.6, 0.0, 4)]
    pieces = [through([0.0, 1.0, 0.0, 1.0, 0.0], [100] * 4)]
    for a, b in pairwise(levels):
        pieces += [through([a, b], [20])[1:], np.full(80, b)]
    return [Part(np.concatenate(pieces))]


def _reversal_curves(rng: np.random.Generator, fast: float) -> list[Part]:
    return _cycles([0.0, 1.0, 0.0, 1.0, *(turn for low in np.linspace(0.9, 0.0, 12) for turn in (low, 1.0)), 0.0])


def _growing(rng: np.random.Generator, fast: float) -> list[Part]:
    halves = np.linspace(0.04, 0.5, 16)
    return _cycles([0.5, *(0.5 + side * half for half in halves for side in (1, -1))], 180)


def _decaying(rng: np.random.Generator, fast: float) -> list[Part]:
    halves = np.linspace(0.5, 0.03, 16)
    return _cycles([0.0, *(0.5 + side * half for half in halves for side in (1, -1)), 0.5], 180)


def _random(rng: np.random.Generator, fast: float) -> list[Part]:
    turns = [0.0, 1.0, 0.0, 1.0, 0.0, *random_turns(rng, 30), 0.0]
    return [Part(through(turns, branch_samples(turns, 200)))]


def _two_speeds(rng: np.random.Generator, fast: float) -> list[Part]:
    return [Part(_tops(200, np.linspace(0.9, 0.1, 9).tolist())[0].u, speed) for speed in (1.0, fast)]


def random_turns(rng: np.random.Generator, count: int, low: float = 0.0, high: float = 1.0) -> list[float]:
    """Return turning points that alternate, branches of at least 0.08, the first one a top."""
    turns: list[float] = [low]
    while len(turns) <= count:
        rising = len(turns) % 2 == 1
        room = (turns[-1] + 0.08, high) if rising else (low, turns[-1] - 0.08)
        if room[0] < room[1]:
            turns.append(float(rng.uniform(*room)))
        else:
            turns.pop()
    return turns[1:]


def branch_samples(turns: Sequence[float], samples: int) -> list[int]:
    """Return the samples of each branch: half a period for a long one, less for a short one."""
    return [max(8, round(0.5 * samples * (0.3 + 0.7 * abs(b - a)))) for a, b in pairwise(turns)]


def path(rng: np.random.Generator, samples: int, speeds: Sequence[float]) -> Array:
    """Return a path from 0 through 24 turns between 0.03 and 0.96, with no velocity or acceleration at a turn.

    Each branch has the speed of one of the records.
    """
    turns = [0.0, *random_turns(rng, 24, 0.03, 0.96)]
    branches = [np.zeros(1)]
    for (a, b), n in zip(pairwise(turns), branch_samples(turns, samples), strict=True):
        count = max(8, round(n * float(rng.choice(speeds))))
        w = np.arange(1, count + 1) / count
        branches.append(a + (b - a) * w**3 * (10 - 15 * w + 6 * w**2))
    return np.concatenate(branches)


PROTOCOLS = {
    protocol.name: protocol
    for protocol in (
        Protocol("tops", _descending),
        Protocol("staircase", _staircase),
        Protocol("curves", _reversal_curves),
        Protocol("growing", _growing, 180),
        Protocol("decaying", _decaying, 180),
        Protocol("random", _random),
        Protocol("sparse", _sparse, 60),
        Protocol("speeds", _two_speeds),
    )
}
