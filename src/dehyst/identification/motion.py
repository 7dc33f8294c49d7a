"""Effects between a record and the path of its hysteresis: delay, resonance, creep, drift, zero and temperature.

A record gives voltage and displacement. A few numbers determine the path that drives the elements: the delayed voltage,
and the displacement before creep and resonance, without drift, at the reference temperature. A small change of each
number moves that path by a known column. Therefore the same program finds these numbers and the stiffnesses, by
Gauss-Newton iterations: solve, move the path, solve again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.cleaning import derivatives
from dehyst.identification.preparation import Prepared, behind
from dehyst.identification.regressors import Rows
from dehyst.identification.rules import RULES
from dehyst.model import DisplacementCreep, Dynamics, Thermal
from dehyst.records import Record

# Number of time constants of creep per decade; slowest time constant, as a multiple of the longest record.
A_DECADE, _LONGEST = 2, 1.0
# Number of parts of the temperature range; least number of parts in which the records must have samples.
_PLACES, _FEWEST = 8, 3

_nothing = partial(np.zeros, 0)


@dataclass(frozen=True, eq=False)
class Motion:
    """Numbers of the effects between records and the path of the hysteresis.

    Attributes
    ----------
    delay, lag : float
        Delay of the displacement after the voltage, and time constant of the amplifier [s].
    damping, mass : float
        2 zeta / omega [s] and 1 / omega^2 [s2]; without a resonance mass is 0.
    time_constants, gains : (K,) array
        Time constants [s] and gains of creep in displacement.
    creep_before : (records, K) array
        Creep strain of each record at its first sample, times the gain [m].
    drift, zero : (records,) array
        Drift [m per unit of the record's drift curve], and shift to the axis of the model [m].
    warming, expansion : float
        Changes per kelvin: of the gain [1/K], and of the displacement at the lowest voltage [m/K].
    reference : float or None
        Temperature [degC] at which both changes are 0; None without an effect of temperature.
    lowest : float
        Displacement at the lowest voltage [m], which the gain does not change.
    hidden : float
        Creep per decade, as a part of a step, that the records neither show nor exclude.
    """

    delay: float = 0.0
    lag: float = 0.0
    damping: float = 0.0
    mass: float = 0.0
    time_constants: Array = field(default_factory=_nothing)
    gains: Array = field(default_factory=_nothing)
    creep_before: Array = field(default_factory=_nothing)
    drift: Array = field(default_factory=_nothing)
    zero: Array = field(default_factory=_nothing)
    warming: float = 0.0
    expansion: float = 0.0
    reference: float | None = None
    lowest: float = 0.0
    hidden: float = 0.0

    @classmethod
    def none(cls, records: int) -> Motion:
        """Return the numbers of records without any of these effects."""
        return cls(creep_before=np.zeros((records, 0)), drift=np.zeros(records), zero=np.zeros(records))

    @property
    def dynamics(self) -> Dynamics | None:
        """The resonance; None without one."""
        if not self.mass > 0:
            return None
        omega = 1 / np.sqrt(self.mass)
        return Dynamics(float(omega / (2 * np.pi)), float(0.5 * self.damping * omega))

    @property
    def thermal(self) -> Thermal | None:
        """Gain and offset by temperature; None without an effect."""
        if self.reference is None:
            return None
        return Thermal(self.warming, self.expansion - self.warming * self.lowest, self.reference)

    @property
    def creep(self) -> DisplacementCreep | None:
        """Creep in displacement, with the branches whose gain is not 0; None if all gains are 0."""
        kept = self.gains > 0
        return DisplacementCreep(self.time_constants[kept], self.gains[kept]) if kept.any() else None

    @property
    def at_rest(self) -> float:
        """Displacement with creep at rest over the displacement before creep."""
        return 1.0 + float(self.gains.sum())

    def before(self, item: Prepared, number: int) -> Prepared:
        """Return a record without drift, temperature and creep; `number`: its place in the arrays."""
        if drift := float(self.drift[number]):
            item = item.changed(lambda piece: piece.displacement - drift * item.drift_curve(piece))
        if (thermal := self.thermal) is not None:
            item = item.at_reference(thermal)
        if (creep := self.creep) is not None:
            kept = self.gains > 0
            item = item.without_creep(creep, self.creep_before[number][kept] / self.gains[kept])
        return item


def creep_times(fastest: float, longest: float) -> Array:
    """Return time constants [s] of creep branches, evenly spaced in their logarithm."""
    last = _LONGEST * longest
    return np.geomspace(fastest, last, max(2, round(A_DECADE * np.log10(max(last / fastest, 1.01))) + 1))


@dataclass(frozen=True, eq=False)
class Part:
    """Columns of a part in the program.

    `name`: name of the part. `columns` (n, k): motion of the path per unit of each number [m], or with `volts` change
    of the voltage [V]. `value` (k,): numbers already applied to the path. `bounded`: whether the numbers must not be
    negative. `ridge` (p, k): rows that pull the numbers to 0 or to each other, relative to the RMS of the columns.
    """

    name: str
    columns: Array
    value: Array
    bounded: bool = False
    ridge: Array = field(default_factory=lambda: np.zeros((0, 0)))
    volts: bool = False


class Parts:
    """The columns of parts at the rows of a program."""

    def __init__(self, motion: Motion, training: Sequence[Prepared], rows: Rows) -> None:
        self.motion, self.training, self.rows = motion, training, rows

    @cached_property
    def before(self) -> list[Prepared]:
        """The records without drift, temperature and creep."""
        return [self.motion.before(item, q) for q, item in enumerate(self.training)]

    def of(self, names: Sequence[str]) -> list[Part]:
        """Return the parts with these names."""
        return [getattr(self, f"_{name}")() for name in names]

    def _at_rows(self, columns: Sequence[tuple[Array, Array]]) -> Array:
        """Interpolate times and columns (n, k) of each record at the rows."""
        rows, found = self.rows, np.zeros((len(self.rows), columns[0][1].shape[1]))
        for q, (time, values) in enumerate(columns):
            own = rows.record == q
            found[own] = np.column_stack([np.interp(rows.time[own], time, column) for column in values.T])
        return found

    def _for_each_record(self, columns: Array) -> Array:
        """Return columns (n, k) as one block per record (n, R k)."""
        count = len(self.training)
        own = self.rows.record[:, None] == np.arange(count)
        return np.asarray((own[:, :, None] * columns[:, None, :]).reshape(len(columns), -1))

    def _delay(self) -> Part:
        return Part("delay", self._rates(0.0), np.array([self.motion.delay]), volts=True)

    def _lag(self) -> Part:
        # A larger lag changes the voltage v behind the low-pass by -w, with w + lag w' = v'.
        return Part("lag", self._rates(self.motion.lag), np.array([self.motion.lag]), volts=True)

    def _rates(self, lag: float) -> Array:
        """Return the low-pass filtered rates of the acting voltages at the rows (n, 1) [V/s]."""
        found = []
        for item in self.training:
            acting = item.acting(self.motion.delay, self.motion.lag)
            rates = [replace(path, voltage=np.gradient(path.voltage, path.time)) for path in acting]
            volts = np.concatenate([behind(rate, lag).voltage for rate in rates])
            found.append((np.concatenate([rate.time for rate in rates]), volts[:, None]))
        return self._at_rows(found)

    def _inertia(self) -> Part:
        found = []
        for item in self.before:
            moves = [np.column_stack(derivatives(piece)) for piece in item.pieces]
            found.append((np.concatenate([piece.time for piece in item.pieces]), np.concatenate(moves)))
        return Part("inertia", self._at_rows(found), np.array([self.motion.damping, self.motion.mass]), bounded=True)

    def _creep(self) -> Part:
        motion, found = self.motion, []
        part = DisplacementCreep(motion.time_constants, np.zeros(motion.time_constants.size))
        for item in self.before:
            time, m = item.with_lead
            found.append((time, m[:, None] - part.strains(time, m)))
        # Neighbouring gains are similar; the gain beyond the slowest branch is 0.
        alike = np.diff(np.eye(motion.time_constants.size + 1), axis=0)[:, :-1]
        return Part("creep", -self._at_rows(found), motion.gains, bounded=True, ridge=alike)

    def _creep_before(self) -> Part:
        first, motion = np.array([item.with_lead[0][0] for item in self.training]), self.motion
        since = np.maximum(self.rows.time - first[self.rows.record], 0.0)
        fades = np.exp(-since[:, None] / motion.time_constants)
        size = len(self.training) * motion.time_constants.size
        return Part("creep_before", self._for_each_record(fades), motion.creep_before.ravel(), ridge=np.eye(size))

    def _drift(self) -> Part:
        curves = [(item.record.time, item.drift_curve(item.record)[:, None]) for item in self.training]
        return Part("drift", -self._for_each_record(self._at_rows(curves)), self.motion.drift)

    def _zero(self) -> Part:
        moved = np.flatnonzero(self.motion.zero)
        columns = (self.rows.record[:, None] == moved) / self.motion.at_rest
        return Part("zero", columns, self.motion.zero[moved])

    def _thermal(self) -> Part:
        columns = (self.rows.displacement[:, None] - self.motion.lowest) * self._kelvins
        return Part("thermal", -columns, np.array([self.motion.warming]))

    def _expansion(self) -> Part:
        # Only the place of the loops on the spring shows the expansion, which is weak evidence: the ridge is large.
        return Part("expansion", -self._kelvins, np.array([self.motion.expansion]), ridge=0.5 * np.eye(1))

    @cached_property
    def _kelvins(self) -> Array:
        """Temperatures minus the reference at the rows (n, 1) [K]."""
        found, reference = [], self.motion.reference
        assert reference is not None
        for item in self.training:
            temperature = item.record.temperature
            assert temperature is not None
            found.append((item.record.time, temperature[:, None] - reference))
        return self._at_rows(found)


# Parts with a single number, and the name of the number in `Motion`.
_NUMBERS = {"delay": "delay", "lag": "lag", "thermal": "warming", "expansion": "expansion"}


def moved(motion: Motion, names: Sequence[str], numbers: dict[str, Array]) -> Motion:
    """Return the motion with the numbers that a program found for some parts."""
    found = dict[str, Any]()
    for name in names:
        value = numbers[name]
        if name in _NUMBERS:
            found[_NUMBERS[name]] = max(float(value[0]), 0.0 if name == "lag" else -np.inf)
        elif name == "inertia":
            found["damping"], found["mass"] = value.tolist()
        elif name == "zero":
            found["zero"] = motion.zero.copy()
            found["zero"][np.flatnonzero(motion.zero)] = value
        elif name == "creep_before":
            found["creep_before"] = value.reshape(motion.creep_before.shape)
        else:
            found["gains" if name == "creep" else name] = value
    return replace(motion, **found)


@dataclass(frozen=True)
class Temperatures:
    """Temperatures of records.

    `low`, `high`: lowest and highest [degC]. `reference`: their mean [degC].
    """

    low: float
    high: float
    reference: float

    @property
    def left_out(self) -> str:
        """Words for a model without the effect of temperature."""
        return f"the temperature changes from {self.low:.3g} to {self.high:.3g} degC, which the model leaves out"

    def sentence(self, motion: Motion, errors: dict[str, float], better: float) -> str:
        """Return a sentence with the effect of temperature.

        `errors`: standard errors of the gain, "thermal" [1/K], and of the "expansion" [m/K] if it was found.
        `better`: held-out error, relative to the error without the effect.
        """
        shift = " The held-out error does not show whether the displacement also shifts as a whole."
        found = f"the stroke changes by {100 * motion.warming:+.3g} ± {100 * errors['thermal']:.2g} %/K"
        if "expansion" in errors:
            change = f"{1e9 * motion.expansion:+.3g} ± {1e9 * errors['expansion']:.2g} nm/K"
            found, shift = f"{found} and the displacement at the lowest voltage changes by {change}", ""
        return (
            f"From {self.low:.3g} to {self.high:.3g} degC {found}. The held-out error is {100 * better:.0f} % of the "
            f"error without this effect.{shift}"
        )


def temperatures_of(records: Sequence[Record]) -> tuple[Temperatures | None, str]:
    """Return the temperatures of `records` of one axis, and the reason if they cannot show an effect.

    The temperatures are None if they change by less than `DecisionRules.temperatures`; the reason is then empty. All
    records need a temperature.
    """
    known = [record.temperature for record in records if record.temperature is not None]
    if not known:
        return None, ""
    every = np.concatenate(known)
    low, high = float(every.min()), float(every.max())
    if high - low < RULES.temperatures:
        return None, ""
    found = Temperatures(low, high, float(every.mean()))
    if len(known) < len(records):
        missing = next(record.name for record in records if record.temperature is None)
        return None, f"{found.left_out}: {missing} has none"
    if np.count_nonzero(np.histogram(every, _PLACES)[0]) < _FEWEST:
        return None, f"{found.left_out}: record {_FEWEST} temperatures or more"
    return found, ""
