"""Records of a synthetic production line in one Parquet file, with a table of what each of them is.

The healthy actuators are plays, Preisach relays and Bouc-Wen: none is an instance of an identified model. Beside them
are dead, noisy, drifting and duplicated records, and serials that age from session to session.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow
import pyarrow.parquet

from dehyst.virtual import BoucWenActuator, PlayActuator, PreisachActuator

SESSIONS = 4
# Shares of the records; the rest is healthy.
SHARES = {"dead": 0.04, "noisy": 0.04, "drifting": 0.04, "duplicate": 0.03}
# Share of the serials that age, and what a session changes: gain and width.
AGEING, GAIN_A_SESSION, WIDTH_A_SESSION = 0.04, -0.015, 0.04
HIGHEST, PERIOD = 200.0, 1e-3
NOISE = 2e-9
# Samples of a cycle, of which a record has eight.
SAMPLES = (120, 260)


@dataclass(frozen=True)
class Unit:
    """One actuator: its mechanism, and how far its gain and its width are from the mean."""

    mechanism: str
    gain: float
    width: float
    bend: float

    def actuator(self, session: int, ageing: bool, seed: int, noise: float):
        """Return it as it is at a session."""
        gain = self.gain + (GAIN_A_SESSION * session if ageing else 0.0)
        width = self.width * (1 + (WIDTH_A_SESSION * session if ageing else 0.0))
        common = {"stroke": 16e-6 * gain, "highest": HIGHEST, "noise": noise, "seed": seed}
        if self.mechanism == "play":
            return PlayActuator(width=0.55 * width, bend=0.12 * self.bend, plays=120, **common)
        if self.mechanism == "preisach":
            return PreisachActuator(reversible=1 - 0.45 * width, bend=0.15 * self.bend, **common)
        return BoucWenActuator(lag=0.075 * width, bend=0.10 * self.bend, **common)


def make(path: Path, count: int, seed: int = 1, samples: tuple[int, int] = SAMPLES) -> list[dict]:
    """Write `count` records to a Parquet file, and the truth beside it; return the truth, one entry a record.

    `samples`: range of the samples of a cycle.
    """
    random = np.random.default_rng(seed)
    kinds = kinds_of(count, random)
    units = [
        Unit(("play", "preisach", "boucwen")[k % 3], *(1 + 0.03 * random.standard_normal(3)))
        for k in range(-(-count // SESSIONS))
    ]
    schema = pyarrow.schema(
        [("serial", pyarrow.string()), ("session", pyarrow.int64())]
        + [(name, pyarrow.float64()) for name in ("time_s", "voltage_V", "displacement_um")]
    )
    truth, healthy = [], []
    with pyarrow.parquet.ParquetWriter(path, schema) as writer:
        for position, kind in enumerate(kinds):
            serial, session = divmod(position, SESSIONS)
            if kind == "duplicate":
                source, columns = healthy[int(random.integers(len(healthy)))]
            else:
                source, columns = position, record(units[serial], session, kind, random, samples)
            if kind == "healthy" and len(healthy) < 200:
                healthy.append((position, columns))
            truth.append(
                {
                    "serial": f"S{serial:05d}",
                    "session": session,
                    "kind": kind,
                    "mechanism": units[serial].mechanism,
                    "source": source,
                }
            )
            keys = [[f"S{serial:05d}"] * columns[0].size, [session] * columns[0].size]
            writer.write_table(pyarrow.table([*keys, *columns], schema=schema))
    path.with_suffix(".truth.json").write_text(json.dumps(truth))
    return truth


def kinds_of(count: int, random: np.random.Generator) -> list[str]:
    """Return the kind of each record; ageing serials are whole, the others are mixed."""
    kinds = np.full(count, "healthy", dtype=object)
    serials = count // SESSIONS
    for serial in random.choice(serials, max(1, round(AGEING * serials)), replace=False):
        kinds[SESSIONS * serial : SESSIONS * (serial + 1)] = "ageing"
    # The first records are healthy, so that there is something to duplicate.
    free = random.permutation(np.flatnonzero(kinds == "healthy")[3:])
    for kind, share in SHARES.items():
        some, free = np.split(free, [max(1, round(share * count))])
        kinds[some] = kind
    return list(kinds)


def record(
    unit: Unit, session: int, kind: str, random: np.random.Generator, samples: tuple[int, int]
) -> tuple[np.ndarray, ...]:
    """Return time [s], voltage [V] and displacement [um] of one measurement."""
    v = voltage(int(random.integers(*samples)))
    t = PERIOD * np.arange(v.size)
    noise = NOISE * float(np.exp(0.1 * random.standard_normal()))
    if kind == "noisy":
        noise *= float(random.uniform(10, 40))
    seed = int(random.integers(1 << 31))
    if kind == "dead":
        return t, v, 1e6 * noise * random.standard_normal(v.size) + float(random.uniform(-1, 1))
    y = 1e6 * unit.actuator(session, kind == "ageing", seed, noise).play(v, time=t)
    if kind == "drifting":
        y = y + float(random.choice([-1, 1]) * random.uniform(0.02, 0.06)) * np.ptp(y) * t / t[-1]
    return t, v, y


def voltage(samples: int) -> np.ndarray:
    """Return two cycles through all voltages, three with descending tops, and three that hang from the top [V]."""
    turns = [0, 1, 0, 1, 0, 0.8, 0, 0.6, 0, 0.4, 0, 1, 0.3, 1, 0.6, 1, 0]
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, samples // 2 + 1) / (samples // 2))
    parts = [a + (b - a) * rise for a, b in pairwise(turns)]
    return HIGHEST * np.concatenate([[0.0], *parts])
