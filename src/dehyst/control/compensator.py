"""The compensator: the voltages for wanted displacements, sample by sample or for a whole path, within limits."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._units import per_metre
from dehyst._validation import for_each, keep, number, plain, vector
from dehyst.control.axis import Axis, axes_of, restore_all, unchanged_by_errors
from dehyst.model import Actuator, Stage, State, apply, dot, evaluator_of, state_after_loops


class Compensator:
    """Inverse control of the hysteresis of one axis, or of several coupled axes, within voltage limits (Eqs. 11-12).

    In a loop, `step` takes the presently wanted displacement and returns the voltage to send. A voltage beyond the
    limits is clamped and counted, with a warning, and the memory follows the voltage that is really sent::

        compensator = dehyst.Compensator(actuator, (0, 100), slew_rate=2e4, period=1e-4)
        for wanted in path:
            dac.write(compensator.step(wanted))

    With ``units="um"``, all displacements that the compensator takes or returns are in micrometres. If writing may fail
    or change the voltage, use `offer` and `commit` instead of `step`.

    With a `Stage`, displacements and voltages are (axes,), in a path (n, axes), and a value marked with * is a tuple
    with one entry for each axis. Each actuator follows ``w = coupling^-1 y``. The error of a clamped axis moves the
    other axes by their coupling.

    Parameters
    ----------
    model : Actuator or Stage
    limits : (float, float), or one per axis, optional
        Lowest and highest voltage [V]; default (None): the actuator's, usually the range of its training records.
    slew_rate : float, or one per axis, optional
        Largest abs(dv/dt) [V/s] between samples; default (None): not limited.
    period : float, optional
        Seconds between steps; needed with a slew rate or `preview`, and by an actuator with creep, dynamics or a lag.
    state : State, or one per axis, optional
        Initial state of the actuator, e.g. after a homing. If its voltage lies outside the limits, the actuator is
        assumed to have moved to the nearest limit. Default: the actuator's own state; for an identified model it is the
        top of its records, and the first voltages lie near the highest. If it is outside the limits of a stage: the
        state after major loops between the limits. Before any step, `voltage` is the assumed voltage, which a
        `ClampWarning` of the first step names.
    units : str, optional
        Unit of all displacements that this compensator takes and returns: "m" (default), "mm", "um", "nm" or "pm".
        A `state` is in SI units always.
    preview : bool, optional
        Compensate the delay and inertia of a single axis too. A step then takes the displacement that is wanted
        `samples_ahead` samples later. By default it takes the presently wanted displacement, and delay and inertia are
        not compensated.
    warns : bool, optional
        Whether steps and offers warn `ClampWarning`; clamped samples are counted in any case.

    Attributes
    ----------
    model, period, units
        As given.
    actuator : Actuator
        Of a single axis only.
    stage : Stage
        As given for several axes; for a single axis, a stage of this axis alone.
    limits, slew_rate *
        Limits are a pair of floats.

    Raises
    ------
    ModelError
        If there are no limits, or they are not an interval, a number is not positive, a state does not fit the
        actuator, a period is missing or too long for a resonance, the unit is not a length, a list has another length
        than the axes, or `preview` is given for several axes. With several axes, an error names its axis.
    """

    model: Any
    actuator: Actuator
    stage: Stage
    period: float | None
    units: str
    limits: Any
    slew_rate: Any
    _axes: tuple[Axis, ...]
    _single: bool
    _per_metre: float
    _table: list[list[float]]

    def __init__(
        self,
        model: Actuator | Stage,
        limits: Any = None,
        slew_rate: Any = None,
        *,
        period: float | None = None,
        state: Any = None,
        preview: bool = False,
        units: str = "m",
        warns: bool = True,
    ) -> None:
        if not isinstance(model, Actuator | Stage):
            raise ModelError(argument="model", got=type(model).__name__, need="an Actuator or a Stage")
        single = isinstance(model, Actuator)
        stage = Stage((model,)) if isinstance(model, Actuator) else model
        if preview and period is None:
            raise ModelError("preview needs the time between steps", hint="give the period [s]", change=("period",))
        if preview and not single:
            raise ModelError(argument="preview", got="several axes", need="a single axis")
        scale = per_metre(units)
        own: dict[str, Any] = {"limits": limits, "slew_rate": slew_rate, "state": state, "warns": bool(warns)}
        own |= {"previews": bool(preview), "per_metre": scale} if single else {}
        names = [""] if single else [f"axis {name}" for name in stage.axes]
        axes = axes_of(stage.actuators, names, period, **own)
        if not single:
            axes = tuple(replace(axis, given=_within_loops(axis)) for axis in axes)
        keep(self, model=model, stage=stage, period=axes[0].period, units=units, _axes=axes, _single=single)
        keep(self, limits=self._shaped(axis.limits for axis in axes), _per_metre=scale)
        keep(self, slew_rate=self._shaped(axis.slew_rate for axis in axes), _table=stage.decoupling.tolist())
        keep(self, **({"actuator": model} if single else {}))

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise AttributeError(f"{name} cannot be set; make another Compensator")

    def __repr__(self) -> str:
        axes = "; ".join(f"{axis.bounds.words}, now at {axis.voltage:.6g} V" for axis in self._axes)
        return f"<Compensator of {self.model.name!r}: {axes}>"

    def __reduce__(self) -> tuple[Callable[..., Compensator], tuple[object, ...]]:
        """Return how to copy and unpickle the compensator, with its memory."""
        return _rebuilt, (self._options(), self.snapshot() if any(axis.running for axis in self._axes) else None)

    def _options(self) -> dict[str, Any]:
        options = {name: getattr(self, name) for name in ("model", "limits", "slew_rate", "period", "units")}
        states = [None if axis.assumed else axis.given for axis in self._axes]
        return options | {"preview": self._axes[0].previews, "state": states, "warns": self._axes[0].warns}

    def _clone(self, units: str | None = None) -> Compensator:
        """Return a copy in the state at construction or the last reset, by default with the same `units`."""
        return Compensator(**self._options() | ({} if units is None else {"units": units}))

    def _shaped(self, values: Any) -> Any:
        """Return the value of a single axis, or a tuple with the values of several axes."""
        each = tuple(values)
        return each[0] if self._single else each

    def step(self, displacement: Any, temperature: Any = None) -> Any:
        """Return the voltage [V] to send for a `displacement` [m, or `units`], and commit it.

        `temperature` [degC]: as in `scale`; it holds from this step on.

        Raises
        ------
        ModelError
            If a displacement is not finite or their number is wrong, or the temperature is refused: the memory is
            unchanged, and no time has passed.

        Warns
        -----
        ClampWarning
            Once for limits and once for the slew rate, of each axis. If the warning is made an error, the memory is
            unchanged.
        """
        if temperature is not None:
            with unchanged_by_errors(*self._axes):
                self.scale(temperature=temperature)
                return self.step(displacement)
        if not self._single:
            voltage = self.offer(displacement)
            for axis, value in zip(self._axes, voltage.tolist(), strict=True):
                axis.commit(value)
            return voltage
        axis = self._axes[0]
        if "step" not in self.__dict__:
            # Later steps call the core directly; the core must not keep this object alive.
            here = weakref.proxy(self)
            axis.loop.slow = lambda wanted, degrees: Compensator.step(here, wanted, degrees)
            self.__dict__["step"] = axis.loop.quick
        return axis.call(axis.loop.step, displacement)

    def offer(self, displacement: Any) -> Any:
        """Return the voltage [V] for a `displacement` [m, or `units`], without commit. Raises and warns as `step`."""
        axes = self._axes
        if self._single:
            return axes[0].call(axes[0].loop.offer, displacement)
        # As with one axis, a refused displacement also withdraws the pending offer.
        for axis in axes:
            axis.loop.withdraw()
        wanted = [value / self._per_metre for value in self._values(displacement, "displacement")]
        targets = [dot(row, wanted) for row in self._table]
        return np.array([axis.call(axis.loop.offer, target) for axis, target in zip(axes, targets, strict=True)])

    def commit(self, voltage: Any) -> None:
        """Commit `voltage` [V] as sent: the offered voltage, or the value to which a converter has rounded it.

        Raise `ModelError` if it is not finite, or so far outside the limits that the next step could not return within
        the slew rate, or outside by more than the width of the limits: the memory is unchanged.
        """
        values = self._values(voltage, "voltage")
        if self._single:
            self._axes[0].commit(values[0])
            return
        with unchanged_by_errors(*self._axes):
            for axis, value in zip(self._axes, values, strict=True):
                axis.commit(value)

    def hold(self) -> None:
        """Commit a period in which nothing was sent: the last voltage still acts."""
        for axis in self._axes:
            axis.loop.commit(axis.loop.sent())

    def run(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n,) [V] of n steps for a `displacement` (n,) [m, or `units`], and commit them.

        A path of 1000 samples or more is computed in blocks. Where no voltage is clamped, and without preview, lag and
        inertia, its voltages agree with those of `step` to rounding. All others agree to the bit.

        Raises
        ------
        ModelError
            If a displacement is not finite: the memory is unchanged.

        Warns
        -----
        ClampWarning
            As `step`.
        """
        targets = apply(self.stage.decoupling, self._rows(displacement, "displacement") / self._per_metre)
        with unchanged_by_errors(*self._axes):
            voltages = [
                axis.run(np.ascontiguousarray(wanted)) for axis, wanted in zip(self._axes, targets.T, strict=True)
            ]
        return voltages[0] if self._single else np.column_stack(voltages)

    @property
    def voltage(self) -> Any:
        """The last voltage sent [V]; before any step, the voltage that holds the actuator in its state."""
        return self._axes[0].voltage if self._single else np.array([axis.voltage for axis in self._axes])

    @property
    def displacement(self) -> Any:
        """Displacement [m, or `units`] after all voltages sent, by the model and the `scale`.

        With several axes, a mass is assumed to follow without delay.
        """
        if self._single:
            axis = self._axes[0]
            metres = axis.loop.displacement() if axis.running else axis.actuator.displacement(axis.start)
            return metres * self._per_metre
        moved = []
        for axis in self._axes:
            gain, offset = axis.scaling()
            moved.append(offset + gain * evaluator_of(axis.actuator).displacement(axis.state, of_mass=False))
        return apply(self.stage.coupling, np.array([moved]))[0] * self._per_metre

    @property
    def state(self) -> Any:
        """State * of the actuator after all voltages sent."""
        return self._shaped(axis.state for axis in self._axes)

    @property
    def clamps(self) -> Any:
        """Number * of samples clamped so far, by kind."""
        return self._shaped(axis.clamps for axis in self._axes)

    @property
    def samples_ahead(self) -> int:
        """Number of samples by which `step` needs displacements in advance; 0 without `preview`."""
        return self._axes[0].preview[1]

    @property
    def reach(self) -> Any:
        """Displacements * at both limits of a slow major loop, creep at rest, at the present `scale` [m or `units`]."""
        return self._shaped(tuple(end * self._per_metre for end in axis.reach) for axis in self._axes)

    def reset(self, state: State | Sequence[State | None] | None = None) -> None:
        """Start again in a `state`, by default that at construction or the last reset; counts restart at 0.

        Raise `ModelError` if the state does not fit the actuator: the memory is unchanged.
        """
        pairs = zip(self._axes, for_each(state, len(self._axes), "state"), strict=True)
        axes = [replace(axis) if own is None else replace(axis, given=own, assumed=False) for axis, own in pairs]
        keep(self, _axes=tuple(axes))
        self.__dict__.pop("step", None)

    def snapshot(self) -> Any:
        """Return the whole memory * in bytes; `restore`, also in C, continues from it bit for bit."""
        return self._shaped(axis.snapshot() for axis in self._axes)

    def restore(self, snapshot: Any) -> None:
        """Continue from a `snapshot`, or from the block of `dehyst_loop_save` in C.

        Two actuators have the same shape if breakaway elongations, time constants of creep, lengths of smooth elements,
        resonance, lag and period agree; stiffnesses, spring and transformer may differ, as after `dehyst.update`. The
        next voltages follow this model as fast as the slew rate allows. Raise `ModelError` if the snapshot belongs to
        an actuator of another shape, has another period or preview, lies outside of the limits, or is damaged: the loop
        is unchanged.
        """
        restore_all(self._axes, [snapshot] if self._single else snapshot)

    def model_block(self) -> bytes:
        """Return actuator, limits, period and start as the block that `dehyst_model_load` reads in C.

        The block is the same for every processor and number type and has a checksum. Its start is the state at the
        construction or the last reset. Raise `ModelError` for several axes.
        """
        return only_axis(self).block()

    def scale(self, gain: Any = None, offset: Any = 0.0, *, temperature: Any = None) -> Any:
        """Set gain and offset * of the displacement between two steps, and return the present ones.

        The wanted displacement is then offset + gain times the model's displacement, for instance for another
        temperature or an aged sensor. This holds for steps, offers, `plan_path` and `reach`. A construction or a reset
        sets gain 1 and offset 0. The next voltages follow as fast as the slew rate allows; a pending offer is
        withdrawn.

        Parameters
        ----------
        gain, offset : float, or one per axis, optional
            Gain, and offset [m, or `units`]; without a gain nothing changes.
        temperature : float, or one per axis, optional
            [degC], instead of `gain` and `offset`. Actuators that do not depend on temperature keep both.

        Returns
        -------
        (float, float) *
            The present gain and offset [m, or `units`].

        Raises
        ------
        ModelError
            If a gain is not positive, a number is not finite, or no actuator depends on temperature: gains and offsets
            are unchanged.
        """
        count, pairs = len(self._axes), []
        if temperature is not None:
            degrees = plain(temperature, "temperature")
            table = self.stage.temperatures(np.atleast_2d(degrees) if np.ndim(degrees) else degrees, 1)
            pairs = [None if own is None else axis.scaling(own, 1) for axis, own in zip(self._axes, table, strict=True)]
        elif gain is not None:
            gains, offsets = for_each(gain, count, "gain"), for_each(offset, count, "offset")
            pairs = [
                (number(own, "gain"), number(by, "offset") / self._per_metre)
                for own, by in zip(gains, offsets, strict=True)
            ]
        if pairs:
            with unchanged_by_errors(*self._axes):
                for axis, pair in zip(self._axes, pairs, strict=True):
                    if pair is not None:
                        axis.scale(*(float(np.ravel(value)[0]) for value in pair))
        each = (axis.scaling() for axis in self._axes)
        return self._shaped((own, by * self._per_metre) for own, by in each)

    def _straying(self, j: int, displacement: Array) -> str:
        """Return why a `displacement` (n,) [m] of the model of axis `j` is implausible; else ""."""
        sentence = self._axes[j].strays(displacement)
        if not sentence or self._per_metre == 1:
            return sentence
        return f"{sentence.split('; is this in')[0]}. This compensator takes displacements in {self.units}"

    def _rows(self, values: ArrayLike, what: str) -> Array:
        """Return `values` (n,) of a single axis, or (n, axes), as (n, axes); raise `ModelError` if they do not fit."""
        return vector(values, what)[:, None] if self._single else self.stage.columns(values, what)

    def _values(self, values: Any, what: str) -> list[float]:
        """Return the value of each axis."""
        if self._single:
            return [number(values, what)]
        numbers, count = vector(values, what), len(self._axes)
        if numbers.size != count:
            raise ModelError(argument=what, got=f"{numbers.size} values", need=f"{count}, one per axis")
        return list(numbers.tolist())


def only_axis(compensator: object) -> Axis:
    """Return the axis of a compensator of a single axis; raise `ModelError` for anything else."""
    if not isinstance(compensator, Compensator) or not compensator._single:
        got = type(compensator).__name__
        raise ModelError(argument="compensator", got=got, need="a Compensator of a single axis")
    return compensator._axes[0]


def _within_loops(axis: Axis) -> State:
    """Return the state of an axis of a stage; if it is assumed, a state that voltages within the limits reach."""
    return state_after_loops(axis.actuator, axis.given, axis.limits) if axis.assumed else axis.given


def _rebuilt(options: dict[str, Any], memory: Any) -> Compensator:
    compensator = Compensator(**options)
    if memory is not None:
        compensator.restore(memory)
    return compensator
