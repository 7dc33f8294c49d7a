"""The compensator: the voltage for a wanted displacement, sample by sample or for a whole path, within limits."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import CoreError, CoreState, Loop, checked
from dehyst._types import Array
from dehyst._units import per_metre
from dehyst._validation import interval, keep, number, vector
from dehyst.control.limits import Clamps, VoltageLimits, stray_sentence, warn_of_run
from dehyst.control.loop import ReadOnly, make_loop, memory_of, preview_filter, set_memory
from dehyst.model import Actuator, State, demand_thermal, evaluator_of, major_loop, state_within_limits


class Compensator(ReadOnly):
    """Inverse control of the hysteresis within voltage limits (Eqs. 11-12).

    In a loop, `step` takes the presently wanted displacement and returns the voltage to send. A voltage beyond the
    limits is clamped and counted, with a warning, and the memory follows the voltage that is really sent::

        compensator = dehyst.Compensator(actuator, (0, 100), slew_rate=2e4, period=1e-4)
        for wanted in path:
            dac.write(compensator.step(wanted))

    With ``units="um"``, all displacements that the compensator takes or returns are in micrometres.

    If writing may fail or change the voltage, use `offer` and `commit` instead of `step`.

    Parameters
    ----------
    actuator : Actuator
    limits : (float, float), optional
        Lowest and highest voltage [V]; default: the actuator's, usually the range of its training records.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s] between samples; default: not limited.
    period : float, optional
        Seconds between steps; needed with a slew rate or `preview`, and by an actuator with creep, dynamics or a lag.
    state : State, optional
        Initial state of the actuator, e.g. after a homing. If its voltage lies outside the limits, the actuator is
        assumed to have moved to the nearest limit. Default: the actuator's own, for an identified model the top of its
        records, so that the first voltages lie near the highest. `voltage` is the assumed voltage before any step, and
        a `ClampWarning` of the first step names it; `reset` begins in another state.
    units : str, optional
        Unit of all displacements that this compensator takes and returns: "m" (default), "mm", "um", "nm" or "pm".
        Velocities and accelerations follow. A `state` is in SI units always.
    preview : bool, optional
        Compensate the actuator's delay and inertia too. A step then takes the displacement that is wanted
        `samples_ahead` samples later. By default it takes the presently wanted displacement, and delay and inertia are
        not compensated.
    warns : bool, optional
        Whether steps and offers warn `ClampWarning`; clamped samples are counted in any case.

    Attributes
    ----------
    actuator, limits, slew_rate, period, units
        As given; limits are a pair of floats.

    Raises
    ------
    ModelError
        If there are no limits, or they are not an interval, a number is not positive, the state does not fit the
        actuator, a period is missing or too long for a resonance, or the unit is not a length.
    """

    actuator: Actuator
    limits: tuple[float, float]
    slew_rate: float | None
    period: float | None
    _previews: bool
    units: str
    _bounds: VoltageLimits
    _initial_state: State
    _start: State
    _assumed: bool
    _warns: bool
    _per_metre: float

    def __init__(
        self,
        actuator: Actuator,
        limits: Sequence[float] | None = None,
        slew_rate: float | None = None,
        *,
        period: float | None = None,
        state: State | None = None,
        preview: bool = False,
        units: str = "m",
        warns: bool = True,
    ) -> None:
        if not isinstance(actuator, Actuator):
            raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator")
        bounds = VoltageLimits(*allowed_limits(actuator, limits), slew_rate)
        seconds = None if period is None else number(period, "period")
        if seconds is not None and seconds <= 0:
            raise ModelError(argument="period", got=period, need="a positive number of seconds")
        if preview and period is None:
            raise ModelError("preview needs the time between steps", hint="give the period [s]", change=("period",))
        keep(self, actuator=actuator, period=seconds, _previews=bool(preview), units=units, _bounds=bounds)
        keep(self, limits=(bounds.low, bounds.high), slew_rate=bounds.slew_rate)
        keep(self, _warns=bool(warns), _per_metre=per_metre(units))
        self.reset(actuator.state if state is None else state)
        keep(self, _assumed=state is None)

    def __repr__(self) -> str:
        slew = "" if self.slew_rate is None else f", {self.slew_rate:g} V/s"
        period = "" if self.period is None else f", every {self.period:g} s"
        return (
            f"<Compensator of {self.actuator.name!r}, {self._bounds.words}{slew}{period}, now at {self.voltage:.6g} V, "
            f"{self.clamps.limited} limited, {self.clamps.slewed} slewed>"
        )

    def __reduce__(self) -> tuple[Callable[..., Compensator], tuple[object, ...]]:
        """Return how to copy and unpickle the compensator, with its memory."""
        return _rebuilt, (self._options(), self.snapshot() if self._running else None)

    def _options(self) -> dict[str, Any]:
        options = {name: getattr(self, name) for name in ("actuator", "limits", "slew_rate", "period", "units")}
        state = None if self._assumed else self._initial_state
        return options | {"preview": self._previews, "state": state, "warns": self._warns}

    def step(self, displacement: float, temperature: float | None = None) -> float:
        """Return the voltage [V] to send for a `displacement` [m, or `units`], and commit it.

        `temperature` [degC], for an actuator with the part `thermal`: it holds from this step until another
        temperature is given; before, the reference temperature holds. It sets `scaling`.

        Raises
        ------
        ModelError
            If the displacement is not finite, or the temperature is refused: the memory is unchanged, and no time has
            passed.

        Warns
        -----
        ClampWarning
            Once for limits and once for the slew rate. If the warning is made an error, the memory is unchanged.
        """
        if temperature is not None:
            with unchanged_by_errors(self):
                self.scale(temperature=temperature)
                return self.step(displacement)
        return self._called(self._loop.step, displacement)

    def offer(self, displacement: float) -> float:
        """Return the voltage [V] for a `displacement` [m, or `units`], without commit. Raises and warns as `step`."""
        return self._called(self._loop.offer, displacement)

    @staticmethod
    def _called(call: Callable[[float], float], displacement: float) -> float:
        """Return the voltage [V] of a call of the loop for a displacement [m, or `units`]."""
        try:
            return call(displacement)
        except TypeError:
            return call(number(displacement, "displacement"))
        except CoreError as error:
            raise _refusal(displacement) from error

    def _offer_and_reach(self, displacement: float) -> tuple[float, float | None]:
        """Return the voltage [V] of `offer` and, if it is clamped, the displacement [m, or `units`] that it causes.

        The displacement is None if the voltage is not clamped. A mass is assumed to be at rest. Raises and warns as
        `offer`.
        """
        voltage = self.offer(displacement)
        reached, clamped = self._loop.trial()
        return voltage, reached * self._per_metre if clamped else None

    def commit(self, voltage: float) -> None:
        """Commit `voltage` [V] as sent: the offered voltage, or the value to which a converter has rounded it.

        Raise `ModelError` if it is not finite, or so far outside the limits that the next step could not return within
        the slew rate, or by more than their distance: the memory is unchanged.
        """
        try:
            self._loop.commit(number(voltage, "voltage"))
        except CoreError as error:
            raise ModelError(
                f"got {voltage:g} V, too far outside the limits {self._bounds.words} to return in one step",
                argument="voltage",
                hint="give the voltage that was really sent, in volts; if it was that, ramp to the limits first",
            ) from error

    def hold(self) -> None:
        """Commit a period in which nothing was sent: the last voltage still acts."""
        self._loop.commit(self._loop.sent())

    def run(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n,) [V] of n steps for a `displacement` (n,) [m, or `units`], and commit them.

        A path of 1000 samples or more is computed in blocks: where no voltage is clamped, and without preview, lag and
        inertia, these agree with `step` to rounding. All others are those of `step` to the bit.

        Raises
        ------
        ModelError
            If a displacement is not finite: the memory is unchanged.

        Warns
        -----
        ClampWarning
            As `step`.
        """
        wanted, begin = self._in_metres(displacement), self._assumed_voltage
        with unchanged_by_errors(self):
            before = self._loop.counts()
            voltage = self._loop.run(wanted)
            limited, slewed, refused = (int(n) for n in np.subtract(self._loop.counts(), before))
            if refused:
                raise _refusal(float(wanted[np.argmax(np.abs(wanted))]))
            if limited or slewed:
                inner = self._in_model(wanted)
                warn_of_run(self.actuator, self._bounds, Clamps(limited, slewed), inner, begin)
        return voltage

    def _strays(self, displacement: ArrayLike) -> str:
        """Return why a `displacement` (n,) [m, or `units`] is implausible; else ""."""
        return self._straying(self._in_model(self._in_metres(displacement)))

    def _straying(self, displacement: Array) -> str:
        """Return what `_strays` does for a `displacement` (n,) [m] of the model, without gain and offset."""
        sentence = stray_sentence(self.actuator, self._bounds, displacement)
        if not sentence or self._per_metre == 1:
            return sentence
        return f"{sentence.split('; is this in')[0]}. This compensator takes displacements in {self.units}"

    def _in_metres(self, values: ArrayLike, what: str = "displacement") -> Array:
        """Return the `values` (n,) of a path, in `units`, in metres.

        `what`: name of the values in errors. Raise `ModelError` if a value is not finite.
        """
        plain = vector(values, what)
        return plain if self._per_metre == 1 else plain / self._per_metre

    @property
    def voltage(self) -> float:
        """The last voltage sent [V]; before any step, the voltage that holds the actuator in its state."""
        return self._loop.sent() if self._running else self._held(self._start)

    @property
    def displacement(self) -> float:
        """Displacement [m, or `units`] of the actuator after all voltages sent, by the model and the `scaling`."""
        metres = self._loop.displacement() if self._running else self.actuator.displacement(self._start)
        return metres * self._per_metre

    @property
    def _assumed_voltage(self) -> float | None:
        """The present voltage [V], if it is only assumed: no state was given, and nothing was sent; else None."""
        begins = self._assumed and (not self._running or self._loop.sent() == self._held(self._start))
        return self.voltage if begins else None

    def _held(self, state: State) -> float:
        """Return the voltage [V] within the limits that holds the actuator in a `state`, or the nearest limit."""
        return self._bounds.nearest(self.actuator.voltage(state))

    @property
    def state(self) -> State:
        """State of the actuator after all voltages sent."""
        return evaluator_of(self.actuator).state_of(CoreState(*self._loop.state())) if self._running else self._start

    @property
    def clamps(self) -> Clamps:
        """Number of samples clamped so far, by kind."""
        return Clamps(*self._loop.counts()[:2]) if self._running else Clamps(0, 0)

    @property
    def samples_ahead(self) -> int:
        """Number of samples by which `step` needs displacements in advance; 0 without `preview`."""
        return self._preview[1]

    @property
    def reach(self) -> tuple[float, float]:
        """Displacements [m, or `units`] at both limits of a slow major loop, with creep at rest and the `scaling`."""
        gain, offset = self._scaling
        low, high = self._reach
        return offset + gain * low, offset + gain * high

    @cached_property
    def _reach(self) -> tuple[float, float]:
        """The `reach` of the model, without gain and offset."""
        low, high = major_loop(self.actuator, self.limits)
        return low * self._per_metre, high * self._per_metre

    def reset(self, state: State | None = None) -> None:
        """Start again in a `state`, by default the state at construction; counts restart at 0.

        Raise `ModelError` if it does not fit the actuator.
        """
        if state is not None:
            start = state_within_limits(self.actuator, state, self.limits)
            keep(self, _start=start, _initial_state=state, _assumed=False)
        for name in ("_loop", "step"):
            self.__dict__.pop(name, None)

    def _clone(self, units: str | None = None) -> Compensator:
        """Return a copy in the state at construction or the last reset, by default with the same `units`."""
        return Compensator(**self._options() | ({} if units is None else {"units": units}))

    def snapshot(self) -> bytes:
        """Return the loop's whole memory; `restore`, also in C, continues from it bit for bit."""
        self._model_block()
        return self._loop.save()

    def restore(self, snapshot: bytes) -> None:
        """Continue from a `snapshot`, or from the block of `dehyst_loop_save` in C.

        Its actuator has the same shape if breakaway elongations, time constants of creep, lengths of smooth elements,
        resonance, lag and period agree; stiffnesses, spring and transformer may differ, as after `dehyst.update`. The
        next voltages follow this model as fast as the slew rate allows. Raise `ModelError` if the snapshot belongs to
        an actuator of another shape, another period or preview, lies outside of the limits, or is damaged: the loop is
        unchanged.
        """
        if not isinstance(snapshot, bytes):
            raise ModelError(argument="snapshot", got=type(snapshot).__name__, need="the bytes of snapshot()")
        self._model_block()
        with unchanged_by_errors(self):
            try:
                self._loop.restore(snapshot)
            except CoreError as error:
                raise ModelError(f"got one that is refused: {error}", argument="snapshot") from error
            self._bounds.within(self._loop.sent(), "snapshot")

    def scale(
        self, gain: float | None = None, offset: float = 0.0, *, temperature: float | None = None
    ) -> tuple[float, float]:
        """Set a gain and an offset of the displacement between two steps, and return the present ones.

        The wanted displacement is then offset + gain times the model's displacement, for instance for another
        temperature or an aged sensor. This holds for steps, offers, `plan_path` and `reach`. A construction or a reset
        sets gain 1 and offset 0. The next voltages follow as fast as the slew rate allows; a pending offer is
        withdrawn.

        Parameters
        ----------
        gain, offset : float, optional
            Gain, and offset [m, or `units`]; without a gain nothing changes.
        temperature : float, optional
            [degC], instead of them, for an actuator with the part `thermal`.

        Returns
        -------
        (float, float)
            The present gain and offset [m, or `units`].

        Raises
        ------
        ModelError
            If the gain is not positive, a number is not finite, or the actuator has no part `thermal`: gain and offset
            are unchanged.
        """
        if temperature is not None:
            values = demand_thermal(self.actuator.thermal).scale(number(temperature, "temperature"), 1)
            checked(self._loop.scale, *(float(value[0]) for value in values))
        elif gain is not None:
            try:
                self._loop.scale(number(gain, "gain"), number(offset, "offset") / self._per_metre)
            except CoreError as error:
                raise ModelError(argument="gain", got=gain, need="a positive number, and not too large") from error
        return self._scaling

    @property
    def _scaling(self) -> tuple[float, float]:
        """Gain and offset [m, or `units`] of the displacement, see `scale`."""
        gain, offset = self._scaling_at(None, 1)
        return gain, offset * self._per_metre

    def _scaling_at(self, temperature: ArrayLike | None, samples: int) -> tuple[Any, Any]:
        """Return gains and offsets [m] of `samples` at a `temperature`, one or (n,) [degC]; None: those of `scaling`.

        Raise `ModelError` as `scale`.
        """
        if temperature is not None:
            return demand_thermal(self.actuator.thermal).scale(temperature, samples)
        gain, offset = self._loop.rest()[5:7].tolist() if self._running else (1.0, 0.0)
        return gain, offset

    def _in_model(self, displacement: Array) -> Array:
        """Return the displacement (n,) [m] of the model that makes a `displacement` (n,) [m], by the `scaling`."""
        gain, offset = self._scaling_at(None, displacement.size)
        return np.asarray((displacement - offset) / gain)

    def _tables(self) -> dict[str, Array]:
        """Return all numbers that a step reads, as computed by the core; names as in `core/dehyst.h`."""
        return self._loop.tables()

    def _model_block(self) -> bytes:
        """Return the block of `dehyst.control.model_block`."""
        return self._loop.block(*self._core_start(), self.period or 0.0, self.samples_ahead)

    def _model_ids(self) -> tuple[int, int]:
        """Return the checksums `id` and `shape` of the model in C; limits and start have no effect on them."""
        self._model_block()
        return self._loop.ids()

    def _core_start(self) -> CoreState:
        """Return the state at the construction or the last reset, as numbers of the C core."""
        return evaluator_of(self.actuator).core_state(self._start)

    @property
    def _running(self) -> bool:
        return "_loop" in self.__dict__

    @cached_property
    def _preview(self) -> tuple[Array, int]:
        """Taps of the preview filter, and the number of samples that it looks ahead."""
        return preview_filter(self.actuator, self.period) if self._previews and self.period else (np.ones(1), 0)

    @cached_property
    def _loop(self) -> Loop:
        """The loop in C, made when first needed, because a plan does not need it."""
        options = {"warns": self._warns, "assumed": self._assumed}
        loop = make_loop(self.actuator, self._bounds, self.period, self._preview[0], self._core_start(), **options)
        loop.per_metre = self._per_metre
        # A step without a frame of Python; it must not keep this object alive.
        here = weakref.proxy(self)
        loop.slow = lambda displacement, temperature: Compensator.step(here, displacement, temperature)
        self.__dict__["step"] = loop.quick
        return loop


