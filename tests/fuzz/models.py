"""Mutated model files: what loads must simulate, compensate, step, follow a path and go on from a snapshot, in numbers.

What does not is refused by a `DehystError` of one sentence. Voltages that leave lie within limits and slew rate.
"""

import copy
import json
import random
import sys
import tempfile
import warnings
from functools import cache
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "support")]

import sanitized

sanitized.lay_over()

import batches
import numpy as np
import specimens
import strategies

from dehyst import Actuator, Compensator, DehystError, Snapshot
from dehyst.control import following

HUGE = (1e308, -1e308, 1.7e308, 1e300, 1e30, -1e30, 10**400, -(10**30), 1e15, -1e15)
TINY = (5e-324, 1e-300, 1e-30, 1e-15, 0, -0.0)
VALUES = (*HUGE, *TINY, -1, 1, 0.5, 1e5, True, False, None, "1", "nan", [], {}, [1])
FACTORS = (-1, 2, 0.5, 1e3, 1e-3, 1 + 1e-15, 1 + 1e-9, 1e30, 1e-30, 1e150, 1e-150, 0)
SHARED = (1e-12, 1e12, 1e25, 1e-25, 1e150, 1e-150, -1, 1e280, 1e-280)
SAMPLES, STEP = 200, 1e-3


@cache
def bases():
    """Model files of every kind, as JSON values."""
    rng, found = np.random.default_rng(0), []
    for kind in (*sorted(set(specimens.KINDS)), "plain", "all", "all", "wide", "wide"):
        actuator = specimens.random_model(rng, kind)
        low, high = (float(v) for v in actuator.spring.voltage[[0, -1]])
        data = json.loads(json.dumps(actuator.as_dict()))
        found.append({**data, "limits": {"voltage_V": [low, high]}, "load_stiffness_N_per_m": 1e6})
    return found


def mutated(data, rng):
    """The data with one to three things changed."""
    data = copy.deepcopy(data)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        places = [place for place in _places(data) if place]
        leaves = [place for place in places if not isinstance(_at(data, place), (dict, list))]
        place = rng.choice(leaves if rng.random() < 0.7 else places)
        _mutate(_at(data, place[:-1]), place[-1], rng)
    return data


def _places(data, place=()):
    yield place
    entries = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in entries:
        yield from _places(value, (*place, key))


def _at(data, place):
    for key in place:
        data = data[key]
    return data


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _times(value, factor):
    """A product; whole numbers may be too large for a float already."""
    return value * factor if abs(value) <= sys.float_info.max else value


def _mutate(parent, key, rng):
    value, kind = parent[key], rng.random()
    if kind < 0.35:
        parent[key] = rng.choice(VALUES)
    elif kind < 0.65 and _is_number(value):
        parent[key] = _times(value, rng.choice(FACTORS))
    elif kind < 0.75:
        del parent[key]
    elif kind < 0.85:
        if isinstance(parent, list):
            parent.insert(key, value)
        else:
            parent["x" + key] = value
    elif kind < 0.95 and isinstance(value, list) and value:
        if rng.random() < 0.5:
            rng.shuffle(value)
        else:
            factor = rng.choice(SHARED)
            parent[key] = [_times(x, factor) if _is_number(x) else x for x in value]
    else:
        parent[key] = rng.choice(VALUES)


def damaged_text(text, rng):
    """Now and then the text itself."""
    kind = rng.random()
    if kind < 0.03:
        return text.replace("}", ', "name": "b"}', 1)
    if kind < 0.05:
        return text[: rng.randrange(len(text))]
    if kind < 0.06:
        return "[" * 100000 + text
    if kind < 0.07:
        return text.replace(": 1", ": Infinity", 1)
    return "\ufeff" + text if kind < 0.08 else text


