"""The actuator: slip elements and the parallel spring composed; simulate, compensate, state in and out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Array, Core, number, vector
from dehyst.elements import MaxwellSlip, Spring, frozen
from dehyst.files import PathLike, read_json, write_json
from dehyst.model import AbstractModel, Motion, State

FORMAT = "dehyst-actuator"
VERSION = 1
_KEYS = {"format", "version", "name", "slip", "spring", "state", "limits", "delay_s", "provenance"}


@dataclass(frozen=True)
class Physical:
    """The paper's symbols (Table 1), from the terminals' numbers and a nominal T, km and ke.

    Attributes
    ----------
    stiffness, friction, breakaway : (N,) array
        k_i [N/m], f_i [N] and r_i = f_i / k_i [m of x].
    deformation, nonlinear, parallel : (M,) array
        x [m] at the spring's knots; the nonlinear spring's force g(x) and h(x) = keq x + g(x) [N].
    """

    transformer_ratio: float
    mechanical_stiffness: float
    electrical_stiffness: float
    stiffness: Array
    friction: Array
    breakaway: Array
    deformation: Array
    nonlinear: Array
    parallel: Array

    @property
    def equivalent_stiffness(self) -> float:
        """Keq = ke km / (ke + km) [N/m]."""
        return _in_series(self.electrical_stiffness, self.mechanical_stiffness)


def interval(limits: Sequence[float]) -> tuple[float, float]:
    """Check voltage limits [V].

    Raises
    ------
    ModelError
        If they are not two finite numbers, the lower one first.
    """
    ends = [number(end, "limits") for end in limits] if isinstance(limits, Sequence | np.ndarray) else []
    if len(ends) != 2 or ends[0] >= ends[1]:
        raise ModelError(f"limits: got {limits}, need two finite voltages, the lower one first")
    return ends[0], ends[1]


def _in_series(a: float, b: float) -> float:
    return a * b / (a + b)


@dataclass(frozen=True, eq=False)
class Actuator(AbstractModel):
    """A piezoelectric actuator with rate-independent hysteresis (Eqs. 1-3, in terminal coordinates).

    ``v = sum_i kappa_i s_i + eta(y)``, with s_i the elongation of slip element i and eta the parallel spring.

    Parameters
    ----------
    slip, spring : MaxwellSlip, Spring
        The hysteresis and the curve without memory.
    state : State, optional
        Where a simulation or compensation starts if it is not told; default: every cart as far back as it goes from
        the spring's last knot, which is where a major loop turns (Remark 5).
    limits : (float, float), optional
        Voltages [V] that the actuator may be given; default: no limits.
    delay : float, optional
        Seconds by which the measured displacement lagged the voltage. Kept for comparisons with measurements; the
        model itself has no time.
    name : str, optional
    provenance : Mapping, optional
        Where the numbers come from; JSON values only.

    Raises
    ------
    ModelError
        If the state does not fit the elements, or the limits are no interval.
    """

    slip: MaxwellSlip
    spring: Spring
    state: State = None  # type: ignore[assignment]
    limits: tuple[float, float] | None = None
    delay: float = 0.0
    name: str = "actuator"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for part, kind in (("slip", MaxwellSlip), ("spring", Spring)):
            if not isinstance(getattr(self, part), kind):
                raise ModelError(f"{part}: got {type(getattr(self, part)).__name__}, need a {kind.__name__}")
        if self.state is None:
            object.__setattr__(self, "state", self.turned(float(self.spring.displacement[-1])))
        self._start(self.state)
        _ = self.core  # which refuses what the parts cannot see
        if self.limits is not None:
            object.__setattr__(self, "limits", interval(self.limits))
        if number(self.delay, "delay") < 0:
            raise ModelError(f"delay: got {self.delay}, need 0 or more: a displacement does not lead its voltage")

    @cached_property
    def core(self) -> Core:
        """The same numbers in C."""
        return Core(self.slip.breakaway, self.slip.stiffness, self.spring.displacement, self.spring.voltage)

    def simulate(self, voltage: ArrayLike, *, state: State | None = None, stack: bool = True) -> Motion:
        """Displacement that a voltage causes; exact, for any steps between samples.

        Parameters
        ----------
        voltage : (n,) array_like
            Voltages [V], each reached monotonically from the one before.
        state : State, optional
            Where to start; default ``self.state``.
        stack : bool, optional
            Evaluate on the stack of reversals (default), or clip every element at every sample. Same answer.

        Returns
        -------
        Motion
            With `displacement` (n,) [m] and the `state` reached.

        Raises
        ------
        ModelError
            If the voltage is not finite or the state does not fit this actuator.
        """
        v, start = vector(voltage, "voltage"), self._start(state)
        y, position, carts = self.core.simulate(v, start.displacement, start.carts, stack=stack)
        return Motion(voltage=v, displacement=y, state=State(position, carts))

    def compensate(self, displacement: ArrayLike, *, state: State | None = None, stack: bool = True) -> Motion:
        """Voltage that makes the actuator follow a displacement (Eqs. 11-12, with x(0) put in).

        Parameters
        ----------
        displacement : (n,) array_like
            Wanted displacements [m], on the axis of the record that the actuator was identified from.
        state, stack
            As in `simulate`.

        Returns
        -------
        Motion
            With `voltage` (n,) [V], not limited (see `dehyst.Compensator`), and the `state` reached.

        Raises
        ------
        ModelError
            If the displacement is not finite or the state does not fit this actuator.
        """
        y, start = vector(displacement, "displacement"), self._start(state)
        v, position, carts = self.core.compensate(y, start.displacement, start.carts, stack=stack)
        return Motion(voltage=v, displacement=y, state=State(position, carts))

    def relaxed(self, voltage: float = 0.0) -> State:
        """The state in which no element is strained and the spring alone holds `voltage` [V]."""
        y = self.core.spring_inverse(number(voltage, "voltage"))
        return State(y, np.full(len(self.slip), y))

    def turned(self, displacement: float, *, rising: bool = True) -> State:
        """The state after a long motion that ends at `displacement` [m]: every cart has slid (Assumption II)."""
        y = number(displacement, "displacement")
        return State(y, y - (1 if rising else -1) * self.slip.breakaway)

    def voltage(self, state: State | None = None) -> float:
        """Voltage [V] that holds the actuator in `state`; default ``self.state``."""
        start = self._start(state)
        return self.core.voltage(start.displacement, start.carts)

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
        given = {"transformer_ratio": transformer_ratio, "mechanical_stiffness": mechanical_stiffness,
                 "electrical_stiffness": electrical_stiffness}  # fmt: skip
        for name, value in given.items():
            if number(value, name) <= 0:
                raise ModelError(f"{name}: got {value}, need a positive number")
        equivalent = _in_series(electrical_stiffness, mechanical_stiffness)
        c = equivalent / mechanical_stiffness
        x = (self.spring.displacement - self.core.spring_inverse(0.0)) / c
        h = transformer_ratio * self.spring.voltage
        return Physical(
            **given,
            stiffness=self.slip.stiffness * transformer_ratio * c,
            friction=self.slip.friction * transformer_ratio,
            breakaway=self.slip.breakaway / c,
            deformation=x,
            nonlinear=h - equivalent * x,
            parallel=h,
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values in SI units; `from_dict` reads them back without loss."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "name": self.name,
            "slip": {"breakaway_m": self.slip.breakaway.tolist(), "stiffness_V_per_m": self.slip.stiffness.tolist()},
            "spring": {"displacement_m": self.spring.displacement.tolist(), "voltage_V": self.spring.voltage.tolist()},
            "state": {"displacement_m": self.state.displacement, "carts_m": self.state.carts.tolist()},
            "limits": None if self.limits is None else {"voltage_V": list(self.limits)},
            "delay_s": self.delay,
            "provenance": dict(self.provenance),
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Actuator:
        """Rebuild from `as_dict`, strictly.

        Raises
        ------
        ModelError
            If the format or version is another one, a key is unknown or missing, or a number is impossible.
        """
        version = data.get("version")
        if data.get("format") != FORMAT or type(version) is not int or version != VERSION:
            raise ModelError(
                f"got format {data.get('format')!r} version {data.get('version')!r}, need {FORMAT!r} version {VERSION}"
            )
        _demand_keys(data, _KEYS, "model")
        slip = _part(data, "slip", {"breakaway_m", "stiffness_V_per_m"})
        spring = _part(data, "spring", {"displacement_m", "voltage_V"})
        state = _part(data, "state", {"displacement_m", "carts_m"})
        limits = None if data["limits"] is None else _part(data, "limits", {"voltage_V"})["voltage_V"]
        if not isinstance(data["name"], str) or not isinstance(data["provenance"], Mapping):
            raise ModelError("model: name must be text and provenance an object")
        return cls(
            MaxwellSlip(
                _numbers(slip["breakaway_m"], "slip.breakaway_m"),
                _numbers(slip["stiffness_V_per_m"], "slip.stiffness_V_per_m"),
            ),
            Spring(
                _numbers(spring["displacement_m"], "spring.displacement_m"),
                _numbers(spring["voltage_V"], "spring.voltage_V"),
            ),
            State(number(state["displacement_m"], "state.displacement_m"), _numbers(state["carts_m"], "state.carts_m")),
            limits=None if limits is None else _pair(limits),
            delay=number(data["delay_s"], "delay_s"),
            name=data["name"],
            provenance=data["provenance"],
        )

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
        start = self.state if state is None else state
        if not isinstance(start, State):
            raise ModelError(f"state: got {type(start).__name__}, need a State, such as the one a Motion hands back")
        if start.carts.size != len(self.slip):
            raise ModelError(f"state: got {start.carts.size} carts, this actuator has {len(self.slip)} elements")
        excess = np.abs(start.displacement - start.carts) - self.slip.breakaway
        worst = int(np.argmax(excess)) if excess.size else 0
        if excess.size and excess[worst] > 1e-9 * (self.slip.breakaway[worst] + abs(start.displacement)):
            raise ModelError(
                f"state: cart {worst} is {excess[worst]:.3g} m farther from the displacement than its breakaway "
                f"elongation {self.slip.breakaway[worst]:.3g} m"
            )
        return start if not excess.size or excess[worst] <= 0 else State(start.displacement, self._pulled(start))

    def _pulled(self, state: State) -> Array:
        low, high = state.displacement - self.slip.breakaway, state.displacement + self.slip.breakaway
        return frozen(np.clip(state.carts, low, high))


def _demand_keys(data: Mapping[str, Any], needed: set[str], where: str) -> None:
    missing, unknown = sorted(needed - set(data)), sorted(set(data) - needed)
    if missing or unknown:
        raise ModelError(f"{where}: missing keys {missing}, unknown keys {unknown}; need exactly {sorted(needed)}")


def _part(data: Mapping[str, Any], key: str, needed: set[str]) -> Mapping[str, Any]:
    part = data[key]
    if not isinstance(part, Mapping):
        raise ModelError(f"model: {key} must be an object with keys {sorted(needed)}, got {type(part).__name__}")
    _demand_keys(part, needed, key)
    return part


def _numbers(values: Any, where: str) -> Array:
    if not isinstance(values, list):
        raise ModelError(f"{where}: got {type(values).__name__}, need a list of numbers")
    return np.array([number(value, f"{where}[{i}]") for i, value in enumerate(values)], dtype=np.float64)


def _pair(values: Any) -> tuple[float, float]:
    if not isinstance(values, list) or len(values) != 2:
        raise ModelError(f"limits.voltage_V: got {values!r}, need two numbers")
    return number(values[0], "limits.voltage_V"), number(values[1], "limits.voltage_V")