def model_block(compensator: Compensator) -> bytes:
    """Return actuator, limits, period and start of a `compensator` as the block that `dehyst_model_load` reads in C.

    The block is the same for every processor and number type and has a checksum. Its start is the state at the
    construction or the last reset of the compensator.
    """
    return compensator._model_block()


def allowed_limits(actuator: Actuator, limits: Sequence[float] | None) -> tuple[float, float]:
    """Return the given limits [V], or the actuator's; raise `ModelError` if there are none or they are no interval."""
    chosen = actuator.limits if limits is None else limits
    if chosen is None:
        raise ModelError(
            "no voltage limits: the actuator has none and none were given",
            hint="give limits (low, high)",
            change=("limits",),
        )
    return interval(chosen)


@contextmanager
def unchanged_by_errors(*loops: Compensator) -> Iterator[None]:
    """Restore the whole memory of all `loops` if an error occurs in the block."""
    before = [memory_of(loop._loop) for loop in loops]
    try:
        yield
    except BaseException:
        for loop, memory in zip(loops, before, strict=True):
            set_memory(loop._loop, *memory)
        raise


def _rebuilt(options: dict[str, Any], memory: bytes | None) -> Compensator:
    compensator = Compensator(**options)
    if memory is not None:
        compensator.restore(memory)
    return compensator


def _refusal(displacement: float) -> ModelError:
    return ModelError(
        argument="displacement", got=repr(displacement), need="a finite number of metres that the model can follow"
    )
