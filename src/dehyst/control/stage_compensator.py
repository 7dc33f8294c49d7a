"""The compensator of a stage: voltages of all axes for their wanted displacements, within the limits of each axis."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError, of_part
from dehyst._types import Array
from dehyst._validation import for_each, keep, plain, vector
from dehyst.control.compensator import Compensator, unchanged_by_errors
from dehyst.control.limits import Clamps, warn_of_sample
from dehyst.control.loop import ReadOnly
from dehyst.model import Actuator, Stage, State, apply, dot, evaluator_of, reachable, state_after_loops


class Compensators:
    """A compensator for each of several actuators: what a stage and a bank have in common."""

    _each: tuple[Compensator, ...]

    @property
    def states(self) -> tuple[State, ...]:
        """State of each actuator after all voltages sent."""
        return tuple(loop.state for loop in self._each)

    @property
    def clamps(self) -> tuple[Clamps, ...]:
        """Numbers of samples clamped so far, of each actuator."""
        return tuple(loop.clamps for loop in self._each)

    def snapshot(self) -> tuple[bytes, ...]:
        """Return the whole memory, one snapshot for each actuator."""
        return tuple(loop.snapshot() for loop in self._each)

    def restore(self, snapshots: Sequence[bytes]) -> None:
        """Continue from `snapshots`, one for each actuator.

        Raise `ModelError` as `Compensator.restore`, or if the number of snapshots is wrong: the memory is unchanged.
        """
        given = len(snapshots) if isinstance(snapshots, Sequence) else type(snapshots).__name__
        if given != len(self._each):
            raise ModelError(argument="snapshots", got=str(given), need=f"{len(self._each)}, one for each")
        with unchanged_by_errors(*self._each):
            for loop, snapshot in zip(self._each, snapshots, strict=True):
                loop.restore(snapshot)


def each_of(
    actuators: Sequence[Actuator], names: Sequence[str], period: float | None, *, runs: bool, **given: Any
) -> tuple[Compensator, ...]:
    """Return a compensator for each of several actuators, which does not warn; errors name the actuator.

    `runs`: whether a missing period is an error. `given`: arguments of `Compensator`, one or one an actuator.
    """
    columns = [for_each(values, len(actuators), what) for what, values in given.items()]
    made = []
    for name, actuator, *values in zip(names, actuators, *columns, strict=True):
        try:
            options: dict[str, Any] = dict(zip(given, values, strict=True))
            options["state"] = options.pop("states")
            made.append(Compensator(actuator, **options, period=period, warns=False))
            _ = runs and made[-1]._loop
        except ModelError as error:
            raise of_part(error, name) from error
    return tuple(made)


class StageCompensator(Compensators, ReadOnly):
    """Inverse control of a stage: ``w = coupling^-1 y``, then a `Compensator` for each axis.

    A clamped axis does not disturb the others. If the voltage of axis k is clamped, the displacement w_k of its
    actuator is known, and axis k misses its wanted displacement. All other axes still reach theirs: ``w = coupling^-1
    y`` is solved for y_k and for the targets w of the free axes. If a corrected target is clamped too, that axis joins
    the clamped ones; an axis that was clamped only because of what another one cannot reach leaves them. The others
    are corrected again.

    Parameters
    ----------
    stage : Stage
    limits : (float, float), or one an axis, optional
        Lowest and highest voltage [V]. None, for one axis or (default) for all, means the actuator's own.
    slew_rate : float, or one an axis, optional
        Largest abs(dv/dt) [V/s]. None, for one axis or (default) for all, means not limited.
    period : float, optional
        Seconds between steps; needed with a slew rate, and by actuators with creep, dynamics or a lag.
    states : State, or one an axis, optional
        State of each actuator. Default: its own state, usually the top of its records as in `Compensator`, or if this
        is outside the limits, the state after major loops between the limits.

    Attributes
    ----------
    stage, period, limits, slew_rate
        As given; limits and slew rate are tuples with one entry for each axis.
    compensators : tuple of Compensator
        Compensator of each actuator.
    clamped : tuple of bool
        Which axes were clamped in the last step or offer.

    Raises
    ------
    ModelError
        As `Compensator`, with the name of the axis; or if the length of a list is not the number of axes.
    """

    stage: Stage
    compensators: tuple[Compensator, ...]
    period: float | None
    limits: tuple[tuple[float, float], ...]
    slew_rate: tuple[float | None, ...]
    clamped: tuple[bool, ...]

    def __init__(
        self,
        stage: Stage,
        limits: Sequence[tuple[float, float] | None] | tuple[float, float] | None = None,
        slew_rate: Sequence[float | None] | float | None = None,
        *,
        period: float | None = None,
        states: Sequence[State | None] | State | None = None,
    ) -> None:
        if not isinstance(stage, Stage):
            raise ModelError(f"stage: got {type(stage).__name__}, need a Stage")
        names = [f"axis {axis}" for axis in stage.axes]
        # The stage warns, of the displacement that is wanted of the axis.
        each = each_of(stage.actuators, names, period, runs=False, limits=limits, slew_rate=slew_rate, states=states)
        for loop in each:
            if loop._assumed:
                loop.reset(state_after_loops(loop.actuator, loop.actuator.state, loop.limits))
                keep(loop, _assumed=True)
        keep(self, stage=stage, compensators=each, _each=each, period=each[0].period)
        keep(self, limits=tuple(loop.limits for loop in each), slew_rate=tuple(loop.slew_rate for loop in each))
        keep(self, clamped=(False,) * len(each), _table=stage.decoupling.tolist())

    _table: list[list[float]]

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{name}: {sum(clamps)} clamped" for name, clamps in zip(self.stage.axes, self.clamps, strict=True)
        )
        return f"<StageCompensator of '{self.stage.name}', {counts}>"

    @property
    def voltage(self) -> Array:
        """The last voltages sent (axes,) [V]."""
        return np.array([loop.voltage for loop in self.compensators])

    @property
    def displacement(self) -> Array:
        """Displacement (axes,) [m] of the model after all voltages sent; a mass is assumed to follow at once."""
        moved = []
        for loop, state in zip(self.compensators, self.states, strict=True):
            gain, offset = loop._scaling
            moved.append(offset + gain * evaluator_of(loop.actuator).displacement(state, of_mass=False))
        return np.asarray(apply(self.stage.coupling, np.array([moved]))[0])

    def step(self, displacement: ArrayLike, temperature: ArrayLike | None = None) -> Array:
        """Return the voltages (axes,) [V] to send for a `displacement` (axes,) [m], and commit them.

        `temperature`: as in `set_temperature`; it holds from this step on.

        Raise `ModelError` if a value is not finite or a size is wrong: the memory is unchanged. Warn `ClampWarning` as
        `Compensator.step`, with the axis and its wanted displacement.
        """
        if temperature is not None:
            with unchanged_by_errors(*self.compensators):
                self.set_temperature(temperature)
                return self.step(displacement)
        voltage = self._offered(displacement)
        for loop, value in zip(self.compensators, voltage, strict=True):
            loop.commit(value)
        return np.array(voltage)

    def run(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n, axes) [V] of n steps for a `displacement` (n, axes) [m], and commit them.

        Raises and warns as `step`; after an error the memory is unchanged.
        """
        wanted = self.stage.columns(displacement, "displacement")
        with unchanged_by_errors(*self.compensators):
            return np.array([self.step(row) for row in wanted]).reshape(wanted.shape)

    def offer(self, displacement: ArrayLike) -> Array:
        """Return the voltages (axes,) [V] for a `displacement` (axes,) [m] without committing them.

        Raises and warns as `step`.
        """
        return np.array(self._offered(displacement))

    def _offered(self, displacement: ArrayLike) -> list[float]:
        # As with one axis, a displacement that is refused takes the place of the one on offer.
        for loop in self.compensators:
            loop._loop.withdraw()
        wanted = self._values(displacement, "displacement")
        voltage, alone = [0.0] * len(wanted), [dot(row, wanted) for row in self._table]

        def offer(j: int, target: float) -> float | None:
            voltage[j], reached = self.compensators[j]._offer_and_reach(target)
            return reached

        known = targets_and_clamped(self._table, wanted, offer)[1]
        keep(self, clamped=tuple(j in known for j in range(len(wanted))))
        for j in known:
            loop, name = self.compensators[j], self.stage.axes[j]
            slewed = loop.limits[0] < voltage[j] < loop.limits[1]
            # Once of each kind.
            if not (loop.clamps.slewed if slewed else loop.clamps.limited):
                given: dict[str, Any] = {"axis": name, "target": float(loop._in_model(np.array(alone[j])))}
                warn_of_sample(
                    loop.actuator, loop._bounds, slewed, wanted[j], voltage[j], loop._assumed_voltage, **given
                )
        return voltage

    def set_temperature(self, temperature: ArrayLike) -> None:
        """Set the `temperature` [degC] of all actuators, or of each (axes,), for all further steps and offers.

        Actuators without the part `thermal` ignore it. Raise `ModelError` if none has that part, or as
        `Compensator.scale`: all memory is unchanged.
        """
        given = plain(temperature, "temperature")
        degrees = self.stage.temperatures(given if np.ndim(given) == 0 else np.atleast_2d(given), 1)
        pairs = zip(self.compensators, self.stage.actuators, degrees, strict=True)
        scales = [(loop, part.thermal.scale(own, 1)) for loop, part, own in pairs if part.thermal and own is not None]
        for loop, (gain, offset) in scales:
            loop.scale(float(gain[0]), float(offset[0]))

    def commit(self, voltage: ArrayLike) -> None:
        """Commit `voltage` (axes,) [V] as sent: the offered voltages, perhaps rounded by a converter.

        Raise `ModelError` as `Compensator.commit`: no memory changes.
        """
        values = self._values(voltage, "voltage")
        with unchanged_by_errors(*self.compensators):
            for loop, value in zip(self.compensators, values, strict=True):
                loop.commit(value)

    def hold(self) -> None:
        """Commit a period in which nothing was sent."""
        for loop in self.compensators:
            loop.hold()

    def _clone(self) -> StageCompensator:
        """Return a copy in the state at construction or the last reset."""
        options: dict[str, Any] = {name: getattr(self, name) for name in ("period", "limits", "slew_rate")}
        return StageCompensator(self.stage, **options, states=[loop._initial_state for loop in self.compensators])

    def reset(self, states: Sequence[State | None] | State | None = None) -> None:
        """Start again in `states`, by default the states at construction; counts restart at 0.

        Raise `ModelError` if a state does not fit: the memory is unchanged.
        """
        given = for_each(states, len(self.compensators), "states")
        with unchanged_by_errors(*self.compensators):
            for loop, state in zip(self.compensators, given, strict=True):
                loop.reset(state)

    def _values(self, values: ArrayLike, what: str) -> list[float]:
        numbers, count = vector(values, what), len(self.compensators)
        if numbers.size != count:
            raise ModelError(argument=what, got=f"{numbers.size} values", need=f"{count}, one an axis")
        return list(numbers.tolist())


