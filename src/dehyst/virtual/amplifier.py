"""The amplifier of a virtual bench, with its actuator: the one place where a voltage is put out, within its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.control import VoltageLimits
from dehyst.model import Actuator
from dehyst.virtual.base import VirtualActuator
from dehyst.virtual.modelled import ModelledActuator

# Share of a servo period that a jump of the voltage takes.
_JUMP = 1e-3
# A ramp is driven in parts of this share of the range.
_PART = 0.01


@dataclass
class Extremes:
    """What an amplifier has ever put out.

    Attributes
    ----------
    lowest, highest : float
        Voltages [V].
    largest_step : float
        From one voltage that was put out to the next [V].
    steepest : float
        That step by the device's time between the two [V/s], a servo period at least.
    refused : int
        Requests that lay outside of the limits; none was put out.
    """

    lowest: float
    highest: float
    largest_step: float = 0.0
    steepest: float = 0.0
    refused: int = 0

    def see(self, voltage: Array, seconds: Array) -> None:
        """Take in voltages (n + 1,) [V], the first of which was there before, and the seconds (n,) between them."""
        steps = np.abs(np.diff(voltage))
        self.lowest = min(self.lowest, float(voltage.min()))
        self.highest = max(self.highest, float(voltage.max()))
        self.largest_step = max(self.largest_step, float(steps.max(initial=0.0)))
        self.steepest = max(self.steepest, float((steps / seconds).max(initial=0.0)))


class Amplifier:
    """Puts out voltages, and lets the actuator follow; nothing outside of its limits can pass.

    Parameters
    ----------
    truth : VirtualActuator or Actuator
        What is driven, at rest at 0 V.
    limits : VoltageLimits
        What is put out; with a slew rate, a target is reached at that rate, without one at once.
    period : float
        Seconds from one voltage to the next, at least.

    Attributes
    ----------
    voltage, target : float
        What is put out, and what it goes to [V].
    position : float
        Where the actuator is [m].
    at : float
        Up to when [s].
    gain : float
        Stroke by highest voltage [m/V].
    """

    def __init__(self, truth: VirtualActuator | Actuator, limits: VoltageLimits, period: float) -> None:
        self.limits, self.period = limits, period
        self._truth: VirtualActuator = ModelledActuator(truth) if isinstance(truth, Actuator) else truth
        self.stroke, self.gain = self._truth.stroke, self._truth.stroke / self._truth.highest
        self.voltage = self.target = limits.nearest(0.0)
        self.log = Extremes(self.voltage, self.voltage)
        self.at = self._put_at = -period
        first = self._truth.drive([0.0, self.voltage], time=[-2 * period, -period], measured=False)
        self.position = float(first[-1])

    @property
    def moving(self) -> bool:
        """Whether the output is on its way."""
        return self.voltage != self.target

    def allows(self, voltage: Array) -> bool:
        """Whether all voltages (n,) [V] are finite and within the limits; if not, the refusal is counted."""
        if bool(np.all((voltage >= self.limits.low) & (voltage <= self.limits.high))):
            return True
        self.log.refused += 1
        return False

    def aim(self, voltage: float) -> None:
        """Go to a voltage [V] from now on: at the slew rate, or at once."""
        self.target = voltage
        if self.limits.slew_rate is None:
            self.drive(np.array([voltage]), np.array([self.at]))

    def rest(self) -> None:
        """Stay at the present voltage."""
        self.target = self.voltage

    def drive(self, voltage: Array, at: Array) -> Array:
        """Put out voltages (n,) [V] at times (n,) [s], in straight lines; the displacements (n,) [m] of it.

        Raises
        ------
        DeviceError
            If one is outside of the limits; none was put out.
        """
        if not self.allows(voltage):
            raise DeviceError(f"amplifier: got {voltage.min():.6g} to {voltage.max():.6g} V, need {self.limits.words}")
        before = np.concatenate([[self._put_at], at[:-1]])
        # Times that should be one period apart may be a rounding less.
        self.log.see(np.concatenate([[self.voltage], voltage]), np.maximum(at - before, self.period * (1 - 1e-6)))
        times = at.copy()
        times[0] = max(times[0], self.at + _JUMP * self.period)
        displacement = self._truth.drive(voltage, time=times, measured=False)
        self.voltage, self.position = float(voltage[-1]), float(displacement[-1])
        self.target = self.voltage
        self.at, self._put_at = float(times[-1]), float(at[-1])
        return displacement

    def follow(self, wave: Array, at: Array) -> tuple[Array, Array]:
        """Put out a wave (n,) [V] at times (n,) [s], no faster than the slew rate; voltages and displacements of it."""
        voltage = wave
        if self.limits.slew_rate is not None:
            reach = self.limits.slew_rate * (at - np.concatenate([[self.at], at[:-1]]))
            out, v = [], self.voltage
            for wanted, most in zip(wave.tolist(), reach.tolist(), strict=True):
                v = min(max(wanted, v - most), v + most)
                out.append(v)
            voltage = np.array(out)
        displacement = self.drive(voltage, at)
        self.target = float(wave[-1])
        return voltage, displacement

    def pass_time(self, now: float) -> None:
        """Stay as it is until `now` [s], or go on to the target."""
        if now > self.at and self.moving:
            self._ramp(now)
        if now > self.at:
            self.position = float(self._truth.drive([self.voltage], time=[now], measured=False)[-1])
            self.at = now

    def _ramp(self, now: float) -> None:
        target, start, begin = self.target, self.voltage, self.at
        there = begin + abs(target - start) / float(self.limits.slew_rate or math.inf)
        share = 1.0 if now >= there else (now - begin) / (there - begin)
        until, end = min(now, there), start + share * (target - start) if share < 1 else target
        parts = math.ceil(abs(end - start) / (_PART * (self.limits.high - self.limits.low)))
        part = np.linspace(0.0, 1.0, 1 + max(1, parts if until - begin > self.period else 1))[1:]
        path = start + part * (end - start)
        path[-1] = end
        self.drive(path, begin + part * (until - begin))
        self.target = target
