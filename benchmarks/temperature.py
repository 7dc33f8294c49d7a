"""Records at three temperatures, simulated at two between and one beyond. Writes `temperature.json`.

Actuators with mechanisms that the model does not have; their gain changes by -0.25 % per kelvin, and they expand by 8
nm per kelvin. "Curved": the gain has a quadratic part too, of 20 ppm a kelvin squared, and the loop becomes wider by
0.5 % a kelvin, which no part of the model describes. Each record warms by 1 K. Compared are a model with the
temperature channel, a model without it, and a model of records at 20 degrees Celsius at that temperature; and the
promise for each path with and without its temperature.
"""

import json
import sys
from pathlib import Path

import numpy as np

import dehyst
from dehyst import Record
from dehyst.model.promise import promise

sys.path.insert(0, str(Path(__file__).resolve().parent))
from strangers.protocols import through
from strangers.truths import TRUTHS

GAIN, EXPANSION, NEUTRAL = -2.5e-3, 8e-9, 20.0
QUADRATIC, WIDER = 2e-5, 5e-3
TRAINED, HELD_OUT, BEYOND, WARMS = (15.0, 30.0, 45.0), (22.0, 38.0), 55.0, 1.0
NAMES = ("relays", "stribeck", "bristles")
OUTPUT = Path(__file__).with_suffix(".json")


def record(truth, first: float, last: float, seed: int, *, channel: bool = True, curved: bool = False) -> Record:
    """Return random turns of a new actuator, after two major loops."""
    random = np.random.default_rng(seed)
    turns = [0.0, 1.0, 0.0, 1.0, 0.0, *random.uniform(0, 1, 24), 0.0]
    u = through(turns, [200] * (len(turns) - 1))
    degrees = np.linspace(first, last, u.size)
    y, kelvins = truth.stroke * truth.mechanism().play(u, np.full(u.size, 1 / 400)), degrees - NEUTRAL
    gain = 1 + GAIN * kelvins
    if curved:
        gain = gain + QUADRATIC * kelvins**2
        y = y + WIDER * kelvins * (y - truth.stroke * u)
    y = gain * y + EXPANSION * kelvins + random.normal(0, 1e-4 * truth.stroke, u.size)
    others = {"temperature_C": degrees + random.normal(0, 0.05, u.size)} if channel else {}
    voltage = truth.low + (truth.high - truth.low) * u
    return Record(truth.period / 400 * np.arange(u.size), voltage, y, f"{first:g} degC, {seed}", others=others)


def missed(actuator: dehyst.Actuator, measured: Record, temperature=None) -> float:
    """Return the largest error [% of the stroke] after the first two loops, without its mean."""
    options = {"temperature": temperature} if temperature is not None else {}
    options |= {"time": measured.time}
    error = (measured.displacement - actuator.simulate(measured.voltage, **options).displacement)[800:]
    return float(100 * np.abs(error - error.mean()).max() / measured.stroke)


def promised(actuator: dehyst.Actuator, measured: Record, temperature=None) -> float:
    """Return the largest error [% of the stroke] that the model promises for a path, at a temperature or without."""
    found = promise(
        actuator.identification.validity,
        measured.voltage,
        measured.time,
        thermal=actuator.thermal,
        temperature=temperature,
    )
    return float(100 * found.largest / measured.stroke)


def case(name: str, *, curved: bool) -> dict[str, object]:
    truth = TRUTHS[name]

    def records(channel: bool, constant: bool = False) -> list[Record]:
        at = [(NEUTRAL, NEUTRAL)] * 3 if constant else [(t, t + WARMS) for t in TRAINED]
        return [record(truth, *ends, seed, channel=channel, curved=curved) for seed, ends in enumerate(at, 1)]

    known, unknown, constant = (dehyst.identify(r) for r in (records(True), records(False), records(False, True)))
    found = {
        "truth": f"{name}, curved" if curved else name,
        "constant": missed(constant.actuator, record(truth, NEUTRAL, NEUTRAL, 9, channel=False)),
    }
    for degrees in (*HELD_OUT, BEYOND):
        new = record(truth, degrees, degrees + WARMS, 9, curved=curved)
        found[f"with, {degrees:g}"] = missed(known.actuator, new, new.temperature)
        found[f"promised, {degrees:g}"] = promised(known.actuator, new, new.temperature)
        found[f"without, {degrees:g}"] = missed(unknown.actuator, new)
        found[f"unknown, {degrees:g}"] = missed(known.actuator, new)
        found["promised unknown"] = promised(known.actuator, new)
    found["promised with"] = known.promise.largest_percent
    found["promised without"] = unknown.promise.largest_percent
    found["gain"] = None if known.actuator.thermal is None else known.actuator.thermal.gain
    return found


def main() -> None:
    rows = [case(name, curved=curved) for curved in (False, True) for name in NAMES]
    OUTPUT.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    print(*rows, sep="\n")


if __name__ == "__main__":
    main()
