"""Types shared by all models: their interface, a motion and a state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import keep, number, vector
from dehyst._views.lines import span_of
from dehyst.model.entries import Entries, Numbers, demand_keys, entry

if TYPE_CHECKING:
    from dehyst.model.entries import Numeric


# A state may hold numbers of any size. A computation refuses a number that is too large for it.
_ANY = Numbers(largest=inf), Numbers(1, largest=inf)
_OF_MOTION = "displacement_m", "velocity_m_per_s"


def _motion(value: Any, where: str) -> Array:
    """Return displacement and velocity of a mass, from two numbers or the keys of a file; empty for None."""
    if isinstance(value, Mapping):
        demand_keys(value, {*_OF_MOTION}, where)
        value = [number(value[key], where) for key in _OF_MOTION]
    found = vector(() if value is None else value, where)
    if found.size not in (0, 2):
        raise ModelError(argument=where, got=f"{found.size} numbers", need="displacement and velocity, or none")
    return found


@dataclass(frozen=True, eq=False, repr=False)
class State(Entries):
    """The memory of an actuator; `Actuator.displacement` returns the displacement in a state.

    Attributes
    ----------
    deformation : float
        Deformation w of the slip elements [m]: the displacement of the actuator without creep in displacement, load,
        inertia, gain and offset.
    carts : (N,) array
        Position of the cart (sliding end) of each slip element [m].
    motion : (0,) or (2,) array
        Displacement [m] and velocity [m/s] of the mass, with dynamics; empty: at rest at `deformation`.
    smooth : (L,) array
        Elongation q_l of each smooth element [m]; empty: none is elongated.
    displacement_creep : (K,) array
        Strain e_k of each branch of creep in displacement [m]; empty: creep is at rest.
    """

    _part = "state"
    _order = "deformation carts smooth displacement_creep motion"
    deformation: float = entry("deformation_m", _ANY[0])
    carts: Numeric = entry("carts_m", _ANY[1])
    motion: Numeric = entry("motion", _motion, ())
    smooth: Numeric = entry("smooth_m", _ANY[1], ())
    displacement_creep: Numeric = entry("displacement_creep_m", _ANY[1], ())

    @classmethod
    def _unchecked(
        cls, deformation: float, carts: Array, motion: Array, smooth: Array, displacement_creep: Array
    ) -> State:
        """Return a state of arrays that a computation made from a valid state; they are not copied and not checked."""
        state = cls.__new__(cls)
        parts = {"motion": motion, "smooth": smooth, "displacement_creep": displacement_creep}
        keep(state, deformation=deformation, carts=carts, **parts)
        return state

    def __repr__(self) -> str:
        more = {"smooth elongations": self.smooth, "creep strains": self.displacement_creep}
        parts = "".join(f", {values.size} {name}" for name, values in more.items() if values.size)
        speed = f", {self.motion[1]:.4g} m/s" if self.motion.size else ""
        return f"<State: deformation {self.deformation * 1e6:.6g} um{speed}, {counted(self.carts.size, 'cart')}{parts}>"

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values; `from_dict` reads them back without loss."""
        return super().as_dict() | {"motion": dict(zip(_OF_MOTION, self.motion.tolist(), strict=False)) or None}


@dataclass(frozen=True, eq=False)
class Motion:
    """`voltage` (n,) [V] and `displacement` (n,) [m] of a motion, and the `state` at its last sample."""

    voltage: Array
    displacement: Array
    state: Any

    def __repr__(self) -> str:
        voltage, displacement = span_of(self.voltage, "V"), span_of(self.displacement, "um", 1e6)
        return f"<Motion: {counted(self.voltage.size, 'sample')}, {voltage}, {displacement}>"


class AbstractModel(ABC):
    """A model of hysteresis: voltage to displacement, and back."""

    @abstractmethod
    def simulate(self, voltage: ArrayLike, *, time: ArrayLike | None = None, state: Any = None) -> Motion:
        """Return the displacement that a `voltage` causes from `state`; `time` (n,) [s] if the model needs it."""

    @abstractmethod
    def compensate(self, displacement: ArrayLike, *, time: ArrayLike | None = None, state: Any = None) -> Motion:
        """Return the voltage with which the model follows a `displacement` from `state`; `time` as in `simulate`."""
