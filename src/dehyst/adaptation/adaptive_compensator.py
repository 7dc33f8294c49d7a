"""A compensator that adapts the weights of its model to a sensor's measurements."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import exp, isnan, nan
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from dehyst import _validation as check
from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst._types import Array, Mask
from dehyst._units import per_metre
from dehyst.adaptation.estimator import Estimator, Exchange, PathCycle
from dehyst.control import Compensator, Snapshot, VoltageLimits, unchanged_by_errors
from dehyst.model import Actuator, State, looped
from dehyst.model import serialization as files

FORMAT = "dehyst-adaptive-loop"
# Samples of a cycle in the loop at most, of any cycle at least, and those after which turns are looked for.
_MOST, FEWEST, _DUE = 4096, 24, 32
# The integral action moves the path by this part of the reach at most.
_INTEGRAL = 0.1
# Seconds from one end of a slow loop to its middle.
_SLOWLY = 1e4


@dataclass(frozen=True, eq=False)
class AdaptiveSnapshot(files.JsonFile):
    """The memory of an adaptive loop.

    `loop`: the snapshot of the compensator. `learnt`: arrays of the estimator by name.
    """

    loop: Snapshot
    learnt: Mapping[str, Array]

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; `from_dict` reads them back without loss."""
        learnt = {name: values.tolist() for name, values in self.learnt.items()}
        return {"format": FORMAT, "version": 1, "loop": self.loop.as_dict(), "learnt": learnt}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> AdaptiveSnapshot:
        """Rebuild from the `data` of `as_dict`, strictly; raise `ModelError` if it is not a valid snapshot."""
        files.demand_format(data, FORMAT)
        files.demand_keys(data, {"format", "version", "loop", "learnt"}, "snapshot")
        if not isinstance(data["learnt"], Mapping):
            raise ModelError(argument="snapshot: learnt", got=type(data["learnt"]).__name__, need="an object")
        learnt = {name: files.numbers(values, f"learnt.{name}") for name, values in data["learnt"].items()}
        return cls(Snapshot.from_dict(data["loop"]), learnt)


class Drift(NamedTuple):
    """Changes of a model in use relative to the initial one, on a slow loop between the limits.

    Where the path does not go, the initial model counts: after a narrow path the changes here are smaller than on it.

    `gain`: of the displacement. `width`: of the loop as a part of the stroke. `offset`: sensor reading minus the
    model's displacement [m, or `units`], which is not learnt.
    """

    gain: float
    width: float
    offset: float


