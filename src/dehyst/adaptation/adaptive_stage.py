"""A compensator of coupled axes that adapts the model of each axis to the sensors of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import nan

from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import readings, vector
from dehyst.adaptation.adaptive_compensator import AdaptiveCompensator, AdaptiveSnapshot
from dehyst.control import StageCompensator, restore_all
from dehyst.model import Stage, State, dot


class AdaptiveStageCompensator:
    """A `StageCompensator` whose models are adapted to the displacements that the sensors of all axes measure.

    ``w = coupling^-1 y`` gives what each actuator should move, and what it has moved; from these two each axis learns
    as an `AdaptiveCompensator`. The coupling is not learnt; `dehyst.trust.check_stage` reports a change of it. A step
    without a measurement of any one axis counts for no axis.

    Parameters
    ----------
    stage, period, limits, slew_rate, states
        As in `StageCompensator`.
    memory, time_constant, zero_drifts
        As in `AdaptiveCompensator`, for all axes.

    Attributes
    ----------
    axes : tuple of AdaptiveCompensator
        What each axis has learnt: its `log`, `drift` and `datum`; `learning` may be set for each.

    Raises
    ------
    ModelError
        As `StageCompensator` and `AdaptiveCompensator`.
    """

    axes: tuple[AdaptiveCompensator, ...]

    def __init__(
        self,
        stage: Stage,
        *,
        period: float | None = None,
        limits: Sequence[tuple[float, float] | None] | tuple[float, float] | None = None,
        slew_rate: Sequence[float | None] | float | None = None,
        states: Sequence[State | None] | State | None = None,
        memory: float = 10.0,
        time_constant: float | None = None,
        zero_drifts: bool = True,
    ) -> None:
        self._compensator = StageCompensator(stage, period=period, limits=limits, slew_rate=slew_rate, states=states)
        self._table: list[list[float]] = stage.decoupling.tolist()
        self.axes = tuple(
            AdaptiveCompensator.within(one, memory, time_constant, zero_drifts=zero_drifts)
            for one in self._compensator.compensators
        )

    def __repr__(self) -> str:
        used = ", ".join(
            f"{name}: {sum(one.used for one in axis.log)} exchanges in {len(axis.log)} cycles"
            for name, axis in zip(self._compensator.stage.axes, self.axes, strict=True)
        )
        return f"<AdaptiveStageCompensator of '{self._compensator.stage.name}', {used}>"

    def step(self, wanted: ArrayLike, measured: ArrayLike | None = None, temperature: ArrayLike | None = None) -> Array:
        """Return the voltages (axes,) [V] to send for a displacement `wanted` (axes,) [m] now, and commit them.

        `measured` (axes,) [m] is the displacement before this step; None, or NaN in any axis, if unknown.
        `temperature`: as in `StageCompensator.step`.

        Raises
        ------
        ModelError
            If `wanted` is not finite, `measured` no numbers or masked, or a size not the number of axes: the memory is
            unchanged.

        Warns
        -----
        ClampWarning
            As `StageCompensator.step`.
        """
        count = len(self.axes)
        aims = vector(wanted, "displacement").tolist()
        reached = [nan] * count if measured is None else readings(measured, "measured", "m").tolist()
        if len(reached) != count:
            raise ModelError(argument="measured", got=f"{len(reached)} values", need=f"{count}, one an axis")
        voltage = self._compensator.step(aims, temperature)
        if temperature is not None:
            self._rescale()
        for axis, row, value in zip(self.axes, self._table, voltage.tolist(), strict=True):
            axis.took(dot(row, aims), value, dot(row, reached))
        return voltage

    def set_temperature(self, temperature: ArrayLike) -> None:
        """Set the `temperature` for all further steps and cycles; as `StageCompensator.set_temperature`."""
        self._compensator.set_temperature(temperature)
        self._rescale()

    def _rescale(self) -> None:
        for axis in self.axes:
            axis.rescale()

    @property
    def stage(self) -> Stage:
        """The stage with the models in use; save it to start with it next time."""
        return replace(self._compensator.stage, actuators=tuple(axis.actuator for axis in self.axes))

    @property
    def voltage(self) -> Array:
        """The last voltages sent (axes,) [V]."""
        return self._compensator.voltage

    @property
    def clamped(self) -> tuple[bool, ...]:
        """Which axes were clamped in the last step."""
        return self._compensator.clamped

    def snapshot(self) -> tuple[AdaptiveSnapshot, ...]:
        """Return the whole memory, one snapshot for each axis, as `AdaptiveCompensator.snapshot`."""
        return tuple(axis.snapshot() for axis in self.axes)

    def restore(self, snapshots: Sequence[AdaptiveSnapshot]) -> None:
        """Continue from `snapshots`, one for each axis; raise `ModelError` as `AdaptiveCompensator.restore`.

        After an error the memory is unchanged.
        """
        restore_all(self.axes, snapshots)
