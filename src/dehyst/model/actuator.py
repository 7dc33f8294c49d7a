"""The actuator: slip elements, spring and further parts combined; simulate, compensate, explicit states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._io import VERSION
from dehyst._native import EMPTY
from dehyst._validation import demand_result, interval, keep, number, spanned, vector
from dehyst._views.pictures import Plotted
from dehyst.model import states
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.dynamics import DisplacementCreep, Dynamics, Thermal, feedback_margins
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.entries import JsonFile, Numbers, entry, instance, mapping, text
from dehyst.model.evaluator import Evaluator, PathData, least_slope
from dehyst.model.identification import Identification
from dehyst.model.promise import Promise, promise
from dehyst.model.states import Range, turned

# The voltage of a state is a sum: it has an error of at most this part of the spring's range.
_ROUNDING = 64 * float(np.finfo(np.float64).eps)

_LAG = Numbers(least=0.0, divides=True)
_LOAD_STIFFNESS = Numbers(positive=True, divides=True, plausible=1e15, optional=True)


def _limits(value: Sequence[float] | None, where: str) -> tuple[float, float] | None:
    return None if value is None else interval(value)


@dataclass(frozen=True, eq=False)
class Actuator(Plotted, JsonFile, AbstractModel):
    """A piezoelectric actuator (Eqs. 1-3, in terminal coordinates).

    With Maxwell-slip elements alone it is rate independent: ``v = sum_i kappa_i s_i + eta(y)``, where s_i is the
    elongation of element i and eta the parallel spring. With all parts (theory section 8), ``tau(v) = sum_i [psi_i(y) -
    psi_i(b_i)] + eta(y) + sum_l k_l q_l``, with b_i the position of cart i and q_l the elongation of smooth element l.
    With dynamics or a load (section 9), w replaces y in this equation. With creep in displacement (section 19), y in
    this equation is the displacement before creep.

    Parameters
    ----------
    slip, spring : MaxwellSlip or GradedSlip, Spring
        The hysteresis and the curve without memory.
    state : State, optional
        Default initial state of simulations and compensations. Without it, this state is the upper turning point of a
        major loop at the spring's last knot: every cart trails by its breakaway elongation (Remark 5).
    limits : (float, float), optional
        Least and largest voltage [V] of the records; default: no limits. Give wider limits where you plan a voltage,
        as in `dehyst.plan_path`.
    delay : float, optional
        Time [s] by which the measured displacement lagged the voltage. Used in comparisons with measurements only.
    name : str, optional
    provenance : Mapping, optional
        Source of the numbers, for people; JSON values only. It has no effect on any result.
    identification : Identification, optional
        How the numbers were identified, and their errors; default: nothing is known.
    transformer : Transformer, optional
        The curve tau(v); default: tau(v) = v.
    dynamics : Dynamics, optional
        Inertia and damping: with them `simulate` and `compensate` need `time`.
    lag : float, optional
        Time constant [s] of the amplifier: the acting voltage v follows the command, ``command = v + lag v'``.
    load_stiffness : float, optional
        kc [N/m], the stiffness of the actuator against a load. With dynamics it is the stiffness at constant charge, km
        + ke. Without dynamics it is the effective stiffness under the driver in use.
    smooth : SmoothSlip, optional
        Elements that yield gradually, in parallel with the others.
    displacement_creep : DisplacementCreep, optional
        Creep in displacement, applied after elements and mass: with it `simulate` and `compensate` need `time`.
    thermal : Thermal, optional
        Gain and offset of the displacement by temperature, applied after all other parts.

    Raises
    ------
    ModelError
        If the state does not fit the elements, the limits are not an interval or exceed the voltages of the records by
        over 2 % of their range, the voltage does not rise with the displacement on a branch of the graded elements, or
        a number is too large to compute with (magnitude over 1e30).
    """

    _head = MappingProxyType({"format": "dehyst-actuator", "version": VERSION})
    _order = (
        "name slip spring transformer smooth displacement_creep thermal dynamics load_stiffness lag state limits delay "
        "identification provenance"
    )
    slip: MaxwellSlip | GradedSlip = entry("slip", instance(MaxwellSlip, GradedSlip))
    spring: Spring = entry("spring", instance(Spring))
    state: State = entry("state", instance(State, optional=True), None)
    limits: tuple[float, float] | None = entry("limits_V", _limits, None)
    delay: float = entry("delay_s", Numbers(least=0.0), 0.0)
    name: str = entry("name", text, "actuator")
    provenance: Mapping[str, Any] = entry("provenance", mapping, factory=dict)
    identification: Identification = entry("identification", instance(Identification, optional=True), None)
    transformer: Transformer | None = entry("transformer", instance(Transformer, optional=True), None)
    dynamics: Dynamics | None = entry("dynamics", instance(Dynamics, optional=True), None)
    lag: float = entry("lag_s", _LAG, 0.0)
    load_stiffness: float | None = entry("load_stiffness_N_per_m", _LOAD_STIFFNESS, None)
    smooth: SmoothSlip | None = entry("smooth", instance(SmoothSlip, optional=True), None)
    displacement_creep: DisplacementCreep | None = entry(
        "displacement_creep", instance(DisplacementCreep, optional=True), None
    )
    thermal: Thermal | None = entry("thermal", instance(Thermal, optional=True), None)

    def _demand_together(self) -> None:
        """Complete state and identification; raise `ModelError` if parts do not fit each other."""
        keep(self, identification=self.identification or Identification())
        least_slope(self.slip, self.spring)
        if self.state is None:
            keep(self, state=turned(self, states.knots_of(self)[1]))
        self._start(self.state)
        _ = self._evaluator.core  # checks whether the parts fit each other
        states.demand_recorded(self)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values in SI units; `from_dict` reads them back without loss."""
        known = {} if self.identification != Identification() else {"identification": None}
        return super().as_dict() | known

    def __repr__(self) -> str:
        from dehyst.model.summary import one_line

        return one_line(self)

    def summary(self) -> str:
        """Return the parts of the actuator with their numbers, one line for each."""
        from dehyst.model.summary import lines

        return "\n".join(lines(self))

    @property
    def _wide(self) -> bool:
        """Whether the actuator has other parts than slip elements of constant stiffness and a spring."""
        named = "transformer", "displacement_creep", "smooth", "dynamics", "load_stiffness", "thermal"
        further = any(getattr(self, name) is not None for name in named)
        return isinstance(self.slip, GradedSlip) or self.lag != 0 or further

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Displacements [m] at the lower and the upper limit of slow major loops, with creep at rest.

        Without limits: the first and the last knot of the spring.
        """
        return states.knots_of(self) if self.limits is None else states.major_loop(self, self.limits)

    @cached_property
    def _before_creep(self) -> Actuator:
        """The actuator without creep in displacement; it returns the displacement before creep."""
        if self.displacement_creep is None:
            return self
        return replace(self, displacement_creep=None, state=replace(self.state, displacement_creep=EMPTY))

    @cached_property
    def _plausible(self) -> Range:
        """Range of displacements [m] over `reach` and the spring's knots; the knots alone if the reach is not known."""
        knots = Range(*states.knots_of(self))
        try:
            low, high = self.reach
        except ModelError:
            return knots
        return knots.joined((low, high)) if 0 < high - low < np.inf else knots

    @cached_property
    def _voltages(self) -> Range:
        """The limits [V]; without limits, the voltage range of the largest loop within the spring's knots."""
        if self.limits is not None:
            return Range(*self.limits)
        low, high = (turned(self, y, rising=i > 0) for i, y in enumerate(states.knots_of(self)))
        return Range(self.voltage(low), self.voltage(high))

    @cached_property
    def _evaluator(self) -> Evaluator:
        """The evaluator of all parts."""
        return Evaluator(**{part.name: getattr(self, part.name) for part in fields(Evaluator)})

    def simulate(
        self,
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        state: State | None = None,
        stack: bool = True,
        extrapolate: bool = False,
    ) -> Motion:
        """Return the displacement that a voltage causes; without dynamics exact for steps of any size.

        Parameters
        ----------
        voltage : (n,) array_like
            Voltages [V], each reached monotonically from the one before.
        time : (n,) array_like, optional
            [s], strictly increasing; needed with creep, dynamics or a lag. Steps may be uneven, equal ones are fastest.
            The first sample has no step before it: to continue from a state, begin with the sample at which the state
            was reached. Within a step, w is linear in time; with dynamics the error falls with the square of the step.
        load : (n,) array_like, optional
            External force [N]; needs `load_stiffness`. Without dynamics it shifts the displacement by F/kc.
        temperature : float or (n,) array_like, optional
            [degC], with the part `thermal`; default: its reference.
        state : State, optional
            Start; default ``self.state``.
        stack : bool, optional
            Evaluate on the stack of reversals (default), or clip every element at every sample. The result is the same.
            Graded elements, and simulations with smooth elements, always clip.
        extrapolate : bool, optional
            Also simulate voltages that lie outside of the limits by more than their width.

        Returns
        -------
        Motion
            With `displacement` (n,) [m] and the `state` reached.

        Raises
        ------
        ModelError
            If the voltage is not finite or lies too far outside, the time is missing or does not fit, the state does
            not fit this actuator, or a displacement is too large to be computed.
        """
        (v, low, high), start = spanned(voltage, "voltage"), self._start(state)
        if not extrapolate:
            self._refuse_voltages((low, high))
        y, reached = self._evaluator.simulate(v, PathData(time, load, temperature=temperature), start, stack)
        return Motion(voltage=v, displacement=y, state=reached)

    def compensate(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        temperature: ArrayLike | None = None,
        state: State | None = None,
        stack: bool = True,
        extrapolate: bool = False,
    ) -> Motion:
        """Return the voltage with which the actuator follows a displacement (Eqs. 11-12, with x(0) included).

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacements [m], on the axis of the record that the actuator was identified from.
        time, load, temperature, state, stack
            As in `simulate`; with creep the path is straight between samples.
        velocity, acceleration : (n,) array_like, optional
            Derivatives of the path [m/s, m/s^2], used with dynamics; default: derivatives of its cubic spline.
        extrapolate : bool, optional
            Also compute voltages for displacements that lie more than one stroke outside of `reach` and the spring.
            Such displacements are usually micrometres given instead of metres.

        Returns
        -------
        Motion
            With `voltage` (n,) [V], not limited (see `dehyst.Compensator`), and the `state` reached. With dynamics the
            voltage is the exact feedforward ``w = y + 2 zeta/omega y' + y''/omega^2 - F_ext/kc``: the path must be
            smooth, and the motion of `state` should match its first sample.

        Raises
        ------
        ModelError
            If the displacement is not finite or lies more than one stroke outside, the time is missing or does not fit,
            the state does not fit this actuator, or a voltage is too large to be computed.
        """
        (y, low, high), start = spanned(displacement, "displacement"), self._start(state)
        if not extrapolate and (reason := self._implausibility((low, high), load)):
            raise ModelError(f"{reason}; {states.ANYWAY}")
        path = PathData(time, load, velocity, acceleration, temperature)
        v, reached = self._evaluator.compensate(y, path, start, stack)
        return Motion(voltage=v, displacement=y, state=reached)

    def relaxed(self, voltage: float = 0.0, *, extrapolate: bool = False) -> State:
        """Return the state in which no element is strained and the spring alone holds `voltage` [V].

        Raise `ModelError` if the voltage lies outside of the limits by more than their width, is not 0 V, and
        `extrapolate` is false.
        """
        v = number(voltage, "voltage")
        if v != 0 and not extrapolate:
            self._refuse_voltages(v)
        y = self._evaluator.core.spring_inverse(v if self.transformer is None else float(self.transformer(v)))
        return State(y, np.full(len(self.slip), y))

    def voltage(self, state: State | None = None) -> float:
        """Return the voltage [V] that holds the actuator in `state`, by default ``self.state``."""
        start = self._start(state)
        v = self._evaluator.core.voltage(self._evaluator.core_state(start))
        demand_result(np.array([v]), "voltage of the state")
        rounding = _ROUNDING * min(np.ptp(self.spring.voltage), np.ptp(self.limits or self.spring.voltage))
        return 0.0 if abs(v) < rounding else v  # 0 V with a rounding error.

    def displacement(self, state: State | None = None) -> float:
        """Return the displacement [m] of the actuator in a `state`, by default ``self.state``, without a load."""
        return self._evaluator.displacement(self._start(state))

    def promise(
        self, voltage: ArrayLike | None = None, time: ArrayLike | None = None, **options: Any
    ) -> Promise | None:
        """Return the error to expect of a path; None if the model lacks what its records tested.

        Parameters
        ----------
        voltage : (n,) array_like, optional
            Voltage that follows the path [V]. Default: any path like the records, with turning points anywhere within
            their voltages, at their speeds.
        time : (n,) array_like, optional
            Time of the voltage [s]; without it, speeds and holds are assumed to be as in the records.
        temperature : float or (n,) array_like, optional
            Temperature of the path [degC]; default: not known.
        begins, waits, opened, missed : optional
            What a plan knows of its start, and of samples that its limits clamp; `dehyst.plan_path` gives them.
        """
        tested, thermal, creep = self.identification.validity, self.thermal, self.displacement_creep
        if tested is None:
            return None
        return promise(tested, voltage, time, thermal=thermal, creep=creep, **options)

    def margins(self, period: float, margin_db: float = 6.0, *, preview: bool = False) -> tuple[float, float]:
        """Return the largest safe gain of a feedback around the compensator, and the bandwidth of that feedback.

        The gain keeps the margin if the resonance lies up to 5 % lower or higher than identified, and if a reading
        comes up to half a period earlier or one period later than identified. Without an identified resonance the gain
        is 0.01. A resonance of quality Q at f [Hz] is stable with this gain if Q / f is below 300 `period`.

        Parameters
        ----------
        period : float
            Time between two steps [s].
        margin_db : float, optional
            Gain margin [dB].
        preview : bool, optional
            Whether the compensator looks ahead, as `Compensator(preview=True)`.

        Returns
        -------
        gain : float
            Share of the error that each reading corrects, 0 to 1.
        bandwidth : float
            Frequency [Hz] below which disturbances are reduced by 3 dB or more.

        Raises
        ------
        ModelError
            If the period or the margin is not positive.
        """
        seconds = Numbers(positive=True)(period, "period")
        margin = Numbers(positive=True, most=120.0, hint="try 6")(margin_db, "margin_db")
        return feedback_margins(self.dynamics, seconds, 10 ** (margin / 20), preview=preview)

    def _implausibility(
        self, displacement: ArrayLike, load: ArrayLike | None = None, *others: tuple[float, float]
    ) -> str:
        """Return why a `displacement` (n,) [m] under a `load` (n,) [N] is implausible; empty if it is plausible.

        A sample is implausible if it exceeds the plausible range, joined with `others`, by more than its width.
        """
        ends, displacements = self._plausible.far_ends(displacement), self._plausible.joined(*others)
        if ends is None:
            return ""
        pushed = displacements
        if load is not None and self.load_stiffness is not None:
            push = vector(load, "load") / self.load_stiffness
            low, high = float(push.min(initial=0.0)), float(push.max(initial=0.0))
            pushed = Range(displacements.low + low, displacements.high + high)
        return "" if pushed.far_ends(displacement) is None else states.displacement_error(ends, displacements)

    def _refuse_voltages(self, voltage: ArrayLike) -> None:
        if ends := self._voltages.far_ends(voltage):
            raise ModelError(f"{states.voltage_error(ends, self._voltages)}; {states.ANYWAY}")

    def _start(self, state: State | None) -> State:
        return self._evaluator.complete_state(self.state if state is None else state)


def evaluator_of(actuator: Actuator) -> Evaluator:
    """Return the evaluator of an actuator; its `core` is the object of the C core.

    Loops, exports and planners use the evaluator; a user calls the methods of the `Actuator`.
    """
    return actuator._evaluator
