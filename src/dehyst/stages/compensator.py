"""The compensator of a stage: wanted displacements of all axes to their voltages, within limits of each axis."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import interval, vector
from dehyst.control import ClampWarning, Compensator, Snapshot, VoltageLimits
from dehyst.control.clamping import Clamps, stray_sentence
from dehyst.model import Actuator, State
from dehyst.stages.axis_compensator import AxisCompensator
from dehyst.stages.decoupling import apply, dot, reachable
from dehyst.stages.stage import Limits, SlewRates, Stage
from dehyst.stages.stage_trace import StageTrace
from dehyst.stages.starts import start_within
from dehyst.stages.whole_path import follow


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
            _named(axis, lambda: _compensator(actuator, bounds, slew, period, state))  # noqa: B023
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
        except ModelError:
            for one, snapshot in zip(self._axes, before, strict=True):
                one.restore(snapshot)
            raise

    def trajectory(
        self, displacement: ArrayLike, *, time: ArrayLike | None = None, extrapolate: bool = False
    ) -> StageTrace:
        """Compute the voltages of a whole path, known ahead; the loop's memory is unchanged.

        Each voltage is clamped, the free axes are corrected, and the states follow the voltages that are really sent.

        Parameters
        ----------
        displacement : (n, axes) array_like
            Wanted displacements [m].
        time : (n,) array_like, optional
            [s], as in `Compensator.trajectory`.
        extrapolate : bool, optional
            As in `Compensator.trajectory`.

        Raises
        ------
        ModelError
            As `Compensator.trajectory`, the axis named.
        """
        wanted = self.stage.columns(displacement, "displacement", "m")
        if not len(wanted):
            raise ModelError("displacement: got no samples, need one at least")
        return follow(self.stage, self._axes, wanted, time, extrapolate)

    def _values(self, values: ArrayLike, what: str) -> list[float]:
        numbers = vector(values, what)
        if numbers.size != len(self._axes):
            raise ModelError(f"{what}: got {numbers.size} values, need {len(self._axes)}, one an axis")
        return list(numbers.tolist())


def _each(values: Sequence[Any] | None, count: int, what: str) -> Sequence[Any]:
    if values is None:
        return [None] * count
    if isinstance(values, int | float | str) or len(values) != count:
        raise ModelError(f"{what}: got {values!r}, need {count} entries, one for each axis")
    return values


def _compensator(
    actuator: Actuator,
    bounds: tuple[float, float] | None,
    slew_rate: float | None,
    period: float | None,
    state: State | None,
) -> AxisCompensator:
    allowed = actuator.limits if bounds is None else bounds
    if state is None and allowed is not None:
        state = start_within(actuator, actuator.state, interval(allowed))
    return AxisCompensator(actuator, bounds, slew_rate, period=period, state=state)


def _named(axis: str, make: Callable[[], Compensator]) -> Compensator:
    try:
        return make()
    except ModelError as error:
        raise ModelError(f"axis {axis}: {error}") from error
