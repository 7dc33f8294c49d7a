"""The excitations of a calibration: a first look at the actuator, the records after it, and voltages from a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst.records import Record, read_table
from dehyst.records.files import time_of
from dehyst.records.formats.file_content import MOST
from dehyst.waveforms import Excitation, Leg, Sampling, descending_tops, raised_cosine, stage_excitation, staircase
from dehyst.waveforms.excitation import positive

_SAMPLES_A_CYCLE = 400
# Cycles of the look after its holds, where the state is known.
_LOOPS = 2
# Shares of a hold between which creep is measured: early, but after the ramp has decayed, and late.
_EARLY, _LATE = (0.1, 0.2), (0.9, 1.0)
# Creep that a model may ignore, as a share of the stroke.
_LITTLE = 1e-3
# Speed-up of the fast loops that separate creep, and least samples a cycle that resolve the corners.
_FASTER, _FEWEST = 5, 60
_STEPS = 5
# Random turning points after descending tops.
_RANDOM = 24
# A rig may round a rate up.
_SLOWER = 0.95
# Share of the median by which the steps of time may differ.
_UNEVEN = 1e-3
# The held-out record of several axes is of other heights, periods and turning points.
_HEIGHT, _PERIOD, _SEED = 0.97, 0.83, 100


@dataclass(frozen=True)
class ExcitationPlan:
    """The excitations of a calibration, by their speed and their voltages.

    Raise `RecordError` if a number is impossible, or there are fewer than 8 samples a cycle.

    Parameters
    ----------
    low, high : float
        Voltages [V] between which the actuator is driven.
    sample_rate : float
        Samples a second [Hz], a rate that the rig can play.
    frequency : float
        Cycles a second [Hz]: a leg takes half a cycle.
    hold : float
        Time [s] at each voltage of the holds that measure creep.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s]; steeper legs are stretched.
    """

    low: float
    high: float
    sample_rate: float
    frequency: float = 1.0
    hold: float = 3.0
    slew_rate: float | None = None

    def __post_init__(self) -> None:
        positive(self.hold, "hold")
        self.sampling()

    def sampling(self, faster: float = 1.0) -> Sampling:
        """Return the sampling of the voltages, `faster` times faster."""
        return Sampling(
            frequency=faster * self.frequency,
            sample_rate=self.sample_rate,
            base=self.low,
            limits=(self.low, self.high),
            slew_rate=self.slew_rate,
        )

    def look(self) -> Excitation:
        """Play up, a hold, down, a hold, then two major loops: for stroke, noise, creep and the first insight."""
        sampling = self.sampling()
        rise, fall = sampling.legs([self.low, self.high, self.low])
        stay, rest = (Leg(level, level, self.hold) for level in (self.high, self.low))
        return sampling.play("look", [rise, stay, fall, rest, *(rise, fall) * _LOOPS])

    def loops(self, look: Record) -> Record:
        """Return the major loops at the end of a look."""
        tail = 1 + _LOOPS * sum(_rows(leg, self) for leg in ("rise", "fall"))
        return look.slice(len(look) - tail, None).with_name("look's loops")

    def tops(self, steps: int = 10) -> Excitation:
        """Play two major loops, descending tops, and random turning points, by which the promise is tested."""
        return descending_tops(self.high, steps=steps, random=_RANDOM, drive=self.sampling())

    def others(self) -> Excitation:
        """Play loops of other heights, to be held out."""
        heights = self.low + (self.high - self.low) * np.array([1.0, 0.75, 0.45])
        return raised_cosine(heights, cycles=2, drive=self.sampling())

    def creep_pair(self) -> tuple[Excitation, Excitation]:
        """Return two excitations that separate creep from hysteresis: faster loops, and stairs with holds."""
        faster = min(_FASTER, self.sample_rate / (_FEWEST * self.frequency))
        fast = descending_tops(self.high, steps=_STEPS, drive=self.sampling(max(faster, 1.0)))
        stairs = staircase(self.high, steps=_STEPS, hold=self.hold, back=True, drive=self.sampling())
        return fast, stairs

    def within_slew_rate(self, excitation: Excitation) -> Excitation:
        """Return the excitation, slowed down to the slew rate."""
        steepest = float(np.abs(np.diff(excitation.voltage)).max()) * excitation.sample_rate
        if self.slew_rate is None or steepest <= _SLOWER * self.slew_rate:
            return excitation
        slower = excitation.sample_rate * _SLOWER * self.slew_rate / steepest
        return Excitation(excitation.name, excitation.voltage, slower, excitation.warnings)

    @property
    def leg(self) -> int:
        """Samples between two turns of a path: half a cycle, or as many as leave a model half of the slew rate."""
        samples = 0.5 * self.sample_rate / self.frequency
        if self.slew_rate is not None:
            samples = max(samples, np.pi * (self.high - self.low) * self.sample_rate / self.slew_rate)
        return int(np.ceil(samples))

    def homing(self) -> Excitation:
        """Play two major cycles: after them the state is known."""
        return raised_cosine([self.high], cycles=2, drive=self.sampling())


@dataclass(frozen=True)
class AxesExcitations:
    """The excitations of a calibration of several axes, with a column an axis.

    `axes`: names. `each`: speed and voltages of each axis. `steps`: descending tops of each alone. `cycles`: of the
    first one together with the others.
    """

    axes: tuple[str, ...]
    each: tuple[ExcitationPlan, ...]
    steps: int
    cycles: int

    def training(self) -> Excitation:
        """Play the axes one after the other, then together."""
        played = self._played(1.0, 1.0, 0)
        return Excitation("axes", played.voltage, played.sample_rate)

    def others(self) -> Excitation:
        """Play all axes together, to be held out."""
        played = self._played(_HEIGHT, _PERIOD, _SEED)
        return Excitation("others", played.voltage[played.parts[-1][1] :], played.sample_rate)

    def homing(self) -> Excitation:
        """Play two major cycles of all axes at once."""
        cycles = [one.homing().voltage for one in self.each]
        longest = max(map(len, cycles))
        # Axes that are faster wait at their lowest voltage first.
        columns = [np.concatenate([np.full(longest - len(one), one[0]), one]) for one in cycles]
        return Excitation("homing", np.column_stack(columns), self.each[0].sample_rate)

    @property
    def leg(self) -> int:
        """Samples between two turns of a path of the first axis: half a cycle, or what slew rates need."""
        return max(one.leg for one in self.each)

    def _played(self, height: float, faster: float, seed: int) -> Excitation:
        return stage_excitation(
            [one.low + height * (one.high - one.low) for one in self.each],
            drive=[one.sampling(faster) for one in self.each],
            steps=self.steps,
            cycles=self.cycles,
            axes=self.axes,
            seed=seed,
        )


def _rows(leg: str, plan: ExcitationPlan) -> int:
    """Return the number of samples of a leg through the whole range."""
    sampling = plan.sampling()
    ends = (plan.low, plan.high) if leg == "rise" else (plan.high, plan.low)
    return len(sampling.play(leg, [Leg(*ends, sampling.half)])) - 1


def sample_rate_for(frequency: float) -> float:
    """Return the sample rate [Hz] to request from a rig."""
    return _SAMPLES_A_CYCLE * frequency


@dataclass(frozen=True)
class CreepCheck:
    """Creep in a look, as shares of the stroke: how far the displacement went on, and its standard uncertainty."""

    share: float
    doubt: float

    @property
    def seen(self) -> bool:
        """Whether a model should include creep."""
        return abs(self.share) > max(_LITTLE, 4 * self.doubt)


def creep_of(look: Record) -> CreepCheck:
    """Return how far the displacement went on while the voltage of a look was held at its top."""
    y, noise = look.displacement[_first_hold(look.voltage)], look.noise

    def mean(part: tuple[float, float]) -> tuple[float, int]:
        values = y[int(part[0] * y.size) : max(int(part[1] * y.size), int(part[0] * y.size) + 1)]
        return float(values.mean()), values.size

    (early, n), (late, m) = mean(_EARLY), mean(_LATE)
    return CreepCheck((late - early) / look.stroke, noise * float(np.sqrt(1 / n + 1 / m)) / look.stroke)


def _first_hold(voltage: Array) -> slice:
    """Return the samples of the longest hold at the highest voltage."""
    # A readback has noise.
    top = voltage > voltage.max() - 0.01 * float(np.ptp(voltage))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], top.astype(int), [0]])))
    spans = list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
    return slice(*max(spans, key=lambda span: span[1] - span[0]))


class WantedVoltage(NamedTuple):
    """An `excitation`, and the displacement (n,) [m] that is `wanted` at each of its voltages, or None."""

    excitation: Excitation
    wanted: Array | None


def read_voltage(path: Path, *, max_bytes: float = MOST) -> WantedVoltage:
    """Read a voltage to play, as `dehyst excite` and `dehyst compensate` write it.

    Parameters
    ----------
    path : Path
        A table with time [s] and voltage [V], and perhaps the wanted displacement.
    max_bytes : float
        Largest size of the file.

    Raises
    ------
    FileFormatError
        If it cannot be read, or the times do not rise, or not evenly.
    """
    table = read_table(path, max_bytes=max_bytes)
    voltage = table.column("voltage")
    time = time_of(table, voltage.size, None, None)
    steps = np.diff(time)
    if not (steps > 0).all():
        raise FileFormatError(f"{path}: the times do not rise; write it with dehyst excite, or correct them")
    if not steps.size or float(np.ptp(steps)) > _UNEVEN * float(np.median(steps)):
        raise FileFormatError(f"{path}: the times are not evenly spaced; write it with dehyst excite, or resample it")
    excitation = Excitation(path.stem, voltage, 1 / float(np.median(steps)))
    try:
        wanted = table.column("displacement")
    except FileFormatError:
        wanted = None
    return WantedVoltage(excitation, wanted)
