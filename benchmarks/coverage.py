"""How often intervals of `dehyst insight` hold the truth. Writes `coverage.json`.

Stiffnesses, spring and a prediction of a plant that is an instance of the model: it is recorded again and again,
descending tops with sensor noise; each record is identified, and 90 % intervals come from resampled cycles. They should
contain the true number 90 times in a hundred. Truths that are no instance of the model are those of `promise.py`.

    python benchmarks/coverage.py
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

import dehyst
from dehyst.trust.bootstrap import resample
from dehyst.trust.evidence import Evidence

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))
sys.path.insert(0, str(Path(__file__).resolve().parent))
import plain_records

OUTPUT = Path(__file__).with_suffix(".json")
REPEATS = 200
LEVEL = 0.9
# 2 nm on a stroke of 16 um, and four times that.
NOISES = (1.25e-4, 5e-4)
RECORDED = (1, 0, *(turn for top in (1, 0.8, 0.6, 0.4, 0.2) for turn in (top, 0, top, 0)))
PREDICTED = (1, 0.1, 0.85, 0.3, 0.7, 0.45, 0.9, 0.2, 0.5)


def coverage(
    elements: int = 5,
    norm: str = "l2",
    noise: float = NOISES[0],
    *,
    repeats: int = REPEATS,
    resamples: int = 100,
    samples: int = 100,
    first_seed: int = 0,
) -> dict:
    """Shares of the numbers that lie in their intervals: over all repeats, and of the worst and best single number.

    `noise` is in parts of the stroke, `samples` a leg of the record. The spring counts at its knots less the first.
    """
    plant = plain_records.plant(elements, seed=1)
    top = plant.turned(plain_records.STROKE)
    highest = plant.voltage(top)
    voltage = plant.compensate(plain_records.path(RECORDED, samples), state=top).voltage
    path = plant.compensate(plain_records.path(PREDICTED, 50), state=top).voltage

    def homed(actuator: dehyst.Actuator) -> dehyst.State:
        return actuator.simulate([0, highest, 0, highest]).state

    moved = plant.simulate(path, state=homed(plant)).displacement
    held: dict[str, list[np.ndarray]] = {"stiffness": [], "spring": [], "prediction": []}
    for seed in range(first_seed, first_seed + repeats):
        record = plain_records.driven(plant, voltage, noise=noise * plain_records.STROKE, seed=seed, state=top)
        fit = dehyst.identify(
            record,
            breakaway=plant.slip.breakaway[:-1],
            norm=norm,
            delay=0.0,
            drift=False,
            knots=elements + 1,
            slope_floor=0.05,
        )
        found = resample(Evidence.from_records(fit.actuator, record), level=LEVEL, repeats=resamples, seed=seed)
        # The knots lie where the noisy record ends.
        spring = plant.spring(fit.actuator.spring.displacement)
        for name, truth, (low, high) in (
            ("stiffness", plant.slip.stiffness[:-1], found.stiffness),
            ("spring", (spring - spring[0])[1:], found.spring[:, 1:]),
            ("prediction", moved, found.prediction(path, homed)),
        ):
            held[name].append((low <= truth) & (truth <= high))
    return {name: _shares(np.array(one)) for name, one in held.items()}


def _shares(held: np.ndarray) -> dict[str, float]:
    each = held.mean(axis=0)
    return {"share": float(held.mean()), "least": float(each.min()), "most": float(each.max())}


def numbers() -> list[dict]:
    """Return the shares of numbers and predictions of plants that are instances of the model."""
    results = []
    print(f"{REPEATS} repeats, intervals of {100 * LEVEL:.0f} %; share that holds the truth (worst to best number)")
    for elements, norm, noise in [(5, norm, noise) for norm in ("l2", "l1") for noise in NOISES] + [
        (10, norm, NOISES[0]) for norm in ("l2", "l1")
    ]:
        start = time.perf_counter()
        found = coverage(elements, norm, noise)
        seconds = time.perf_counter() - start
        results.append(
            {
                "elements": elements,
                "norm": norm,
                "noise": noise,
                "level": LEVEL,
                "repeats": REPEATS,
                "seconds": seconds,
                **found,
            }
        )
        shares = "  ".join(
            f"{name} {100 * one['share']:5.1f} % ({100 * one['least']:.0f} to {100 * one['most']:.0f})"
            for name, one in found.items()
        )
        print(f"  N = {elements:<3} {norm}  noise {100 * noise:g} % of the stroke:  {shares}", flush=True)
    return results


def main() -> None:
    OUTPUT.write_text(json.dumps({"numbers": numbers()}, indent=1) + "\n")


if __name__ == "__main__":
    main()
