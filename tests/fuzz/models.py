"""Mutated model files: what loads must simulate, compensate, step and follow a path, in numbers.

A file that does not load is refused by a `DehystError` of one sentence. All voltages lie within limits and slew rate.
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
from compensators import Life

from dehyst import Actuator, Compensator, DehystError
from dehyst.model import needs_time

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
        found.append({**data, "limits_V": [low, high], "load_stiffness_N_per_m": 1e6})
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


def use(actuator, rng, note, folder):
    """Use a model that has been loaded in every way; return what is wrong. What is refused is noted."""
    dice, findings = np.random.default_rng(rng.randrange(2**32)), []
    limits = actuator.limits or tuple(float(v) for v in actuator.spring.voltage[[0, -1]])
    clock = {"time": np.arange(SAMPLES) * STEP} if needs_time(actuator) else {}

    def simulate():
        voltage = dice.uniform(*limits, SAMPLES)
        return np.isfinite(actuator.simulate(voltage, **clock).displacement).all()

    def compensate():
        path = actuator.spring.displacement[0] + strategies.span_of(actuator) * dice.uniform(0, 1, SAMPLES)
        return np.isfinite(actuator.compensate(path, **clock).voltage).all()

    def begun():
        slew, preview = (limits[1] - limits[0]) * 50, rng.random() < 0.2
        loop = Compensator(actuator, limits, slew, period=STEP, preview=preview)
        return Life(dice, loop, "mutated", note, findings)

    def step():
        life = begun()
        for _ in range(SAMPLES):
            life.step()
        life.finite(life.compensator)
        return bool(repr(life.compensator))

    def follow():
        begun().trajectory()
        return True

    def come_back():
        """Saved and loaded it is the same."""
        actuator.save(folder / "again.json")
        again = Actuator.load(folder / "again.json")
        return json.dumps(again.as_dict()) == json.dumps(actuator.as_dict()) and bool(repr(actuator))

    for way in (simulate, compensate, step, follow, come_back):
        try:
            if not way():
                findings.append(f"{way.__name__}: not finite, or not the same")
        except DehystError:
            note(f"{way.__name__}: refused")
    return findings


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
        return use(actuator, rng, note, Path(name))


if __name__ == "__main__":
    batches.main("models", play)