class AdaptiveCompensator:
    """A `Compensator` whose model is adapted to the displacements that a sensor measures.

    ``measured`` is the present displacement, due to the voltages sent so far; None or NaN if there is no measurement::

        compensator = dehyst.AdaptiveCompensator(actuator, (0, 100), slew_rate=2e4, period=1e-4)
        for wanted in path:
            dac.write(compensator.step(wanted, sensor.read()))

    Stiffnesses of slip and smooth elements, of creep branches and of the spring are learnt, cycle by cycle, by
    non-negative least squares with a prior (theory sections 8 and 21). Thresholds, transformer, delay and inertia stay.
    New weights are used only if they predict the next cycle, before it is learnt, better than the weights in use. An
    exchange of weights keeps the hysteresis state, and the voltage changes no faster than the slew rate. Creep in
    displacement and the effect of temperature stay too: what is learnt is the displacement without them.

    A cycle is not learnt if the sensor is missing, stuck or saturated in most of it, if the sensor contradicts the
    path, or if the path moves less than a breakaway elongation. Samples with a clamped voltage are not learnt either.
    `log` holds each decision and its reason.

    Parameters
    ----------
    actuator, limits, slew_rate, period, state, units, warns
        As in `Compensator`; `measured` is in `units` too.
    memory : float, optional
        Number of cycles after which the weight of a cycle has fallen to a third.
    time_constant : float, optional
        Time [s] after which the weight of a cycle has fallen to a third, instead of `memory`; needs a period.
    zero_drifts : bool, optional
        Whether the sensor's zero may differ from the zero of the model's records, and drift (default). No loop can
        distinguish such a drift from a motion of the whole actuator. An offset at the beginning is then not learnt, and
        a later one only as far as a change of gain and loop width explains it. `datum` holds the rest.
    integral_time : float, optional
        Time constant [s] of an integral action on the measured error. It trusts the sensor's zero and needs a period.
        It pauses while a voltage is clamped or nothing is measured. Default: no integral action.

    Attributes
    ----------
    learning : bool
        Set it to False to keep the present weights.

    Raises
    ------
    ModelError
        As `Compensator`, or if a number is impossible.
    """

    def __init__(
        self,
        actuator: Actuator,
        limits: Sequence[float] | None = None,
        slew_rate: float | None = None,
        *,
        period: float | None = None,
        state: State | None = None,
        units: str = "m",
        warns: bool = True,
        memory: float = 10.0,
        time_constant: float | None = None,
        zero_drifts: bool = True,
        integral_time: float | None = None,
    ) -> None:
        compensator = Compensator(actuator, limits, slew_rate, period=period, state=state, units=units, warns=warns)
        self._begin_in(compensator, memory, time_constant, zero_drifts, integral_time)

    @classmethod
    def within(cls, compensator: Compensator, memory: float, time_constant: float | None, *, zero_drifts: bool) -> Self:
        """Return an adaptive loop that changes the model of a `compensator` which others step: see `took`.

        `memory`, `time_constant`, `zero_drifts`: as at the construction.
        """
        made = cls.__new__(cls)
        made._begin_in(compensator, memory, time_constant, zero_drifts, None)
        return made

    def _begin_in(
        self,
        compensator: Compensator,
        memory: float,
        time_constant: float | None,
        zero_drifts: bool,
        integral_time: float | None,
    ) -> None:
        self._compensator, period = compensator, compensator.period
        for name, value, least in (
            ("memory", memory, 1.0),
            ("time_constant", time_constant, 0.0),
            ("integral_time", integral_time, 0.0),
        ):
            if value is None:
                continue
            if not least < check.number(value, name) < np.inf:
                raise ModelError(argument=name, got=repr(value), need=f"a number above {least:g}")
            if name != "memory" and period is None:
                raise ModelError(f"{name} needs the time between steps", hint="give the period [s]", change=("period",))
        self._memory, self._time_constant, self.learning = float(memory), time_constant, True
        self._estimator = Estimator(compensator.actuator, compensator.state, zero_drifts)
        self._origin = np.array([float(compensator.model_ids()[0])])
        self._rate = 0.0 if integral_time is None or period is None else period / integral_time
        low, high = compensator.reach
        self._most_correction, self._correction = _INTEGRAL * (high - low), 0.0
        self._per_metre = per_metre(compensator.units)
        # Gain and offset [units] of the present temperature, once one is given.
        self._scaling: tuple[float, float] | None = None
        self._begin()

    def _begin(self) -> None:
        """Forget the samples of the cycle under way."""
        delay, period = self._estimator.weights.actuator.delay, self._compensator.period
        # A measured displacement belongs to the voltage of the step before, or of a delay before that.
        self._sent = deque[tuple[float, float]](maxlen=1 + (round(delay / period) if period else 0))
        self._rows: list[tuple[float, float, float]] = []
        self._work: Iterator[Actuator | None] | None = None
        self._stride, self._steps = 1, 0
        self._turns = _Turns(self._estimator.least_motion * self._per_metre)

    def __repr__(self) -> str:
        used = sum(one.used for one in self.log)
        return f"<AdaptiveCompensator: {used} exchanges in {len(self.log)} cycles, {self._compensator!r}>"

    def step(self, wanted: float, measured: float | None = None, temperature: float | None = None) -> float:
        """Return the voltage [V] to send for a displacement `wanted` now, and commit it.

        `wanted`, `measured`: [m, or `units`]; `measured` is the displacement before this step, None or NaN if unknown.
        `temperature`: as in `Compensator.step`.

        Raises
        ------
        ModelError
            If `wanted` is not finite or `measured` is not a number, or the temperature is refused: the memory is
            unchanged, and no time has passed.

        Warns
        -----
        ClampWarning
            As `Compensator.step`.
        """
        if measured is None:
            measured = nan
        elif not isinstance(measured, float):
            measured = check.number(measured, "measured", self._compensator.units)
        scaling, correction = self._scaling, self._correction
        if temperature is not None:
            gain, offset = self._compensator.scaling_at(temperature, 1)
            scaling = float(gain[0]), float(offset[0]) * self._per_metre
        if self._rate and self._sent:
            correction = self._corrected(self._sent[-1], measured, scaling or (1.0, 0.0))
            wanted = check.number(wanted, "wanted", self._compensator.units) + correction
        voltage = self._compensator.step(wanted, temperature)
        self._scaling, self._correction = scaling, correction
        self.took(wanted, voltage, measured)
        return voltage

    def took(self, wanted: float, voltage: float, measured: float) -> None:
        """Note a step that others took, and learn.

        `wanted`, `measured`: as in `step`; `voltage`: sent [V].
        """
        if self._scaling is not None:
            wanted, measured = self._at_reference(wanted), self._at_reference(measured)
        sent = self._sent
        self._steps += 1
        if len(sent) == sent.maxlen and not self._steps % self._stride:
            self._rows.append((*sent[0], measured))
            if self._work is not None or len(self._rows) >= self._turns.seen + _DUE:
                self._advance()
        sent.append((float(wanted), voltage))

    def set_temperature(self, temperature: float) -> None:
        """Set the `temperature` [degC] for all further steps and cycles.

        Raise `ModelError` as `Compensator.set_temperature`.
        """
        self._compensator.set_temperature(temperature)
        self.rescale()

    def rescale(self) -> None:
        """Use the gain and offset that others set in the compensator for all further steps and cycles."""
        self._scaling = None if self.actuator.thermal is None else self._compensator.scaling

    def _at_reference(self, displacement: Any) -> Any:
        """Return a displacement [m, or `units`] at the reference temperature."""
        if self._scaling is None:
            return displacement
        gain, offset = self._scaling
        return (displacement - offset) / gain

    def _corrected(self, last: tuple[float, float], measured: float, scaling: tuple[float, float]) -> float:
        """Return the integral action's next addition to the path; it pauses while a voltage is clamped.

        `last`: wanted displacement, without gain and offset, and voltage [V] of the last step. `scaling`: both.
        """
        wanted, voltage = last
        gain, offset = scaling
        low, high = self._compensator.limits
        if not isnan(measured) and low < voltage < high and not self._contradicted:
            # The path that was wanted is that without the correction before.
            error = gain * wanted + offset - self._correction - measured
            limit = self._most_correction
            return min(max(self._correction + self._rate * error, -limit), limit)
        return self._correction

    @property
    def _contradicted(self) -> bool:
        """Whether the last cycle was refused because of its sensor."""
        log = self._estimator.log
        return bool(log) and isnan(log[-1].error)

    def _advance(self) -> None:
        """Do a bounded amount of the pending work."""
        if self._work is None:
            end = self._turns.cycle(self._rows)
            if end:
                self._work = self._estimator.learn(*self._cut(end))
            elif len(self._rows) >= _MOST:
                # A slow path: every second sample shows it as well.
                self._rows, self._stride = self._rows[::2], 2 * self._stride
                self._turns.halve()
            return
        actuator = next(self._work, self)
        if actuator is self:
            self._work = None
        elif isinstance(actuator, Actuator) and self.learning:
            self._compensator.exchange(actuator)

    def _cut(self, end: int) -> tuple[PathCycle, float]:
        """Take the first samples as a cycle; return it, and its factor on the weight of the cycles before."""
        table = np.array(self._rows[:end])
        del self._rows[:end]
        return self._cycle(table, self._stride)

    def _cycle(self, table: Array, stride: int = 1) -> tuple[PathCycle, float]:
        """Return the cycle of a table (n, 3), every `stride`-th sample: displacement wanted, voltage, measured."""
        sent, period = table[:, 1], self._compensator.period
        seconds = None if period is None else period * stride
        clamped = self.clamped(sent, seconds)
        wanted, measured = table[:, 0] / self._per_metre, table[:, 2] / self._per_metre
        measured[~np.isfinite(measured)] = nan
        keep = exp(-1 / self._memory)
        if self._time_constant is not None and seconds is not None:
            keep = exp(-len(table) * seconds / self._time_constant)
        return PathCycle(wanted, measured, sent, clamped, self._steps, seconds), keep

    def plan(self, displacement: ArrayLike, pause: float = 0.0) -> Array:
        """Return the voltages (n,) [V] of a cycle that will be played as a whole; nothing is committed.

        `displacement` (n,): wanted [m, or `units`], as of n calls of `step`. `pause`: time [s] for which the last
        voltage is held before. After the cycle call `learn`. Raises and warns as `Compensator.run`; raises `ModelError`
        too if `pause` is no time of 0 or more.
        """
        before = self._compensator.snapshot()
        try:
            self._hold(pause)
            return self._compensator.run(displacement)
        finally:
            self._compensator.restore(before)

    def learn(self, displacement: ArrayLike, voltage: ArrayLike, measured: ArrayLike, pause: float = 0.0) -> None:
        """Commit a cycle (n,) that was played as a whole, and learn from it; then new weights may be in use.

        `displacement`: as given to `plan`. `voltage`: sent [V]. `measured` [m, or `units`]: displacement at each of
        these samples; NaN if unknown. `pause`: time [s] for which the last voltage was held before.

        Raise `ModelError` if lengths differ, there are fewer than 24 samples, a wanted displacement is not finite, or a
        voltage is not one of these limits: the memory is unchanged.
        """
        units = self._compensator.units
        columns = [
            check.vector(displacement, "displacement", units),
            check.vector(voltage, "voltage"),
            check.readings(measured, "measured", units),
        ]
        wanted, sent, seen = (one.size for one in columns)
        if not wanted == sent == seen or wanted < FEWEST:
            got = f"{seen} values for {wanted} displacements and {sent} voltages"
            raise ModelError(argument="measured", got=got, need=f"one for each, of {FEWEST} samples at least")
        before = self._compensator.state.displacement
        with unchanged_by_errors((self._compensator,)):
            self._hold(pause)
            crept = self._compensator.state.displacement - before
            for one in columns[1].tolist():
                self._compensator.commit(one)
        self._estimator.pause(pause, crept)
        columns[0], columns[2] = self._at_reference(columns[0]), self._at_reference(columns[2])
        late = (self._sent.maxlen or 1) - 1
        columns[2] = np.append(columns[2][late:], np.full(late, nan))
        self._steps += wanted
        for actuator in self._estimator.learn(*self._cycle(np.column_stack(columns))):
            if actuator is not None and self.learning:
                self._compensator.exchange(actuator)

    def clamped(self, voltage: Array, seconds: float | None = None) -> Mask:
        """Return which samples of a `voltage` (n,) [V] are at a limit, or as steep as is allowed.

        `seconds`: time between samples [s]; default: the period.
        """
        loop = self._compensator
        found = (voltage <= loop.limits[0]) | (voltage >= loop.limits[1])
        between = seconds or loop.period
        if between is not None and loop.slew_rate is not None:
            change = loop.bounds.largest_step(between) * (1 - 1e-9)
            found |= np.abs(np.diff(voltage, prepend=voltage[:1])) >= change
        return found

    def _hold(self, seconds: float) -> None:
        if not check.number(seconds, "pause") >= 0:
            raise ModelError(argument="pause", got=repr(seconds), need="a time [s] of 0 or more")
        for _ in range(round(seconds / self._compensator.period) if self._compensator.period else 0):
            self._compensator.hold()

    @property
    def actuator(self) -> Actuator:
        """The model in use; save it to start with it next time."""
        return self._compensator.actuator

    @property
    def voltage(self) -> float:
        """The last voltage sent [V]."""
        return self._compensator.voltage

    @property
    def state(self) -> State:
        """State of the actuator after all voltages sent."""
        return self._compensator.state

    @property
    def bounds(self) -> VoltageLimits:
        """Limits and slew rate."""
        return self._compensator.bounds

    @property
    def reach(self) -> tuple[float, float]:
        """As `Compensator.reach`, of the model in use."""
        return self._compensator.reach

    @property
    def clamps(self) -> tuple[int, int]:
        """Number of samples clamped at a limit, and by the slew rate."""
        return self._compensator.clamps

    @property
    def datum(self) -> float:
        """Sensor reading minus the model's displacement [m, or `units`]: the offset that is not learnt."""
        return self._estimator.datum * self._per_metre

    @property
    def log(self) -> tuple[Exchange, ...]:
        """The last thousand cycles: whether weights were exchanged, and if not, why."""
        return tuple(self._estimator.log)

    @property
    def drift(self) -> Drift:
        """What has changed so far, as far as it is learnt."""
        (stroke, width), (stroke_now, width_now) = (
            _slow_loop(one, self._compensator.limits) for one in (self._estimator.weights.actuator, self.actuator)
        )
        gain = stroke_now / stroke
        return Drift(gain - 1, width_now / width / gain - 1 if width else 0.0, self.datum)

    def snapshot(self) -> AdaptiveSnapshot:
        """Finish the learning under way, and return the whole memory except the samples of the present cycle."""
        while self._work is not None:
            self._advance()
        return AdaptiveSnapshot(self._compensator.snapshot(), self._numbers())

    def _numbers(self) -> dict[str, Array]:
        """Return what was learnt, by name; "origin" is the checksum of the actuator with which the loop began."""
        return self._estimator.numbers() | {"correction": np.array([self._correction]), "origin": self._origin}

    def restore(self, snapshot: AdaptiveSnapshot) -> None:
        """Continue from a `snapshot` of a loop that began with the same actuator; this empties the log.

        Raise `ModelError` if the snapshot belongs to another actuator, period or preview, lies outside of the limits,
        or is damaged: the memory is unchanged.
        """
        if not isinstance(snapshot, AdaptiveSnapshot):
            raise ModelError(argument="snapshot", got=type(snapshot).__name__, need="an AdaptiveSnapshot")
        given = self._numbers()
        learnt = {"before": EMPTY, "origin": given["origin"], **snapshot.learnt}
        same = given.keys() == learnt.keys() and all(
            learnt[name].size == values.size for name, values in given.items() if name not in {"usual", "before"}
        )
        same = same and learnt["before"].size in {0, given["factors"].size + 1}
        if not same or not np.array_equal(learnt["origin"], given["origin"]):
            raise ModelError("it is of another actuator", argument="snapshot", hint="make the loop as it was")
        mine = self._compensator.snapshot(), self.actuator
        try:
            self._compensator.exchange(self._estimator.restore(learnt))
            self._compensator.restore(snapshot.loop)
        except ModelError:
            self._estimator.restore(given)
            self._compensator.exchange(mine[1])
            self._compensator.restore(mine[0])
            raise
        self._estimator.log.clear()
        self._correction = float(learnt["correction"][0])
        self.rescale()
        self._begin()


