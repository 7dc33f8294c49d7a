"""Lissajous figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import gcd, pi

import numpy as np

from dehyst._errors import RecordError
from dehyst._validation import keep
from dehyst.waveforms.excitation import positive, set_checked
from dehyst.waveforms.profiles import Travel
from dehyst.waveforms.scan import CYCLE_SAMPLES, MotionLimits, Scan, length, samples_of, whole


@dataclass(frozen=True)
class Lissajous(Scan):
    """``x = cx + ax sin(2 pi p f t)``, ``y = cy + ay sin(2 pi q f t + phase)``.

    Parameters
    ----------
    amplitude, centre : (float, float)
        a and c along x and y [m].
    frequency : float
        f, periods of the whole figure a second [Hz].
    ratio : (int, int)
        p and q, without a common factor.
    phase : float, optional
        [rad]; by default the phase at which the lines of the figure lie farthest apart. Such phases are pi/p apart;
        halfway between two of them the figure retraces its own line.
    speed, acceleration : float, optional
        Largest abs(dx/dt) [m/s] and abs(d2x/dt2) [m/s^2] allowed, of either axis.
    sample_rate : float, optional
        Samples a second [Hz]; by default 400 a period of the faster axis.

    Raises
    ------
    RecordError
        If a number is impossible, or the limits cannot be kept; the message states what can be done.
    """

    amplitude: tuple[float, float]
    frequency: float
    ratio: tuple[int, int] = (1, 1)
    phase: float | None = None
    centre: tuple[float, float] = (0.0, 0.0)
    speed: float | None = None
    acceleration: float | None = None
    sample_rate: float | None = None

    def __post_init__(self) -> None:
        set_checked(self, positive, "frequency")
        for name in ("amplitude", "centre", "ratio"):
            if not isinstance(getattr(self, name), Sequence) or len(getattr(self, name)) != 2:
                raise RecordError(f"{name}: got {getattr(self, name)!r}, need a pair, for x and y")
        keep(self, amplitude=tuple(positive(length(a, "amplitude"), "amplitude") for a in self.amplitude))
        keep(self, centre=tuple(length(c, "centre") for c in self.centre))
        p, q = (whole(part, "ratio") for part in self.ratio)
        if gcd(p, q) > 1:
            raise RecordError(
                f"ratio: got {p} and {q}, need whole numbers without a common factor; try {p // gcd(p, q)} and "
                f"{q // gcd(p, q)} at {self.frequency * gcd(p, q):.6g} Hz"
            )
        set_checked(self, positive, optional=("speed", "acceleration", "sample_rate"))
        # Backwards from c/2 on, c an odd multiple of pi/p, x is the same; so is y if q c + 2 phase is one of pi.
        widest = 0.5 * pi * (1 + (1 - q) / p)
        keep(self, phase=widest if self.phase is None else _angle(self.phase))
        # The harder axis first, so that the values in a message are possible for both.
        for axis in sorted((0, 1), key=lambda i: -self.amplitude[i] * self.ratio[i] ** 2):
            turning, a = 2 * pi * self.ratio[axis] / self.period, self.amplitude[axis]
            limits = MotionLimits(self.speed, self.acceleration)
            limits.refuse(f"{'xy'[axis]} of this figure", (a * turning, a * turning**2), self.frequency, a)

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return ("x", "y")

    @property
    def rate(self) -> float:
        """Samples a second [Hz]."""
        return CYCLE_SAMPLES * self.frequency * max(self.ratio) if self.sample_rate is None else self.sample_rate

    @cached_property
    def samples(self) -> int:
        """Samples of a period."""
        _ = samples_of(0.5 / self.frequency / max(self.ratio), self.rate)
        return samples_of(1 / self.frequency, self.rate)

    def travel(self, axis: str) -> Travel:
        """Return displacement, velocity and acceleration at each sample."""
        i = int(axis == "y")
        turning, a = 2 * pi * self.ratio[i] / self.period, self.amplitude[i]
        # Whole turns are subtracted before the factor 2 pi: that keeps the digits.
        share = np.arange(self.samples) * self.ratio[i] % self.samples / self.samples
        angle = 2 * pi * share + (self.phase or 0.0 if i else 0.0)
        sin = a * np.sin(angle)
        return Travel(self.centre[i] + sin, a * turning * np.cos(angle), -(turning**2) * sin)


def _angle(value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= 1e3:
        return float(value)
    raise RecordError(f"phase: got {value!r}, need an angle in radians")