def targets_and_clamped(
    table: Sequence[Sequence[float]], wanted: Sequence[float], offer: Callable[[int, float], float | None]
) -> tuple[list[float], dict[int, float]]:
    """Return the targets (axes,) [m] of the actuators, and the displacements [m] of those that are clamped, by axis.

    The free axes reach what is `wanted` (axes,) [m] of them, and no clamped axis moves past it. With a coupling whose
    principal minors are positive there is one such result. The search fixes and releases axes all at once; as this
    may repeat for a coupling of about 1, it releases none after twice as many passes as there are axes.

    `table`: (axes, axes), the inverse coupling. `offer` takes an axis and its target; it returns None, or if the axis
    is clamped, the displacement [m] that its actuator reaches.
    """
    count, moved, known = len(wanted), wanted, dict[int, float]()
    targets, beyond = [0.0] * count, [0.0] * count
    for passed in itertools.count():
        released = to_release(known, beyond, wanted, moved) if passed < 2 * count else []
        fresh = dict[int, float]()
        for j in range(count):
            if j in known:
                continue
            targets[j] = dot(table[j], moved)
            reached = offer(j, targets[j])
            if reached is not None:
                fresh[j], beyond[j] = reached, targets[j] - reached
        if not fresh and not released:
            break
        known = {j: w for j, w in known.items() if j not in released} | fresh
        moved = reachable(table, wanted, known)
    return targets, known