def _slow_loop(actuator: Actuator, limits: tuple[float, float]) -> tuple[float, float]:
    """Return stroke [m] of a slow loop between limits [V], and its width [m] in the middle."""
    low, high = limits
    swing = np.array([low, 0.5 * (low + high), high, 0.5 * (low + high)])
    time = _SLOWLY * np.arange(swing.size) if actuator.needs_time else None
    state = looped(actuator, limits, rising=False)
    y = actuator.simulate(swing, time=time, state=state, extrapolate=True).displacement
    return float(y[2] - y[0]), float(y[3] - y[1])


class _Turns:
    """Turns of a path followed by at least `least` motion; every second one ends a cycle. `seen`: samples processed."""

    def __init__(self, least: float) -> None:
        self.least, self.seen = least, 0
        self._count, self._direction, self._extreme, self._at = 0, 0, nan, 0

    def cycle(self, rows: Sequence[tuple[float, float, float]]) -> int:
        """Process new `rows`, the wanted displacement in front; return the end of the first cycle, or 0."""
        for place in range(self.seen, len(rows)):
            wanted = rows[place][0]
            moved = wanted - self._extreme
            if isnan(moved) or moved * self._direction > 0:
                self._extreme, self._at = wanted, place
            elif abs(moved) > self.least:
                end, self._extreme, self._at = self._at, wanted, place
                self._count += self._direction != 0
                self._direction = 1 if moved > 0 else -1
                if self._count >= 2 and end >= FEWEST:
                    self._count, self.seen, self._at = 0, place + 1 - end, place - end
                    return end
        self.seen = len(rows)
        return 0

    def halve(self) -> None:
        """Continue after every second row was dropped."""
        self.seen, self._at = (self.seen + 1) // 2, self._at // 2
