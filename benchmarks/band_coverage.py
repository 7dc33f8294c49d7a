"""How often the prediction band of `dehyst insight` holds the path of an actuator that is no instance of the model.

A truth of another mechanism is recorded with sensor noise: descending tops in even repeats, random turns in odd ones.
The record is identified, as a plain and as a structured model; a random path is compensated and played into the truth.
`coverage.py` runs this for the truths below. The method was chosen on the first ones. Those "seen" were run once, 16
repeats each, before the number of held-out parts of like amplitude was settled. Those "aside" were run once, after all.
"""

import time
from dataclasses import dataclass

import numpy as np
from strangers.protocols import leg_samples, random_turns, through
from strangers.truths import TRUTHS, Bench

import dehyst
from dehyst import Compensator, Record
from dehyst.identification import Structure
from dehyst.trust.bootstrap import resample
from dehyst.trust.evidence import Evidence
from dehyst.trust.model_error import HeldOut
from dehyst.trust.prediction_band import PredictionBand, top_start
from dehyst.virtual import BoucWenActuator

CLASSES = {
    "plain": Structure(elements=12, knots=13, smoothing=0.0),
    "wider": Structure(elements=10, grades=3, knots=9, transformer=5),
}
# How the choice of the method used a truth.
USES = {
    "relays": "chosen on",
    "bouc-wen": "chosen on",
    "domains": "seen",
    "stribeck": "seen",
    "voigt": "aside",
    "bristles": "aside",
}
RECORDS = ("tops", "random")
# Of the stroke, white.
NOISE = 2.5e-4
# A period; and models of resampled records.
SAMPLES, RESAMPLES = 100, 30
LEVEL = 0.9


class Stage:
    """A truth on a bench: u from 0 to 1 in, metres out, time going on."""

    def __init__(self, name: str) -> None:
        if name == "bouc-wen":
            actuator = BoucWenActuator(noise=0.0)
            self.low, self.high, self.stroke, self._period = 0.0, actuator.highest, actuator.stroke, 1.0
            self._play = lambda when, voltage: actuator.play(voltage, time=when, measured=False)
        else:
            truth = TRUTHS[name]
            self.low, self.high, self.stroke, self._period = truth.low, truth.high, truth.stroke, truth.period
            self._play = Bench(truth).play
        self._now = 0.0

    def voltage(self, u: np.ndarray) -> np.ndarray:
        """Return u as a voltage [V]."""
        return self.low + (self.high - self.low) * u

    def play(self, voltage: np.ndarray) -> np.ndarray:
        """Return the displacement [m] that a voltage [V] causes, sample after sample of a period."""
        when = self._now + self._period / SAMPLES * np.arange(1, voltage.size + 1)
        self._now = float(when[-1])
        return self._play(when, voltage)


@dataclass(frozen=True)
class Repeat:
    """Of one repeat: shares of the path's samples inside, and half widths in % of the stroke."""

    held: float
    held_by_noise: float
    held_by_all: float
    half: float
    half_by_noise: float
    error: float


def turns_of(kind: str, rng: np.random.Generator) -> list[float]:
    """Return the turning points of a record, two major loops first."""
    if kind == "random":
        return [0.0, 1.0, 0.0, 1.0, 0.0, *random_turns(rng, 24, 0.03, 0.97), 0.0]
    tops = np.sort(rng.uniform(0.12, 0.95, 9))[::-1].tolist()
    return [0.0, 1.0, 0.0, 1.0, 0.0, *(turn for top in tops for turn in (top, 0.0))]


def repeat(name: str, structure: Structure, kind: str, seed: int) -> Repeat:
    """Record, identify, predict a path and play it."""
    rng = np.random.default_rng([seed, 7])
    stage = Stage(name)
    limits = stage.low, stage.high
    turns = turns_of(kind, rng)
    voltage = stage.voltage(through(turns, leg_samples(turns, SAMPLES)))
    true = stage.play(voltage)
    noisy = true + rng.normal(0, NOISE * stage.stroke, true.size)
    record = Record(np.arange(true.size) / SAMPLES, voltage, noisy, name)
    actuator = dehyst.identify(record, structure=structure, norm="l2", delay=0.0, drift=False).actuator
    evidence = Evidence.from_records(actuator, record)
    intervals = resample(evidence, level=LEVEL, repeats=RESAMPLES, seed=seed)
    state = top_start(actuator, limits)
    start = state(actuator)
    turns = [1.0, *(1 - turn for turn in random_turns(rng, 16, 0.04, 0.97))]
    lowest = float(actuator.spring.displacement[0])
    wanted = lowest + (start.displacement - lowest) * through(turns, leg_samples(turns, SAMPLES))
    band = PredictionBand.of(
        wanted,
        Compensator(actuator, limits).trajectory(wanted, state=start),
        intervals,
        None,
        state,
        misfit=evidence.misfit,
        held_out=HeldOut.of(evidence, intervals),
    )
    stage.play(stage.voltage(through([0.0, 1.0], [SAMPLES // 2])[1:]))
    return judged(band, stage.play(band.voltage), stage.stroke)


def judged(band: PredictionBand, reached: np.ndarray, stroke: float) -> Repeat:
    """Return what a band holds of a path."""

    def held(low: np.ndarray, high: np.ndarray) -> float:
        return float(np.mean((low <= reached) & (reached <= high)))

    def half(pair: np.ndarray) -> float:
        return float(50 * np.mean(pair[1] - pair[0]) / stroke)

    off = 100 * float(np.quantile(np.abs(reached - band.displacement), LEVEL)) / stroke
    noise, likely = held(*band.noise), held(*band.likely)
    return Repeat(likely, noise, held(band.lowest, band.highest), half(band.likely), half(band.noise), off)


def coverage(name: str, kind: str, repeats: int, *, first_seed: int = 0) -> dict:
    """Return the shares of samples held over repeats, by the record's kind and in all."""
    start = time.process_time()
    seeds = range(first_seed, first_seed + repeats)
    rows = [repeat(name, CLASSES[kind], RECORDS[seed % 2], seed) for seed in seeds]
    found = {key: float(np.mean([getattr(row, key) for row in rows])) for key in Repeat.__dataclass_fields__}
    shares = np.array([row.held for row in rows])
    return {
        "truth": name,
        "class": kind,
        "use": USES[name],
        "level": LEVEL,
        "repeats": repeats,
        "seconds": time.process_time() - start,
        **found,
        **{f"held_{word}": float(shares[[seed % 2 == k for seed in seeds]].mean()) for k, word in enumerate(RECORDS)},
        "least": float(np.quantile(shares, 0.05)),
        "most": float(np.quantile(shares, 0.95)),
    }


def shown(row: dict) -> str:
    """Return a row in words."""
    return (
        f"  {row['truth']:<10}{row['class']:<7} band {100 * row['held']:5.1f} % (tops {100 * row['held_tops']:.1f}, "
        f"random {100 * row['held_random']:.1f}; one path {100 * row['least']:.0f} to {100 * row['most']:.0f})  "
        f"by noise alone {100 * row['held_by_noise']:.1f} %, by the largest misfit {100 * row['held_by_all']:.1f} %; "
        f"half width {row['half']:.2f} % of the stroke, 90 % of the errors within {row['error']:.2f} %"
    )
