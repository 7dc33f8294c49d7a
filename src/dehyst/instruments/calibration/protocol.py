"""What a calibration plays: a first look at the actuator, and what is to be recorded after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._types import Array
from dehyst.records import Record
from dehyst.waveforms import Excitation, Leg, Sampling, descending_tops, raised_cosine, staircase
from dehyst.waveforms.excitation import positive

_SAMPLES_A_CYCLE = 400
# Cycles of the look that follow its holds, where the state is known.
_LOOPS = 2
# Parts of a hold over which creep is told: early, but after the ramp has died away, and late.
_EARLY, _LATE = (0.1, 0.2), (0.9, 1.0)
# Creep that a model need not know, as a part of the stroke.
_LITTLE = 1e-3
# How much faster loops are played too where creep shows, and samples a cycle without which a record has no corners.
_FASTER, _FEWEST = 5, 60
_STEPS = 5
# A rig may play a little faster than it is asked to: its rates are not any.
_SLOWER = 0.95


@dataclass(frozen=True)
class ExcitationPlan:
    """How fast and between which voltages a calibration plays.

    Parameters
    ----------
    low, high : float
        Voltages [V] between which the actuator is driven.
    sample_rate : float
        Samples a second [Hz], one that the rig can play.
    frequency : float
        Cycles a second [Hz]: a leg takes half a cycle.
    hold : float
        Time [s] at each voltage where creep is looked for.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s]; what would be steeper is stretched.

    Raises
    ------
    RecordError
        If a number is impossible, or there are fewer than 8 samples a cycle.
    """

    low: float
    high: float
    sample_rate: float
    frequency: float = 1.0
    hold: float = 3.0
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        positive(self.hold, "hold")
        self.drive()

    def drive(self, faster: float = 1.0) -> Sampling:
        """How its voltages are played, so many times faster."""
        return Sampling(
            frequency=faster * self.frequency,
            sample_rate=self.sample_rate,
            base=self.low,
            limits=(self.low, self.high),
            slew_rate=self.slew_rate,
        )

    def look(self) -> Excitation:
        """Up, a hold, down, a hold, then two major loops: stroke, noise, creep, and what insight starts from."""
        drive = self.drive()
        rise, fall = drive.legs([self.low, self.high, self.low])
        stay, rest = (Leg(at, at, self.hold) for at in (self.high, self.low))
        return drive.play("look", [rise, stay, fall, rest, *(rise, fall) * _LOOPS])

    def loops(self, look: Record) -> Record:
        """The major loops of a look, without what came before them."""
        tail = 1 + _LOOPS * sum(_rows(leg, self) for leg in ("rise", "fall"))
        return look.slice(len(look) - tail, None).with_name("look's loops")

    def tops(self, steps: int = 10) -> Excitation:
        """Two major loops and descending tops."""
        return descending_tops(self.high, steps=steps, drive=self.drive())

    def others(self) -> Excitation:
        """Loops of other heights, to be held out."""
        heights = self.low + (self.high - self.low) * np.array([1.0, 0.75, 0.45])
        return raised_cosine(heights, cycles=2, drive=self.drive())

    def slowly_and_fast(self) -> tuple[Excitation, ...]:
        """What tells creep from hysteresis: loops at another speed, and stairs with a hold on each step."""
        faster = min(_FASTER, self.sample_rate / (_FEWEST * self.frequency))
        drive = self.drive(max(faster, 1.0))
        fast = descending_tops(self.high, steps=_STEPS, drive=drive)
        stairs = staircase(self.high, steps=_STEPS, hold=self.hold, back=True, drive=self.drive())
        return fast, stairs

    def kept(self, excitation: Excitation) -> Excitation:
        """The same, played as much slower as the slew rate asks for."""
        steepest = float(np.abs(np.diff(excitation.voltage)).max()) * excitation.sample_rate
        if self.slew_rate is None or steepest <= _SLOWER * self.slew_rate:
            return excitation
        slower = excitation.sample_rate * _SLOWER * self.slew_rate / steepest
        return Excitation(excitation.name, excitation.voltage, slower, excitation.warnings)

    @property
    def leg(self) -> int:
        """Samples from one turn of a path to the next: half a cycle, or what leaves a model half of the slew rate."""
        samples = 0.5 * self.sample_rate / self.frequency
        if self.slew_rate is not None:
            samples = max(samples, np.pi * (self.high - self.low) * self.sample_rate / self.slew_rate)
        return int(np.ceil(samples))

    def homing(self) -> Excitation:
        """Two major cycles: after them the state is known."""
        return raised_cosine([self.high], cycles=2, drive=self.drive())


def _rows(leg: str, pace: ExcitationPlan) -> int:
    """Samples of a leg through the whole range."""
    drive = pace.drive()
    ends = (pace.low, pace.high) if leg == "rise" else (pace.high, pace.low)
    return len(drive.play(leg, [Leg(*ends, drive.half)])) - 1


def sample_rate_for(frequency: float) -> float:
    """Samples a second [Hz] to ask a rig for."""
    return _SAMPLES_A_CYCLE * frequency


@dataclass(frozen=True)
class CreepCheck:
    """What a look tells of creep, as parts of the stroke: how far the displacement went on, and the doubt of it."""

    share: float
    doubt: float

    @property
    def seen(self) -> bool:
        """Whether a model should know of it."""
        return abs(self.share) > max(_LITTLE, 4 * self.doubt)


def creep_of(look: Record) -> CreepCheck:
    """How far the displacement went on while the voltage of a look stood at its top."""
    held = _first_hold(look.voltage)
    y, noise = look.displacement[held], look.noise

    def mean(part: tuple[float, float]) -> tuple[float, int]:
        some = y[int(part[0] * y.size) : max(int(part[1] * y.size), int(part[0] * y.size) + 1)]
        return float(some.mean()), some.size

    (early, n), (late, m) = mean(_EARLY), mean(_LATE)
    return CreepCheck((late - early) / look.stroke, noise * float(np.sqrt(1 / n + 1 / m)) / look.stroke)


def _first_hold(voltage: Array) -> slice:
    """Samples of the longest stretch at the highest voltage."""
    # A readback has noise.
    top = voltage > voltage.max() - 0.01 * float(np.ptp(voltage))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], top.astype(int), [0]])))
    spans = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    return slice(*max(spans, key=lambda span: span[1] - span[0]))
