"""The actuator: slip elements and the parallel spring composed; simulate, compensate, state in and out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._computable import FARTHEST, demand_divisors, demand_magnitudes, demand_result
from dehyst._errors import ModelError
from dehyst._io.drafts import PathLike
from dehyst._io.json_files import read_json, write_json
from dehyst._native import EMPTY, Core
from dehyst._types import Array
from dehyst._validation import interval, number, spanned, vector
from dehyst.model import serialization
from dehyst.model.base import AbstractModel, Motion, State
from dehyst.model.creep import Creep, clock
from dehyst.model.dynamics import Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, Spring, Transformer
from dehyst.model.evaluator import Evaluator, PathData, least_slope
from dehyst.model.physical import Physical, charge, physical
from dehyst.model.plausibility import ANYWAY, Range, displacement_words, voltage_words
from dehyst.model.python_control import actuator_block
from dehyst.model.smooth_slip import SmoothSlip

if TYPE_CHECKING:
    from control import NonlinearIOSystem


# A step in creep's longest time constants: w moves evenly in it, and leaves strains of one part in so many.
_REST = 1e9
# Smooth elements forget slowly where they were.
_VISITS = 60


@dataclass(frozen=True, eq=False)
class Actuator(AbstractModel):
    """A piezoelectric actuator (Eqs. 1-3, in terminal coordinates).

    Plain, it is rate independent: ``v = sum_i kappa_i s_i + eta(y)``, with s_i the elongation of slip element i and eta
    the parallel spring. Wider (theory section 8), ``tau(v) = sum_i [psi_i(y) - psi_i(b_i)] + eta(y) + sum_j c_j d_j +
    sum_l k_l q_l``, with b_i the position of cart i, d_j the strain of creep branch j and q_l the elongation of smooth
    element l. With dynamics or a load (section 9) w takes the place of y there.

    Parameters
    ----------
    slip, spring : MaxwellSlip or GradedSlip, Spring
        The hysteresis and the curve without memory.
    state : State, optional
        Where a simulation or compensation starts if it is not told; default: every cart as far back as it goes from
        the spring's last knot, which is where a major loop turns (Remark 5).
    limits : (float, float), optional
        Voltages [V] that the actuator may be given; default: no limits.
    delay : float, optional
        Seconds by which the measured displacement lagged the voltage. Kept for comparisons with measurements; the
        model itself does not use it.
    name : str, optional
    provenance : Mapping, optional
        Where the numbers come from; JSON values only.
    transformer : Transformer, optional
        tau; default: tau(v) = v.
    creep : Creep, optional
        Branches that move in time: with them `simulate` and `compensate` need `time`.
    dynamics : Dynamics, optional
        Inertia and damping; they need `time` too.
    lag : float, optional
        Time constant [s] of the amplifier: the voltage that acts follows the one given, ``given = v + lag v'``.
    load_stiffness : float, optional
        kc [N/m], how stiff the actuator is against a load. With dynamics that at constant charge, km + ke; without
        them the one that the load meets, whatever the driver holds constant.
    smooth : SmoothSlip, optional
        Elements that let go gradually, beside the others.

    Raises
    ------
    ModelError
        If the state does not fit the elements, the limits are no interval, graded elements leave a branch on which
        the voltage does not rise with the displacement, or a number cannot be computed with (above 1e30 in magnitude).
    """

    slip: MaxwellSlip | GradedSlip
    spring: Spring
    state: State = None  # type: ignore[assignment]
    limits: tuple[float, float] | None = None
    delay: float = 0.0
    name: str = "actuator"
    provenance: Mapping[str, Any] = field(default_factory=dict)
    transformer: Transformer | None = None
    creep: Creep | None = None
    dynamics: Dynamics | None = None
    lag: float = 0.0
    load_stiffness: float | None = None
    smooth: SmoothSlip | None = None

    def __post_init__(self) -> None:
        for part, kinds in (
            ("slip", (MaxwellSlip, GradedSlip)),
            ("spring", (Spring,)),
            ("transformer", (Transformer, type(None))),
            ("creep", (Creep, type(None))),
            ("dynamics", (Dynamics, type(None))),
            ("smooth", (SmoothSlip, type(None))),
        ):
            if not isinstance(getattr(self, part), kinds):
                needed = " or ".join(kind.__name__ for kind in kinds if kind is not type(None))
                raise ModelError(f"{part}: got {type(getattr(self, part)).__name__}, need a {needed}")
        self._demand_numbers()
        least_slope(self.slip, self.spring)
        if self.state is None:
            object.__setattr__(self, "state", self.turned(float(self.spring.displacement[-1]), extrapolate=True))
        self._start(self.state)
        _ = self.model.core if self.wide else self.core  # which refuse what the parts cannot see
        if self.limits is not None:
            object.__setattr__(self, "limits", interval(self.limits))
        delay = number(self.delay, "delay")
        if delay < 0:
            raise ModelError(f"delay: got {self.delay}, need 0 or more: a displacement does not lead its voltage")
        demand_magnitudes(delay, "delay [s]")
        object.__setattr__(self, "delay", delay)

    @property
    def wide(self) -> bool:
        """Whether it has more than plain slip elements and a spring."""
        return bool(_wider_parts(self))

    @property
    def needs_time(self) -> bool:
        """Whether `simulate` and `compensate` must be told the time of each sample."""
        return self.model.needs_time

    @cached_property
    def reach(self) -> tuple[float, float]:
        """Displacements [m] at the lower and the upper limit, once both have been visited and creep is at rest.

        Without limits, the first and the last knot of the spring.
        """
        if self.limits is not None:
            return self.major_loop(self.limits)
        return float(self.spring.displacement[0]), float(self.spring.displacement[-1])

    def major_loop(self, limits: tuple[float, float]) -> tuple[float, float]:
        """Displacements [m] at the lower and the upper limit [V] of slow loops between them, creep at rest at both."""
        slow = replace(self, dynamics=None, lag=0.0, state=replace(self.state, motion=EMPTY), limits=None)
        voltage = np.tile(limits, _VISITS)
        rest = 1.0 if slow.creep is None else _REST * float(slow.creep.time_constants.max(initial=0.0))
        time = np.arange(voltage.size) * rest if slow.needs_time else None
        y = slow.simulate(voltage, time=time, extrapolate=True).displacement
        return float(y[-2]), float(y[-1])

    @cached_property
    def voltage_range(self) -> tuple[float, float]:
        """The limits [V]; without limits, voltages of the largest loop between the ends of the spring's knots."""
        if self.limits is not None:
            return self.limits
        ends = float(self.spring.displacement[0]), float(self.spring.displacement[-1])
        low, high = (self.turned(y, rising=i > 0, extrapolate=True) for i, y in enumerate(ends))
        return self.voltage(low), self.voltage(high)

    @cached_property
    def core(self) -> Core:
        """The plain elements and the spring in C; of graded elements the spring alone."""
        kappa = self.slip.stiffness if isinstance(self.slip, MaxwellSlip) else np.zeros(len(self.slip))
        return Core(self.slip.breakaway, kappa, self.spring.displacement, self.spring.voltage)

    @cached_property
    def model(self) -> Evaluator:
        """All parts and their equations."""
        return Evaluator(
            self.slip,
            self.spring,
            self.transformer,
            self.creep,
            self.smooth,
            self.dynamics,
            self.lag,
            self.load_stiffness,
        )

    def simulate(
        self,
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        state: State | None = None,
        stack: bool = True,
        extrapolate: bool = False,
    ) -> Motion:
        """Displacement that a voltage causes; exact, for any steps between samples, but for inertia.

        Parameters
        ----------
        voltage : (n,) array_like
            Voltages [V], each reached monotonically from the one before.
        time : (n,) array_like, optional
            [s], strictly increasing; needed with creep, dynamics or a lag. Steps may be uneven, equal ones are fastest.
            The first sample has no step before it: to carry on from a state, begin with the sample at which it was
            reached. Within a step, w is taken to be linear in time; with dynamics the error falls with the step
            squared.
        load : (n,) array_like, optional
            External force [N]; needs `load_stiffness`. Without dynamics it shifts the displacement by F/kc.
        state : State, optional
            Where to start; default ``self.state``.
        stack : bool, optional
            Evaluate on the stack of reversals (default), or clip every element at every sample. Same answer. Graded
            elements, and a simulation with smooth ones, always clip.
        extrapolate : bool, optional
            Simulate voltages too that lie farther outside of `voltage_range` than it is wide.

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
            self._demand_voltage(low, high)
        if self.wide:
            y, reached = self.model.simulate(v, PathData(time, load), start, stack)
            return Motion(voltage=v, displacement=y, state=reached)
        self._demand_no_load(time, load, v.size)
        y, position, carts = self.core.simulate(v, start.displacement, start.carts, stack=stack)
        demand_result(y, "displacement", FARTHEST)
        return Motion(voltage=v, displacement=y, state=State(position, carts))

    def compensate(
        self,
        displacement: ArrayLike,
        *,
        time: ArrayLike | None = None,
        load: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        state: State | None = None,
        stack: bool = True,
        extrapolate: bool = False,
    ) -> Motion:
        """Voltage that makes the actuator follow a displacement (Eqs. 11-12, with x(0) put in).

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacements [m], on the axis of the record that the actuator was identified from.
        time, load, state, stack
            As in `simulate`; with creep the path is taken to be straight between samples.
        velocity, acceleration : (n,) array_like, optional
            Of the path [m/s, m/s^2], where dynamics need them; default: those of its cubic spline.
        extrapolate : bool, optional
            Compute voltages too for displacements that lie more than one stroke outside of `reach` and the spring: as a
            rule these are micrometres given for metres.

        Returns
        -------
        Motion
            With `voltage` (n,) [V], not limited (see `dehyst.Compensator`), and the `state` reached. With dynamics the
            voltage is the exact feedforward ``w = y + 2 zeta/omega y' + y''/omega^2 - F_ext/kc``: the path must be
            smooth, and the motion of `state` should be that of its first sample.

        Raises
        ------
        ModelError
            If the displacement is not finite or lies more than one stroke outside, the time is missing or does not fit,
            the state does not fit this actuator, or a voltage is too large to be computed.
        """
        (y, low, high), start = spanned(displacement, "displacement"), self._start(state)
        if not extrapolate and self.plausible.strays(low, high):
            self._demand_displacement(y, load)
        if self.wide:
            v, reached = self.model.compensate(y, PathData(time, load, velocity, acceleration), start, stack)
            return Motion(voltage=v, displacement=y, state=reached)
        self._demand_no_load(time, load, y.size)
        v, position, carts = self.core.compensate(y, start.displacement, start.carts, stack=stack)
        demand_result(v, "voltage")
        return Motion(voltage=v, displacement=y, state=State(position, carts))

    def relaxed(self, voltage: float = 0.0, *, extrapolate: bool = False) -> State:
        """The state in which no element is strained and the spring alone holds `voltage` [V].

        Raises
        ------
        ModelError
            If the voltage lies farther outside of `voltage_range` and 0 V than that range is wide, unless
            `extrapolate`.
        """
        v = number(voltage, "voltage")
        if v != 0 and not extrapolate:
            self._demand_voltage(v, v)
        y = self.core.spring_inverse(v if self.transformer is None else float(self.transformer(v)))
        return State(y, np.full(len(self.slip), y))

    def turned(self, displacement: float, *, rising: bool = True, extrapolate: bool = False) -> State:
        """The state after a long motion that ends at `displacement` [m]: every cart has slid (Assumption II).

        Every smooth element has let go. Creep is at rest there, as if the motion had been slow.

        Raises
        ------
        ModelError
            If the displacement lies more than one stroke outside of `reach` and the knots of the spring, unless
            `extrapolate`.
        """
        y = number(displacement, "displacement")
        knots = self.spring.displacement
        if not extrapolate and not knots[0] <= y <= knots[-1]:
            self._demand_displacement(np.array([y]), None)
        side = 1 if rising else -1
        smooth = () if self.smooth is None else side * self.smooth.length
        return State(y, y - side * self.slip.breakaway, smooth=smooth)

    def voltage(self, state: State | None = None) -> float:
        """Voltage [V] that holds the actuator in `state`; default ``self.state``."""
        start = self._start(state)
        if self.wide:
            v = self.model.core.voltage(self.model.held(start))
        else:
            v = self.core.voltage(start.displacement, start.carts)
        demand_result(np.array([v]), "voltage of the state")
        return v

    def to_control(
        self,
        *,
        period: float | None = None,
        state: State | None = None,
        name: str = "actuator",
        extrapolate: bool = False,
    ) -> NonlinearIOSystem:
        """A block for python-control: voltage [V] in, displacement [m] out, a sample every period.

        It does what `simulate` does. All memory is in the block's state; `start` of the block is that of `state`, to be
        given as initial state. The displacement of a sample is the one reached with the voltage of the same sample
        (direct feedthrough): a controller around it must look at the sample before. `delay` is not part of it.

        Parameters
        ----------
        period : float, optional
            Seconds between samples; needed with creep, dynamics or a lag.
        state : State, optional
            Where to start; default ``self.state``, with an amplifier at rest.
        name : str, optional
            Of the block; its input is called "voltage", its output "displacement".
        extrapolate : bool, optional
            As in `simulate`; by default the block raises at such a voltage.

        Returns
        -------
        control.NonlinearIOSystem
            In discrete time, of `period`; without one, of a period that is not told.

        Raises
        ------
        ModelError
            If a period is missing, not positive or too long for a resonance, or the state does not fit.
        MissingExtraError
            If python-control is not installed.
        """
        allowed = None if extrapolate else self._voltages
        return actuator_block(self.model, self._start(state), period, name, allowed)

    def physical(
        self, *, transformer_ratio: float, mechanical_stiffness: float, electrical_stiffness: float
    ) -> Physical:
        """Convert to the paper's symbols (Table 1).

        With c = keq/km: k_i = kappa_i T c, r_i = rho_i / c, f_i = k_i r_i, h = T eta, g = h - keq x. The displacement
        axis gives x but for x(0), which (v, y) data cannot tell: x = 0 is put where the spring alone holds 0 V.

        Parameters
        ----------
        transformer_ratio : float
            T [N/V].
        mechanical_stiffness, electrical_stiffness : float
            km and ke = T^2 / C [N/m].

        Raises
        ------
        ModelError
            If one of them is not a positive number.
        """
        _demand(isinstance(self.slip, MaxwellSlip), "graded elements have no single stiffness k_i")
        _demand(self.transformer is None, "with a transformer curve T v is no force, and T x no charge")
        return physical(
            self.slip,  # type: ignore[arg-type]
            self.spring,
            at_rest=self.core.spring_inverse(0.0),
            transformer_ratio=transformer_ratio,
            mechanical_stiffness=mechanical_stiffness,
            electrical_stiffness=electrical_stiffness,
        )

    def charge(
        self,
        displacement: ArrayLike,
        *,
        transformer_ratio: float,
        mechanical_stiffness: float,
        electrical_stiffness: float,
    ) -> Array:
        """Charge q = T x [C] (theory section 9), none where the spring alone holds 0 V.

        Parameters
        ----------
        displacement : (n,) array_like
            [m]; with dynamics or a load that of w, such as `State.displacement`.
        transformer_ratio, mechanical_stiffness, electrical_stiffness : float
            As in `physical`.

        Raises
        ------
        ModelError
            If a number is impossible, or there is a transformer curve, with which T x balances no power.
        """
        _demand(self.transformer is None, "with a transformer curve T v is no force, and T x no charge")
        return charge(
            vector(displacement, "displacement"),
            at_rest=self.core.spring_inverse(0.0),
            transformer_ratio=transformer_ratio,
            mechanical=mechanical_stiffness,
            electrical=electrical_stiffness,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values in SI units; `from_dict` reads them back without loss."""
        return serialization.as_dict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Actuator:
        """Rebuild from `as_dict`, strictly.

        Raises
        ------
        ModelError
            If the format or version is another one, a key is unknown or missing, or a number is impossible.
        """
        return cls(**serialization.parts(data))

    def save(self, path: PathLike) -> None:
        """Write the model file (JSON), wholly or not at all.

        Raises
        ------
        FileFormatError
            If it cannot be written.
        """
        write_json(path, self.as_dict())

    @classmethod
    def load(cls, path: PathLike) -> Actuator:
        """Read a model file, strictly.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is no JSON.
        ModelError
            If it is not an actuator of this version, or holds impossible numbers.
        """
        data = read_json(path)
        try:
            return cls.from_dict(data)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error

    def with_provenance(self, **entries: Any) -> Actuator:
        """Return a copy whose provenance holds `entries` too."""
        return replace(self, provenance={**self.provenance, **entries})

    def _start(self, state: State | None) -> State:
        return self.model.fitted(self.state if state is None else state)

    def _demand_numbers(self) -> None:
        lag = number(self.lag, "lag")
        if lag < 0:
            raise ModelError(f"lag: got {self.lag}, need 0 s or more")
        if lag:
            demand_divisors(lag, "lag [s]")
        object.__setattr__(self, "lag", lag)
        if self.load_stiffness is None:
            return
        stiffness = number(self.load_stiffness, "load_stiffness")
        if stiffness <= 0:
            raise ModelError(f"load_stiffness: got {self.load_stiffness}, need a positive number of N/m")
        demand_divisors(stiffness, "load_stiffness [N/m]")
        object.__setattr__(self, "load_stiffness", stiffness)

    @cached_property
    def plausible(self) -> Range:
        """Displacements [m] within `reach` or the knots of the spring; limits may be too wide to compute with."""
        knots = Range(float(self.spring.displacement[0]), float(self.spring.displacement[-1]))
        try:
            low, high = self.reach
        except ModelError:
            return knots
        return knots.joined((low, high)) if 0 < high - low < np.inf else knots

    @cached_property
    def _voltages(self) -> Range:
        return Range(*self.voltage_range)

    def _demand_voltage(self, low: float, high: float) -> None:
        if self._voltages.strays(low, high):
            raise ModelError(f"{voltage_words((low, high), self._voltages)}; {ANYWAY}")

    def _demand_displacement(self, displacement: Array, load: ArrayLike | None) -> None:
        words = self.strays(displacement, load)
        if words:
            raise ModelError(f"{words}; {ANYWAY}")

    def strays(self, displacement: Array, load: ArrayLike | None = None, *others: tuple[float, float]) -> str:
        """Why displacements (n,) [m] under a load (n,) [N] cannot be meant for this actuator; empty if they can.

        One cannot that lies farther outside of `plausible` and the `others` than these are wide together.
        """
        got = self.plausible.astray(displacement)
        if got is None:
            return ""
        reach = self.plausible.joined(*others)
        pushed = reach
        if load is not None and self.load_stiffness is not None:
            push = vector(load, "load") / self.load_stiffness
            low, high = float(push.min(initial=0.0)), float(push.max(initial=0.0))
            pushed = Range(reach.low + low, reach.high + high)
        return displacement_words(got, reach) if pushed.astray(displacement) is not None else ""

    def _demand_no_load(self, time: ArrayLike | None, load: ArrayLike | None, samples: int) -> None:
        if load is not None:
            raise ModelError("load: this actuator does not know how far a force moves it; give load_stiffness= [N/m]")
        if time is not None:
            clock(time, samples)


def _wider_parts(actuator: Actuator) -> list[str]:
    parts = {
        "graded elements": isinstance(actuator.slip, GradedSlip),
        "a transformer": actuator.transformer is not None,
        "creep": actuator.creep is not None,
        "smooth elements": actuator.smooth is not None,
        "dynamics": actuator.dynamics is not None,
        "a lag": actuator.lag != 0,
        "a load stiffness": actuator.load_stiffness is not None,
    }
    return [name for name, has in parts.items() if has]


def _demand(holds: bool, why: str) -> None:
    if not holds:
        raise ModelError(f"no physical units: {why}")
