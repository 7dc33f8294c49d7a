"""The amplifier of a virtual bench, with its actuator: the only place that puts out a voltage, within its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.virtual.base import VirtualActuator

# Share of a servo period that a jump of the voltage takes.
_JUMP = 1e-3
# A ramp is played in parts of this share of the range.
_PART = 0.01


@dataclass
class Extremes:
    """The extremes of all voltages that an amplifier has put out.

    `lowest`, `highest`: voltages [V]. `largest_step`: largest change from one voltage to the next [V]. `steepest`:
    largest change over the device's time between the two voltages [V/s], a servo period at least. `refused`: requests
    outside the limits; none was put out.
    """

    lowest: float
    highest: float
    largest_step: float = 0.0
    steepest: float = 0.0
    refused: int = 0

    def update(self, voltage: Array, seconds: Array) -> None:
        """Include voltages (n + 1,) [V], from the present one on, and the seconds (n,) between them."""
        steps = np.abs(np.diff(voltage))
        self.lowest = min(self.lowest, float(voltage.min()))
        self.highest = max(self.highest, float(voltage.max()))
        self.largest_step = max(self.largest_step, float(steps.max(initial=0.0)))
        self.steepest = max(self.steepest, float((steps / seconds).max(initial=0.0)))


class Amplifier:
    """The output stage: it puts out voltages within its limits, and the actuator follows.

    Parameters
    ----------
    actuator : VirtualActuator
        The connected actuator, at rest at 0 V.
    limits : VoltageLimits
        Limits of the output; a target is reached at the slew rate, or at once if there is none.
    period : float
        Least time from one voltage to the next [s].

    Attributes
    ----------
    voltage, target : float
        Present output, and the voltage that it moves to [V].
    position : float
        Displacement of the actuator [m].
    at : float
        Time of the present state [s].
    gain : float
        Stroke by highest voltage [m/V].
    """

    def __init__(self, actuator: VirtualActuator, limits: VoltageLimits, period: float) -> None:
        self.limits, self.period = limits, period
        self._actuator, self.stroke, self.gain = actuator, actuator.stroke, actuator.stroke / actuator.highest
        self.voltage = self.target = limits.nearest(0.0)
        self.log = Extremes(self.voltage, self.voltage)
        self.at = self._put_at = -period
        first = self._actuator.play([0.0, self.voltage], time=[-2 * period, -period], measured=False)
        self.position = float(first[-1])

    @property
    def moving(self) -> bool:
        """Whether the output is moving to its target."""
        return self.voltage != self.target

    def allows(self, voltage: Array) -> bool:
        """Return whether all voltages (n,) [V] are finite and within the limits; if not, count a refusal."""
        if bool(np.all((voltage >= self.limits.low) & (voltage <= self.limits.high))):
            return True
        self.log.refused += 1
        return False

    def aim(self, voltage: float) -> None:
        """Move to a voltage [V] from now on: at the slew rate, or at once."""
        self.target = voltage
        if self.limits.slew_rate is None:
            self.play(np.array([voltage]), np.array([self.at]))

    def rest(self) -> None:
        """Stay at the present voltage."""
        self.target = self.voltage

    def play(self, voltage: Array, at: Array) -> Array:
        """Put out voltages (n,) [V] at times (n,) [s], in straight lines; return the displacements (n,) [m].

        Raise `DeviceError` if one is outside the limits; none is put out.
        """
        if not self.allows(voltage):
            raise DeviceError(f"amplifier: got {voltage.min():.6g} to {voltage.max():.6g} V, need {self.limits.words}")
        before = np.concatenate([[self._put_at], at[:-1]])
        # Rounding may make times that are one period apart a little closer.
        self.log.update(np.concatenate([[self.voltage], voltage]), np.maximum(at - before, self.period * (1 - 1e-6)))
        times = at.copy()
        times[0] = max(times[0], self.at + _JUMP * self.period)
        displacement = self._actuator.play(voltage, time=times, measured=False)
        self.voltage, self.position = float(voltage[-1]), float(displacement[-1])
        self.target = self.voltage
        self.at, self._put_at = float(times[-1]), float(at[-1])
        return displacement

    def follow(self, wave: Array, at: Array) -> tuple[Array, Array]:
        """Put out a wave (n,) [V] at times (n,) [s], within the slew rate; return voltages and displacements (n,)."""
        voltage = wave
        if self.limits.slew_rate is not None:
            largest = self.limits.slew_rate * (at - np.concatenate([[self.at], at[:-1]]))
            out, v = [], self.voltage
            for wanted, most in zip(wave.tolist(), largest.tolist(), strict=True):
                v = min(max(wanted, v - most), v + most)
                out.append(v)
            voltage = np.array(out)
        displacement = self.play(voltage, at)
        self.target = float(wave[-1])
        return voltage, displacement

    def pass_time(self, now: float) -> None:
        """Keep the voltage until `now` [s], or continue to the target."""
        if now > self.at and self.moving:
            self._ramp(now)
        if now > self.at:
            self.position = float(self._actuator.play([self.voltage], time=[now], measured=False)[-1])
            self.at = now

    def _ramp(self, now: float) -> None:
        target, start, begin = self.target, self.voltage, self.at
        arrival = begin + abs(target - start) / float(self.limits.slew_rate or math.inf)
        share = 1.0 if now >= arrival else (now - begin) / (arrival - begin)
        until, end = min(now, arrival), start + share * (target - start) if share < 1 else target
        parts = math.ceil(abs(end - start) / (_PART * (self.limits.high - self.limits.low)))
        part = np.linspace(0.0, 1.0, 1 + max(1, parts if until - begin > self.period else 1))[1:]
        path = start + part * (end - start)
        path[-1] = end
        self.play(path, begin + part * (until - begin))
        self.target = target