class Trial:
    """A model that has been loaded, used in every way."""

    def __init__(self, actuator, rng, note, folder):
        self.actuator, self.note, self.folder = actuator, note, folder
        self.rng, self.numbers = rng, np.random.default_rng(rng.randrange(2**32))
        self.low, self.high = actuator.limits or (float(v) for v in actuator.spring.voltage[[0, -1]])
        self.change = (self.high - self.low) * 50 * STEP
        self.time = np.arange(SAMPLES) * STEP
        self.findings = []

    def use(self):
        """What is wrong; what is refused is noted."""
        for use in (self.simulate, self.compensate, self.step, self.follow, self.go_on, self.come_back):
            try:
                use()
            except DehystError:
                self.note(f"{use.__name__}: refused")
        return self.findings

    @property
    def course(self):
        return {"time": self.time}

    @property
    def path(self):
        span = strategies.span_of(self.actuator)
        return self.actuator.spring.displacement[0] + span * self.numbers.uniform(0, 1, SAMPLES)

    def simulate(self):
        voltage = self.low + (self.high - self.low) * self.numbers.uniform(0, 1, SAMPLES)
        if not np.isfinite(self.actuator.simulate(voltage, **self.course).displacement).all():
            self.findings.append("simulate: not finite")

    def compensate(self):
        if not np.isfinite(self.actuator.compensate(self.path, **self.course).voltage).all():
            self.findings.append("compensate: not finite")

    def compensator(self):
        preview = self.rng.random() < 0.2
        return Compensator(self.actuator, (self.low, self.high), self.change / STEP, period=STEP, preview=preview)

    def step(self):
        self.steps(self.compensator(), "step")

    def steps(self, loop, what):
        before = loop.voltage
        for wanted in self.path.tolist():
            voltage = loop.step(wanted)
            if not self.low <= voltage <= self.high:
                self.findings.append(f"{what}: {voltage!r} outside {self.low!r} to {self.high!r}")
            if abs(voltage - before) > self.change * (1 + 1e-9) + 1e-12 * (abs(self.low) + abs(self.high)):
                self.findings.append(f"{what}: changes by {abs(voltage - before)!r}, {self.change!r} are allowed")
            before = voltage
        if not np.isfinite(loop.state.deformation):
            self.findings.append(f"{what}: the state is no number")
        repr(loop)

    def follow(self):
        command = following.follow(self.compensator(), self.path, time=self.time)
        voltage = command.voltage
        if not (np.isfinite(voltage).all() and voltage.min() >= self.low and voltage.max() <= self.high):
            self.findings.append("trajectory: outside the limits")
        if not np.isfinite(command.displacement).all():
            self.findings.append("trajectory: a displacement that is no number")
        most = self.change * (1 + 1e-6) + 1e-12 * (abs(self.low) + abs(self.high))
        if (np.abs(np.diff(voltage)) > most).any():
            self.findings.append("trajectory: over the slew rate")

    def go_on(self):
        """From a snapshot that was mutated too."""
        loop, path = self.compensator(), self.folder / "loop.json"
        loop.snapshot().save(path)
        path.write_text(json.dumps(mutated(json.loads(path.read_text()), self.rng)))
        other = loop._clone()
        other.restore(Snapshot.load(path))
        self.note("restored")
        self.steps(other, "after a snapshot")

    def come_back(self):
        """Saved and loaded it is the same."""
        path = self.folder / "again.json"
        self.actuator.save(path)
        if json.dumps(Actuator.load(path).as_dict()) != json.dumps(self.actuator.as_dict()):
            self.findings.append("another model after save and load")
        repr(self.actuator)


def play(seed, case, note):
    """One mutated file."""
    rng = random.Random(f"{seed}-{case}")
    text = damaged_text(json.dumps(mutated(rng.choice(bases()), rng)), rng)
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = Path(name) / "model.json"
        path.write_text(text)
        try:
            actuator = Actuator.load(path)
        except DehystError:
            note("refused at load")
            return []
        note("loaded")
        return Trial(actuator, rng, note, Path(name)).use()


if __name__ == "__main__":
    batches.main("models", play)