def to_release(
    known: Iterable[int], beyond: Sequence[float] | Array, wanted: Sequence[float], moved: Sequence[float]
) -> list[int]:
    """Return which of the clamped axes in `known` move past what is wanted of them: they need not be clamped.

    `beyond` (axes,): by how much the target of a clamped actuator lay beyond what it reaches [m]. `wanted`, `moved`
    (axes,): displacements [m].
    """
    return [j for j in known if beyond[j] * (wanted[j] - moved[j]) < 0]


def axes_of(compensator: Compensator | StageCompensator) -> tuple[Compensator, ...]:
    """Return the compensator of each axis."""
    return (compensator,) if isinstance(compensator, Compensator) else compensator.compensators


def compensator_of(model: Any, limits: Any, slew_rate: Any) -> Compensator | StageCompensator:
    """Return the compensator of a model, or the given one; raise `ModelError` for limits beside a compensator."""
    if isinstance(model, Actuator):
        return Compensator(model, limits, slew_rate)
    if isinstance(model, Stage):
        return StageCompensator(model, limits, slew_rate)
    if not isinstance(model, Compensator | StageCompensator):
        raise ModelError(argument="model", got=type(model).__name__, need="an Actuator, a Stage, or a compensator")
    for name, value in {"limits": limits, "slew_rate": slew_rate}.items():
        if value is not None:
            raise ModelError(argument=name, got="some beside a compensator, which has its own", hint="leave them out")
    return model
