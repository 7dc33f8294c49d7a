"""Parts that depend on time or temperature: creep, the inertia and damping of a mass, and thermal effects."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError
from dehyst._native import StepCoefficients, output_creep, steps, strains
from dehyst._types import Array
from dehyst._units import COLDEST, HOTTEST
from dehyst._validation import demand_result, untimely, vector
from dehyst.model.elements import Spring
from dehyst.model.entries import Entries, Numbers, entry

if TYPE_CHECKING:
    from dehyst.model.entries import Numeric

# Terms of Taylor's series at a norm of 1: 1/20! is below the last digit.
_TERMS = 21
# Relative error of an identified resonance; gain of a feedback without an identified resonance; largest gain.
_ASTRAY, _UNKNOWN_GAIN, _LARGEST_GAIN = 0.05, 0.01, 0.5
# Largest number of step durations for which the exponentials are cached.
_FEW = 4096
# Largest angle of a step [rad]: after the squarings for this angle, the exponential still has four correct digits.
_LONGEST = 2.0**40


@dataclass(frozen=True, eq=False, repr=False)
class DisplacementCreep(Entries):
    """K branches of creep in displacement, applied after elements and mass (Kuhnen and Krejci; theory section 19).

    ``y = m + sum_k g_k lowpass_k(m)``, with m the displacement without creep and tau_k the time constant of low-pass k.
    At rest ``y = (1 + sum_k g_k) m``. The strains ``e_k = m - lowpass_k(m)``, for a displacement linear in time, follow
    ``e_k <- a e_k + (1 - a) tau_k / dt * dm`` with ``a = exp(-dt / tau_k)``.

    `time_constants` (K,): tau_k [s], positive. `gains` (K,): g_k, 0 or more. Raise `ModelError` if lengths differ, or
    a value is impossible or too large to compute with (magnitude over 1e30).
    """

    _part = "displacement_creep"
    time_constants: Numeric = entry("time_constants_s", Numbers(1, positive=True, divides=True))
    gains: Numeric = entry("gains", Numbers(1, least=0.0))

    _demand_together = Entries._demand_one_size

    def __len__(self) -> int:
        return self.time_constants.size

    @property
    def at_rest(self) -> float:
        """Ratio of the displacement at rest to the displacement without creep, 1 + sum_k g_k."""
        return sum(self.gains.tolist(), 1.0)

    @property
    def per_decade(self) -> float:
        """Creep per decade of time, as a part of the step."""
        shown = self.time_constants[self.gains > 0]
        return float(self.gains.sum() / max(np.log10(shown.max() / shown.min()), 1.0)) if shown.size else 0.0

    def removed(self, time: ArrayLike, displacement: ArrayLike, start: Array | None = None) -> Array:
        """Return m (n,) [m] of a `displacement` (n,) [m] with `time` (n,) [s].

        `start` (K,): strains at the first sample [m]; default 0, creep at rest. Raise `ModelError` if time and
        displacement do not fit.
        """
        y, strains = vector(displacement, "displacement"), np.zeros(len(self)) if start is None else start
        before = (y[0] + float(self.gains @ strains)) / self.at_rest
        return output_creep(y, self._pace(time, y.size), self.gains, before, strains, inverse=True)[0]

    def added(self, time: ArrayLike, displacement: ArrayLike, start: Array) -> tuple[Array, Array]:
        """Return y (n,) [m] of a `displacement` (n,) [m] before creep, and the strains (K,) [m] at its end.

        `time` (n,): [s]. `start` (K,): strains at the first sample [m]. Raise `ModelError` if the lengths do not fit.
        """
        m = vector(displacement, "displacement")
        return output_creep(m, self._pace(time, m.size), self.gains, float(m[0]), start)

    def strains(self, time: ArrayLike, displacement: ArrayLike, start: Array | None = None) -> Array:
        """Return strains e_k (n, K) [m] along a `displacement` (n,) [m] before creep, with `time` (n,) [s].

        `start` (K,): strains at the first sample [m]; default 0.
        """
        m = vector(displacement, "displacement")
        pace = self._pace(time, m.size)
        return strains(m, pace.bounds, pace.decay, pace.gain, np.zeros(len(self)) if start is None else start)

    def _pace(self, time: ArrayLike, samples: int) -> StepCoefficients:
        bounds, durations = clock(time, samples)
        return StepCoefficients(bounds, *low_pass_tables(self.time_constants, durations), np.empty((durations.size, 0)))


@dataclass(frozen=True)
class Thermal(Entries):
    """Gain and offset of the displacement that depend on temperature (theory section 22).

    ``y = offset dT + (1 + gain dT) y_r``, with dT the temperature minus `reference`, and y_r the displacement at the
    reference.

    Parameters
    ----------
    gain : float
        Relative change of the displacement [1/K].
    offset : float, optional
        Thermal expansion [m/K].
    reference : float, optional
        Temperature [degC] at which the other parts were identified.

    Raises
    ------
    ModelError
        If a number is not finite or too large to compute with (magnitude over 1e30).
    """

    _part = "thermal"
    gain: float = entry("gain_per_K", Numbers(plausible=1.0))
    offset: float = entry("offset_m_per_K", Numbers(plausible=1e-3), 0.0)
    reference: float = entry("reference_degC", Numbers(plausible=1e3), 20.0)

    def scale(self, temperature: ArrayLike, samples: int) -> tuple[Array, Array]:
        """Return gains and offsets [m] at one `temperature` [degC], or at one for each of `samples`.

        Raise `ModelError` if the number of temperatures does not fit, or a gain is not positive.
        """
        each = np.ndim(temperature) > 0
        degrees = Numbers(int(each), least=COLDEST, most=HOTTEST, hint="give it in degC")
        given = np.atleast_1d(degrees(temperature, "temperature"))
        if each and given.size != samples:
            got = f"{given.size} values for {samples} samples"
            raise ModelError(argument="temperature", got=got, need="one, or one per sample")
        kelvins = given - self.reference
        gain = 1 + self.gain * kelvins
        if np.any(gain <= 0):
            times = f"{gain.min():.3g} times that at {self.reference:g}, need a positive factor"
            got = f"at {given[int(np.argmin(gain))]:g} degC the displacement would be {times}"
            raise ModelError(got, argument="temperature", hint="give it in degC")
        return gain, self.offset * kelvins

    def warmed(self, displacement: Array, temperature: ArrayLike) -> Array:
        """Return the displacement at a `temperature` from the `displacement` (n,) [m] at the reference; see `scale`."""
        gain, offset = self.scale(temperature, displacement.size)
        return np.asarray(offset + gain * displacement)

    def at_reference(self, displacement: Array, temperature: ArrayLike) -> Array:
        """Return the displacement at the reference from the `displacement` (n,) [m] at a `temperature`; see `scale`."""
        gain, offset = self.scale(temperature, displacement.size)
        return np.asarray((displacement - offset) / gain)

    def per_kelvin(self, stroke: float) -> float:
        """Return the largest change of displacement per kelvin [m/K] within a `stroke` [m]."""
        return abs(self.gain) * stroke + abs(self.offset)


def low_pass_tables(time_constants: Array, durations: Array) -> tuple[Array, Array]:
    """Return decays exp(-dt/tau_j) and gains (1 - decay) tau_j/dt, (R, J), of steps (R,) [s]; both 1 at 0 s.

    `time_constants` (J,) are tau_j [s]. `durations` holds the steps.
    """
    with np.errstate(over="ignore"):
        x = durations[:, None] / time_constants
    return np.exp(-x), np.divide(-np.expm1(-x), x, out=np.ones_like(x), where=x > 0)


def clock(time: ArrayLike, samples: int) -> tuple[NDArray[np.int64], Array]:
    """Cut samples into runs of equal steps, see `_native.steps`.

    Raise `ModelError` if `time` [s] has another length than the samples or does not strictly increase.
    """
    t = vector(time, "time")
    bounds, durations = steps(t)
    if t.size != samples or np.any(durations[1:] <= 0):
        raise ModelError(untimely(t, samples))
    demand_result(durations, "time: steps [s]")
    return bounds, durations


@dataclass(frozen=True)
class Dynamics(Entries):
    """Mass, damping and the series spring between the electrical and the mechanical side (theory section 9).

    ``y'' + 2 zeta omega y' + omega^2 y = omega^2 (w + F_ext/kc)``, and the voltage also holds ``beta (w - y)``: the
    slip elements and the spring act on w, which equals y in slow motion without load.

    Parameters
    ----------
    frequency : float
        omega/(2 pi) [Hz], the resonance at constant charge: omega = sqrt((km + ke)/m). At constant voltage the
        resonance is lower, omega sqrt(K/(K + beta)), with K the slope of the voltage over w.
    damping : float
        zeta, 0 or more.
    series : float, optional
        beta = ke/T [V/m], 0 or more.

    Raises
    ------
    ModelError
        If a number is impossible or too large to compute with (magnitude over 1e30).
    """

    _part = "dynamics"
    frequency: float = entry("frequency_Hz", Numbers(positive=True, divides=True, hint="leave Dynamics out"))
    damping: float = entry("damping", Numbers(least=0.0))
    series: float = entry("series_V_per_m", Numbers(least=0.0, plausible=1e20), 0.0)

    @property
    def omega(self) -> float:
        """The resonance at constant charge [rad/s]."""
        return 2 * math.pi * self.frequency

    def share(self, spring: Spring) -> float:
        """Return theta = beta/(K + beta), K the mean slope of the `spring`: the share of w that follows y at once."""
        mean = float(np.ptp(spring.voltage) / np.ptp(spring.displacement))
        return self.series / (mean + self.series)

    def lead(self, velocity: Array, acceleration: Array) -> Array:
        """Return the lead w - y (n,) [m] that moves the free mass along y: 2 zeta/omega y' + y''/omega^2.

        `velocity` [m/s] is y'. `acceleration` [m/s^2] is y''.
        """
        return (2 * self.damping * velocity + acceleration / self.omega) / self.omega

    def transitions(self, durations: Array, share: float) -> Array:
        """Return transitions (R, 8) of (y, y'/omega) over `durations` (R,) [s].

        ``y'' + 2 zeta omega y' + omega^2 (1 - theta) y = omega^2 q``, ``q = w - theta y + F_ext/kc`` linear in time.
        A row holds phi by rows, then the gains of q before and after the step. They come from the exponential of the
        matrix whose states include q and its slope. `share` is theta. Raise `ModelError` if a step has too many periods
        of the resonance: the exponential then loses all digits.
        """
        radians = max(1.0, 2 * self.damping) * self.omega * float(durations.max(initial=0.0))
        if radians > _LONGEST:
            raise ModelError(
                f"time: a step of {durations.max():.3g} s is too long for a resonance at {self.frequency:.3g} "
                f"Hz with a damping of {self.damping:.3g}; give shorter steps, or leave Dynamics out"
            )
        distinct, row = np.unique(durations * self.omega, return_inverse=True)
        generator = np.zeros((distinct.size, 4, 4))
        generator[:, 0, 1] = distinct
        generator[:, 1, 0], generator[:, 1, 1] = -(1 - share) * distinct, -2 * self.damping * distinct
        generator[:, 1, 2] = distinct
        generator[:, 2, 3] = 1
        steps = (_exponentials if distinct.size <= _FEW else _exponentials.__wrapped__)(generator.tobytes())
        after = steps[:, :2, 3]
        table = np.concatenate([steps[:, :2, :2].reshape(-1, 4), steps[:, :2, 2] - after, after], axis=1)
        still = distinct == 0
        table[still] = [1, 0, 0, 1, 0, 0, 0, 0]
        return np.ascontiguousarray(table[row])


def mechanical_response(dynamics: Dynamics | None, delay: float, frequency: Array) -> Array:
    """Return the frequency response (n,) from w to displacement at a `frequency` (n,) [Hz], with a `delay` [s]."""
    late = np.exp(-2j * np.pi * frequency * delay)
    if dynamics is None:
        return np.asarray(late)
    ratio = frequency / dynamics.frequency
    return np.asarray(late / (1 - ratio**2 + 2j * dynamics.damping * ratio))


def feedback_margins(dynamics: Dynamics | None, period: float, margin: float, *, preview: bool) -> tuple[float, float]:
    """Return gain and bandwidth [Hz], see `Actuator.margins`; `margin` is a ratio of gains, not in dB."""
    w = np.pi * np.geomspace(1e-5, 1, 20_000)
    z = np.exp(1j * w)
    gain = _UNKNOWN_GAIN
    if dynamics is not None:
        omega, damping = dynamics.omega * period, min(dynamics.damping, 0.999)
        root = np.sqrt(1 - damping**2)

        def response(radians: float) -> Array:
            """Response to a voltage that is constant in each step, for a resonance of `radians` per step."""
            pole, weight = np.exp(radians * (1j * root - damping)), 1 - 1j * damping / root
            swings = weight / (1 - pole / z) + np.conj(weight) / (1 - np.conj(pole) / z)
            return np.asarray(z - 0.5 * (z - 1) * swings)

        # The voltage of the model is linear between samples; a preview inverts the mass by differences of five points.
        pole = omega * (1j * root - damping)
        line = (z - 1) / pole**2 * (((z - 1) / (z - np.exp(pole))) - 1) - 1 / pole
        mirrored = (z - 1) / np.conj(pole) ** 2 * (((z - 1) / (z - np.exp(np.conj(pole)))) - 1) - 1 / np.conj(pole)
        first, second = 1j * (8 * np.sin(w) - np.sin(2 * w)) / 6, (32 * np.cos(w) - 2 * np.cos(2 * w) - 30) / 12
        ahead = 1 + (2 * damping * first + second / omega) / omega if preview else np.ones(w.size)
        meant = np.ones(w.size) if preview else omega**2 * (line - mirrored) / (pole - np.conj(pole))
        near = [response(omega * shift) * ahead for shift in (1 - _ASTRAY, 1.0, 1 + _ASTRAY)]
        # A reading comes up to half a step earlier or one step later than identified.
        wrong = np.max([np.abs(h * np.exp(-1j * w * late) - meant) for h in near for late in (-0.5, 0, 1)], axis=0)
        # At the limit |gain / (z - 1 + gain)| times wrong is 1 / margin.
        over, step = (margin * wrong) ** 2 - 1, np.abs(z - 1) ** 2
        gains = 2 * step / (step + np.sqrt(step**2 + 4 * np.maximum(over, 0) * step))
        gain = min(float(gains.min()), _LARGEST_GAIN)
    left = np.abs(1 - gain / (z - 1 + gain))
    return gain, float(w[np.argmax(left > np.sqrt(0.5))] / (2 * np.pi * period))


@lru_cache(maxsize=32)
def _exponentials(numbers: bytes) -> Array:
    """Return the exponentials of matrices (R, 4, 4), by scaling and squaring with Taylor's series."""
    matrices = np.frombuffer(numbers).reshape(-1, 4, 4)
    # Each matrix is halved only as often as it needs: every halving costs one bit of precision.
    size = np.abs(matrices).sum(axis=2).max(axis=1, initial=0.0)
    halvings = np.ceil(np.log2(np.maximum(size, 1.0))).astype(np.int64)
    result = np.empty_like(matrices)
    for count in np.unique(halvings):
        same = halvings == count
        scaled = matrices[same] / 2.0**count
        term = np.broadcast_to(np.eye(4), scaled.shape)
        total = term.copy()
        for k in range(1, _TERMS):
            term = term @ scaled / k
            total += term
        for _ in range(count):
            total = total @ total
        result[same] = total
    return result
