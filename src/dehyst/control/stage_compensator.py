"""The compensator of a stage: wanted displacements of all axes to their voltages, within limits of each axis."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst._types import Array, Mask
from dehyst._validation import interval, vector
from dehyst.control.compensator import Compensator
from dehyst.control.limits import Clamps, ClampWarning, VoltageLimits, stray_sentence
from dehyst.control.loop import Snapshot
from dehyst.control.trajectory import Command
from dehyst.model import Actuator, Stage, StageTrace, State
from dehyst.model.stage import Limits, SlewRates, apply, dot, reachable

# Passes over the path in which clamped axes correct the free ones.
_PASSES = 12
# Of the stroke: changes that are rounding.
_SETTLED = 1e-12
# Of the limits' range: a state whose voltage lies outside by less is that of the limit, but for the model's error.
NEAR = 0.01
# After so many loops every element repeats; and so many of the longest times of creep are a rest.
_LOOPS, _REST = 30, 1e9


class StageCompensator:
    """Inverse control of a stage: ``w = coupling^-1 y``, then a `Compensator` for each axis.

    A clamped axis does not falsify the others. If the voltage of axis k is clamped, the displacement w_k that its
    actuator reaches is known. Axis k then misses its wanted displacement, and every other axis gets the target with
    which it reaches its own: the rows of ``w = coupling^-1 y`` are solved for y_k and the targets of the free axes. If
    a corrected target is clamped too, that axis joins the clamped ones and the others are corrected again.

    Parameters
    ----------
    stage : Stage
    period : float, optional
        Seconds between steps; needed with a slew rate, and by actuators with creep, dynamics or a lag.
    limits : sequence of (float, float), optional
        Lowest and highest voltage [V] of each axis; None for an axis, or by default: the actuator's own.
    slew_rate : sequence of float, optional
        Largest abs(dv/dt) [V/s] of each axis; None for an axis, or by default: not limited.
    states : sequence of State, optional
        State of each actuator; default: its own, or if the limits do not reach it, that after major loops between them.

    Raises
    ------
    ModelError
        As `Compensator`, the axis named, or if a list has another length than there are axes.
    """

    def __init__(
        self,
        stage: Stage,
        *,
        period: float | None = None,
        limits: Limits = None,
        slew_rate: SlewRates = None,
        states: Sequence[State | None] | None = None,
    ) -> None:
        if not isinstance(stage, Stage):
            raise ModelError(f"stage: got {type(stage).__name__}, need a Stage")
        self._stage = stage
        count = len(stage.actuators)
        parts = zip(
            stage.actuators,
            stage.axes,
            _each(limits, count, "limits"),
            _each(slew_rate, count, "slew_rate"),
            _each(states, count, "states"),
            strict=True,
        )
        self._axes = tuple(
            _axis_compensator(actuator, axis, bounds, slew, period, state)
            for actuator, axis, bounds, slew, state in parts
        )
        self._table: list[list[float]] = stage.decoupling.tolist()
        self._clamped = (False,) * count

    def __repr__(self) -> str:
        counts = ", ".join(
            f"{name}: {sum(one.clamps)} clamped" for name, one in zip(self.stage.axes, self._axes, strict=True)
        )
        return f"<StageCompensator of '{self.stage.name}', {counts}>"

    @property
    def stage(self) -> Stage:
        """The model of the stage."""
        return self._stage

    @property
    def compensators(self) -> tuple[Compensator, ...]:
        """The compensator of each actuator."""
        return self._axes

    @property
    def period(self) -> float | None:
        """Seconds between steps."""
        return self._axes[0].period

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Lowest and highest voltage [V] of each axis."""
        return tuple(one.limits for one in self._axes)

    @property
    def slew_rate(self) -> tuple[float | None, ...]:
        """Largest abs(dv/dt) [V/s] of each axis."""
        return tuple(one.slew_rate for one in self._axes)

    @property
    def voltage(self) -> Array:
        """The last voltages sent (axes,) [V]."""
        return np.array([one.voltage for one in self._axes])

    @property
    def states(self) -> tuple[State, ...]:
        """State of each actuator after all voltages sent."""
        return tuple(one.state for one in self._axes)

    @property
    def clamps(self) -> tuple[Clamps, ...]:
        """Numbers of samples clamped so far, of each axis."""
        return tuple(one.clamps for one in self._axes)

    @property
    def clamped(self) -> tuple[bool, ...]:
        """Which axes were clamped in the last step or offer."""
        return self._clamped

    @property
    def displacement(self) -> Array:
        """Displacement (axes,) [m] of the model after all voltages sent; without the delay of a mass."""
        moved = np.array([[one.state.displacement for one in self._axes]])
        return np.asarray(apply(self.stage.coupling, moved)[0])

    def step(self, displacement: ArrayLike) -> Array:
        """Return the voltages (axes,) [V] to send for a `displacement` (axes,) [m], and commit them.

        Raise `ModelError` if it is not finite or has another size: the memory is unchanged. Warn `ClampWarning` as
        `Compensator.step`, with the axis and the displacement that is wanted of it.
        """
        voltage = self._offered(displacement)
        for one, value in zip(self._axes, voltage, strict=True):
            one.commit(value)
        return np.array(voltage)

    def run(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n, axes) [V] of n steps for a `displacement` (n, axes) [m], and commit them.

        Raises and warns as `step`; after an error the memory is unchanged.
        """
        wanted = self.stage.columns(displacement, "displacement", "m")
        voltage = np.empty_like(wanted)
        with self._unchanged_by_errors():
            for k, row in enumerate(wanted):
                voltage[k] = self._offered(row)
                for one, value in zip(self._axes, voltage[k].tolist(), strict=True):
                    one.commit(value)
        return voltage

    def offer(self, displacement: ArrayLike) -> Array:
        """Return the voltages (axes,) [V] for a `displacement` (axes,) [m], not committed.

        Raises and warns as `step`.
        """
        return np.array(self._offered(displacement))

    def _offered(self, displacement: ArrayLike) -> list[float]:
        wanted = self._values(displacement, "displacement")
        voltage, known = [0.0] * len(wanted), dict[int, float]()
        alone = targets = [dot(row, wanted) for row in self._table]
        open_axes = [*range(len(wanted))]
        while open_axes:
            for j in open_axes:
                voltage[j], reached = self._axes[j].offer_and_reach(targets[j])
                if reached is not None:
                    known[j] = reached
            before, open_axes = open_axes, [j for j in open_axes if j not in known]
            if open_axes == before:
                break
            corrected = reachable(self._table, wanted, known)
            targets = [dot(row, corrected) for row in self._table]
        self._clamped = tuple(j in known for j in range(len(wanted)))
        for j in known:
            self._warn(j, wanted[j], voltage[j], alone[j])
        return voltage

    def _warn(self, j: int, wanted: float, voltage: float, target: float) -> None:
        """Warn the caller of `step` or `offer` that the voltage of axis `j` is clamped, once of each kind."""
        one = self._axes[j]
        limits = VoltageLimits(*one.limits, one.slew_rate)
        slewed = limits.low < voltage < limits.high
        if one.clamps.slewed if slewed else one.clamps.limited:
            return
        reason = "the slew rate allows no more" if slewed else "that is a limit"
        stray = stray_sentence(one.actuator, limits, np.array([target]))
        warnings.warn(
            f"CLAMPED: axis {self.stage.axes[j]}: {wanted * 1e6:.6g} um wanted, {voltage:.6g} V to be sent: {reason}"
            + (f". {stray}" if stray else ""),
            ClampWarning,
            4,
        )

    def commit(self, voltage: ArrayLike) -> None:
        """Commit `voltage` (axes,) [V] as sent: the one on offer, or another to which a converter has rounded it.

        Raise `ModelError` if one is not finite, or farther outside its limits than they are apart: no axis has moved.
        """
        values = self._values(voltage, "voltage")
        with self._unchanged_by_errors():
            for one, value in zip(self._axes, values, strict=True):
                one.commit(value)

    def hold(self) -> None:
        """Commit a period in which nothing was sent."""
        for one in self._axes:
            one.hold()

    def afresh(self) -> StageCompensator:
        """Return another compensator like this one, as it was when made or last reset."""
        return StageCompensator(
            self.stage,
            period=self.period,
            limits=self.limits,
            slew_rate=self.slew_rate,
            states=[one.asked_start for one in self._axes],
        )

    def reset(self, states: Sequence[State | None] | None = None) -> None:
        """Start again in `states`, by default those of the construction; counts restart at 0.

        Raise `ModelError` if one does not fit: the memory is unchanged.
        """
        given = _each(states, len(self._axes), "states")
        with self._unchanged_by_errors():
            for one, state in zip(self._axes, given, strict=True):
                one.reset(state)

    def snapshot(self) -> tuple[Snapshot, ...]:
        """Return the whole memory, a snapshot an axis."""
        return tuple(one.snapshot() for one in self._axes)

    def restore(self, snapshots: Sequence[Snapshot]) -> None:
        """Continue from `snapshots`, one an axis.

        Raise `ModelError` as `Compensator.restore`, or if it is another number: the memory is unchanged.
        """
        if len(snapshots) != len(self._axes):
            raise ModelError(f"snapshots: got {len(snapshots)}, need {len(self._axes)}, one an axis")
        with self._unchanged_by_errors():
            for one, snapshot in zip(self._axes, snapshots, strict=True):
                one.restore(snapshot)

    @contextmanager
    def _unchanged_by_errors(self) -> Iterator[None]:
        """Put the memory of all axes back if one of them refuses what is done within."""
        before = self.snapshot()
        try:
            yield
        except (ModelError, ClampWarning):
            for one, snapshot in zip(self._axes, before, strict=True):
                one.restore(snapshot)
            raise

    def trajectory(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        present: ArrayLike | None = None,
        extrapolate: bool = False,
    ) -> StageTrace:
        """Compute the voltages of a whole path, known ahead; the loop's memory is unchanged.

        Each voltage is clamped, the free axes are corrected, and the states follow the voltages that are really sent.

        Parameters
        ----------
        displacement : (n, axes) array_like
            Wanted displacements [m].
        time : (n,) array_like, optional
            [s], as in `Compensator.trajectory`.
        present : (axes,) array_like, optional
            Voltages [V] before the first sample, as in `Compensator.trajectory`.
        extrapolate : bool, optional
            As in `Compensator.trajectory`.

        Raises
        ------
        ModelError
            As `Compensator.trajectory`, the axis named.
        """
        wanted = self.stage.columns(displacement, "displacement", "m")
        if not len(wanted):
            raise ModelError(argument="displacement", got="no samples", need="one at least")
        count = len(self._axes)
        before = [None] * count if present is None else self._values(present, "present")
        commands: list[Command] = []

        def command(j: int) -> Command:
            # After the first pass the targets are in the neighbourhood of those that were checked.
            stray = extrapolate or len(commands) == count
            try:
                return self._axes[j].trajectory(targets[:, j], time=time, present=before[j], extrapolate=stray)
            except ModelError as error:
                raise ModelError(f"axis {self.stage.axes[j]}: {error}") from error

        targets = apply(self.stage.decoupling, wanted)
        commands.extend(command(j) for j in range(count))
        clamped = np.column_stack([one.clamped for one in commands])
        settled = _SETTLED * max(float(np.ptp(wanted)), np.finfo(np.float64).tiny)
        for _ in range(_PASSES if clamped.any() and count > 1 else 0):
            reached = np.column_stack([one.displacement for one in commands])
            corrected = self._corrected(targets, wanted, reached, clamped)
            if np.abs(corrected - targets).max() <= settled:
                break
            changed, targets = (corrected != targets).any(axis=0), corrected
            commands = [command(j) if changed[j] else commands[j] for j in range(count)]
            clamped |= np.column_stack([one.clamped for one in commands])
        return self._trace(wanted, commands)

    def _corrected(self, targets: Array, wanted: Array, reached: Array, clamped: Mask) -> Array:
        """Return targets with which the axes that are free reach what is wanted of them."""
        corrected = targets.copy()
        for i in np.flatnonzero(clamped.any(axis=1)).tolist():
            known = {j: float(reached[i, j]) for j in np.flatnonzero(clamped[i]).tolist()}
            moved = reachable(self._table, wanted[i].tolist(), known)
            for j, row in enumerate(self._table):
                if j not in known:
                    corrected[i, j] = dot(row, moved)
        return corrected

    def _trace(self, wanted: Array, commands: Sequence[Command]) -> StageTrace:
        reached = apply(self.stage.coupling, np.column_stack([one.displacement for one in commands]))
        exact = all(one.followed for one in commands)
        return StageTrace(
            voltage=np.column_stack([one.voltage for one in commands]),
            displacement=wanted if exact else reached,
            states=tuple(one.state for one in commands),
            clamped=np.column_stack([one.clamped for one in commands]),
            missed=np.zeros(len(commands)) if exact else np.abs(wanted - reached).max(axis=0, initial=0.0),
            remarks=tuple(one.warnings for one in commands),
            followed=exact,
        )

    def _values(self, values: ArrayLike, what: str) -> list[float]:
        numbers = vector(values, what)
        if numbers.size != len(self._axes):
            raise ModelError(argument=what, got=f"{numbers.size} values", need=f"{len(self._axes)}, one an axis")
        return list(numbers.tolist())


def _each(values: Sequence[Any] | None, count: int, what: str) -> Sequence[Any]:
    if values is None:
        return [None] * count
    if isinstance(values, int | float | str) or len(values) != count:
        raise ModelError(argument=what, got=repr(values), need=f"{count} entries, one for each axis")
    return values


def _axis_compensator(
    actuator: Actuator,
    axis: str,
    bounds: tuple[float, float] | None,
    slew_rate: float | None,
    period: float | None,
    state: State | None,
) -> Compensator:
    allowed = actuator.limits if bounds is None else bounds
    try:
        if state is None and allowed is not None:
            state = start_within(actuator, actuator.state, interval(allowed))
        # The stage warns, of the displacement that is wanted of the axis.
        return Compensator(actuator, bounds, slew_rate, period=period, state=state, warns=False)
    except ModelError as error:
        raise ModelError(f"axis {axis}: {error}") from error


def start_within(actuator: Actuator, state: State, limits: tuple[float, float]) -> State:
    """Return a state, or if its voltage lies outside the limits [V], the state after major loops between them.

    The loops end at the limit next to the state. Of a state beyond the limits, the elements have slid farther than any
    voltage between them makes them slide: no play within the limits leads to it.
    """
    low, high = limits
    held, near = actuator.voltage(state), NEAR * (high - low)
    if low - near <= held <= high + near:
        return state
    return looped(actuator, limits, rising=held > high)


def looped(actuator: Actuator, limits: tuple[float, float], *, rising: bool) -> State:
    """Return the state after slow major loops between limits [V], at the upper one if `rising`, creep at rest."""
    slow = actuator.quasistatic()
    voltage = np.tile(limits if rising else limits[::-1], _LOOPS)
    rest = 1.0 if slow.creep is None else _REST * float(slow.creep.time_constants.max(initial=0.0))
    time = np.arange(voltage.size) * rest if slow.needs_time else None
    reached = slow.simulate(voltage, time=time, extrapolate=True).state
    # The state of a slow motion has none of a mass.
    return actuator.model.complete_state(replace(reached, motion=EMPTY))
