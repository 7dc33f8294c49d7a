"""Voltages of a whole path, within limits and slew rate, with a warning if they are clamped."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._native import CoreState
from dehyst._text import counted
from dehyst._types import Array, Mask
from dehyst._units import per_metre
from dehyst._validation import vector
from dehyst._views import html, tables
from dehyst._views.lines import length, span_of
from dehyst.control.limits import TIME_NEEDED, VoltageLimits, outside_identified
from dehyst.model import Actuator, Motion, PathData, Promise, State, promised

if TYPE_CHECKING:
    from pandas import DataFrame

_CHUNK = 64
_ANY = float(np.finfo(np.float64).max)
# The code of `Loop.trace` for an offer that was not clamped.
_NOT_CLAMPED = 1
_ROUNDING = 1e-12
# Share of the range of the spring's knots: a larger miss gives a warning.
_LARGE_MISS = 1e-3
# Most runs of equal steps for which a loop is set up.
_FEW = 64


@dataclass(frozen=True, eq=False)
class Command:
    """A voltage to send.

    Attributes
    ----------
    voltage : (n,) array
        Voltage [V], within limits and slew rate.
    displacement : (n,) array
        The displacement of the model [m]: the wanted path, except where the voltage was clamped; simulated for an
        actuator with dynamics or a lag.
    clamped : (n,) bool array
        Samples whose voltage was changed.
    state : State
        State after the clamped voltage.
    warnings : tuple of str
        Sentences on clamped voltages, and on other reasons why the path is missed; may be empty.
    missed : float
        Largest distance [m] of `displacement` from the wanted path.
    units : str
        Unit of `displacement` and `missed`, as in the compensator, by default "m".
    followed : bool
        Whether nothing was clamped and `missed` is at most a thousandth of the range of the spring's knots.
    time : (n,) array or None
        Time of the samples [s], if it was given.
    actuator : Actuator or None
        The model with which it was computed.
    temperature : (n,) array or None
        Temperature of the samples [degC], if it was given.
    """

    voltage: Array
    displacement: Array
    clamped: Mask
    state: State
    warnings: tuple[str, ...]
    missed: float
    followed: bool
    units: str = "m"
    time: Array | None = None
    actuator: Actuator | None = None
    temperature: Array | None = None

    @cached_property
    def promise(self) -> Promise | None:
        """Promised error of the path [m], in addition to `missed`; None if the model does not know its records."""
        if self.actuator is None:
            return None
        return promised(self.actuator, self.voltage, self.time, self.temperature)[0]

    def in_units(self, units: str) -> Command:
        """Return the command with its displacements converted from metres to `units`, such as "um"."""
        counts = per_metre(units)
        return replace(self, displacement=self.displacement * counts, missed=self.missed * counts, units=units)

    def __repr__(self) -> str:
        voltage, displacement = span_of(self.voltage, "V"), span_of(self.displacement, "um", self._um)
        return f"<Command: {counted(self.voltage.size, 'sample')}, {voltage}, {displacement}, {self._clamps()}>"

    def _repr_html_(self) -> str:
        rows = [
            ("samples", self.voltage.size),
            ("voltage", span_of(self.voltage, "V")),
            ("displacement", span_of(self.displacement, "µm", self._um)),
            ("clamped", self._clamps()),
        ]
        colour = "green" if self.followed else "amber"
        return html.block("Command", html.facts(rows), html.folded("Warnings", self.warnings), colour=colour)

    @property
    def _um(self) -> float:
        """Number of micrometres in one of `units`."""
        return 1e6 / per_metre(self.units)

    def _clamps(self) -> str:
        count = int(np.count_nonzero(self.clamped))
        missed = "" if self.followed else f", path missed by up to {length(self.missed / per_metre(self.units))}"
        return f"{f'{count} clamped' if count else 'nothing clamped'}{missed}"

    def to_dataframe(self) -> DataFrame:
        """Return the columns voltage_V, displacement_um and clamped as a pandas DataFrame.

        Raise `MissingExtraError` if pandas is not installed.
        """
        columns = {"voltage_V": self.voltage, "displacement_um": self.displacement * self._um, "clamped": self.clamped}
        return tables.frame(columns)


def _shortfall(voltage: Array, clamped: Mask, limits: VoltageLimits, missed: float) -> str:
    """Return a sentence on a path that is `missed` [m]: its clamped voltages (n,) [V], or another reason."""
    if not clamped.any():
        # Then only a mass or an amplifier can be left behind.
        return (
            f"the path is missed by up to {missed * 1e6:.4g} um, though nothing was clamped: it does not begin at the "
            "actuator's state, or moves too fast for its sample rate"
        )
    count = int(np.count_nonzero(clamped))
    at_limit = int(np.count_nonzero(clamped & ((voltage <= limits.low) | (voltage >= limits.high))))
    return (
        f"CLAMPED: {count} of {voltage.size} voltages ({at_limit} at the limits {limits.words}, {count - at_limit} "
        f"by the slew rate), the first at sample {int(np.argmax(clamped))}; the path is missed by up to "
        f"{missed * 1e6:.4g} um"
    )


def of_axis(command: Command, wanted: Array, reached: Array, limits: VoltageLimits) -> Command:
    """Return a command with the displacement `reached` (n,) [m] of its axis, and how far it misses the `wanted`.

    `limits`: those of the voltage.
    """
    missed = float(np.abs(wanted - reached).max(initial=0.0))
    own = () if command.followed else (_shortfall(command.voltage, command.clamped, limits, missed),)
    return replace(command, displacement=reached, missed=missed, warnings=(*own, *command.warnings[len(own) :]))


def follow(
    actuator: Actuator,
    limits: VoltageLimits,
    displacement: ArrayLike,
    *,
    time: ArrayLike | None,
    period: float | None,
    load: ArrayLike | None,
    velocity: ArrayLike | None,
    acceleration: ArrayLike | None,
    start: State,
    present: float,
) -> Command:
    """Compute the voltages for a path, with the state after the clamped ones; see `Compensator.trajectory`.

    `start` is the state, and `present` the voltage [V], before the first sample.
    """
    wanted = vector(displacement, "displacement")
    if time is None and period is not None:
        time = period * np.arange(wanted.size)
    steps = limits.steps(wanted.size, time, period)
    path, state = _Path(actuator, wanted, time, load, velocity, acceleration), start
    # Raises if the time is missing or does not fit. Of few runs of equal steps, and no part that still responds to
    # voltages before, what comes after a clamped sample is stepped through. A loop knows no load, which creeps too.
    pushed = load is not None and actuator.displacement_creep is not None
    steps_on = path.clock[1].size <= _FEW and not actuator.model.has_dynamics and not pushed
    voltage, reached = np.empty_like(wanted), np.empty_like(wanted)
    clamped = np.zeros(wanted.size, dtype=bool)
    i, chunk = 0, _CHUNK
    while i < wanted.size:
        stop = min(i + chunk, wanted.size)
        candidate, after = path.compensate(i, stop, state)
        allowed = limits.allowed(candidate, voltage[i - 1] if i else present, steps[i:stop])
        # The rounding of a voltage on a limit does not count as clamping.
        changed = np.flatnonzero(np.abs(allowed - candidate) > _ROUNDING * (limits.high - limits.low))
        count = int(changed[0]) if changed.size else stop - i
        voltage[i : i + count], reached[i : i + count] = allowed[:count], wanted[i : i + count]
        if not changed.size:
            i, state, chunk = stop, after, 2 * chunk
            continue
        if count:
            state = path.compensate(i, i + count, state)[1]
        i += count
        voltage[i], clamped[i] = allowed[count], True
        reached[i], state = path.simulate_sample(voltage, i, state)
        i, chunk = i + 1, _CHUNK
        if steps_on:
            # After a clamped sample others follow soon: sample by sample, then, to the end.
            voltage[i:], reached[i:], clamped[i:], state = path.step(i, voltage[i - 1], state, limits)
            break
    if actuator.model.has_dynamics:
        motion = actuator.simulate(voltage, time=time, load=load, state=start, extrapolate=True)
        reached, state = motion.displacement, motion.state
    missed = float(np.abs(wanted - reached).max(initial=0.0))
    followed = not clamped.any() and missed <= _LARGE_MISS * float(np.ptp(actuator.spring.displacement))
    warnings = [] if followed else [_shortfall(voltage, clamped, limits, missed)]
    warnings += outside_identified(actuator, voltage, refuse=False).warnings
    return Command(
        voltage,
        reached,
        clamped,
        state,
        tuple(warnings),
        missed,
        followed,
        time=None if time is None else vector(time, "time"),
        actuator=actuator,
    )


@dataclass(frozen=True, eq=False)
class _Path:
    """A wanted path, followed in pieces. If time matters, pieces overlap by one sample."""

    actuator: Actuator
    wanted: Array
    time: ArrayLike | None
    load: ArrayLike | None
    velocity: ArrayLike | None
    acceleration: ArrayLike | None

    @cached_property
    def clock(self) -> tuple[NDArray[np.int64], Array]:
        """Runs of equal steps, see `Evaluator.clock`."""
        return self.actuator.model.clock(self.time, self.wanted.size, TIME_NEEDED)

    @cached_property
    def data(self) -> dict[str, Array]:
        """The given values of time, load and derivatives that have an effect, one for each sample."""
        columns = {"load": self.load} | ({"time": self.time} if self.actuator.needs_time else {})
        if self.actuator.dynamics is not None:
            data = PathData(self.time, self.load, self.velocity, self.acceleration)
            columns["velocity"], columns["acceleration"] = self.actuator.model.derivatives(self.wanted, data)
        return {name: vector(values, name) for name, values in columns.items() if values is not None}

    @cached_property
    def lead(self) -> Array:
        """The difference w - y (n,) [m]."""
        return self.actuator.model.lead(self.wanted, PathData(**self.data))

    def compensate(self, i: int, stop: int, start: State) -> tuple[Array, State]:
        """Return the voltages of samples i to stop - 1, from the state at sample i - 1, and the final state."""
        motion = self._piece(i, stop, start)
        voltage = motion.voltage
        if self.actuator.lag and stop < self.wanted.size:
            # A lag needs the slope of the voltage, which the last sample of a piece has from one side only.
            voltage = self._piece(i, stop + 1, start).voltage[:-1]
        return voltage[i - self._first(i) :], motion.state

    def _piece(self, i: int, stop: int, start: State) -> Motion:
        first, path = self._first(i), self.wanted[self._first(i) : stop]
        if first < i:
            model, m = self.actuator.model, start.deformation - self.lead[first]
            here = model.displacement(replace(start, deformation=m), of_mass=False)
            path = np.concatenate([[here], path[1:]])
        data: dict[str, Any] = {name: values[first:stop] for name, values in self.data.items()}
        return self.actuator.compensate(path, **data, state=start, extrapolate=True)

    def _first(self, i: int) -> int:
        """Return the first sample of a piece that starts at sample i."""
        return max(i - 1, 0) if self.actuator.needs_time else i

    def simulate_sample(self, voltage: Array, i: int, start: State) -> tuple[float, State]:
        """Return displacement and state after the voltage of sample i."""
        piece = slice(self._first(i), i + 1)
        data: dict[str, Any] = {name: self.data[name][piece] for name in ("time", "load") if name in self.data}
        motion = self.actuator.simulate(voltage[piece], **data, state=start, extrapolate=True)
        return float(motion.displacement[-1]), motion.state

    def step(self, first: int, before: float, start: State, limits: VoltageLimits) -> tuple[Array, Array, Mask, State]:
        """Step through the samples from `first`; return voltages, displacements, clamped samples and the state."""
        model, n, state = self.actuator.model, self.wanted.size, start
        bounds, durations = self.clock
        voltage, reached_by, offers = np.empty(n), np.empty(n), np.empty(n)
        w = self.wanted + self.lead
        for r, seconds in enumerate(durations):
            run = slice(max(int(bounds[r]), first), int(bounds[r + 1]))
            if run.start >= run.stop:
                continue
            change = _ANY if limits.slew_rate is None else limits.slew_rate * seconds
            numbers = np.array([limits.low, limits.high, change, 0.0, 0.0, 0.0, 1.0])
            coefficients = model.step_coefficients(np.array([0, 1]), np.array([seconds]))
            loop = model.core.loop(coefficients, np.ones(1), numbers, lambda *_: None, model.core_state(state))
            rest = [before, before, before, before, 0.0, 1.0, 0.0, state.deformation, w[run.start - 1]]
            loop.go_on(np.array(rest), 0, 0, 0)
            voltage[run], reached_by[run], offers[run] = loop.trace(w[run])
            before, state = float(voltage[run.stop - 1]), model.state_of(CoreState(*loop.state()))
        clamped = offers[first:] != _NOT_CLAMPED
        clamped &= np.abs(reached_by - w)[first:] > _ROUNDING * float(np.ptp(model.spring.displacement))
        reached = np.where(clamped, reached_by[first:] - self.lead[first:], self.wanted[first:])
        return voltage[first:], reached, clamped, state
