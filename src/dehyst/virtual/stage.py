"""A virtual stage: several virtual actuators whose displacements are coupled, by a matrix or with hysteresis."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import matrix
from dehyst.model import Actuator
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.modelled import ModelledActuator, fingerprint
from dehyst.virtual.plays import PlayActuator

# Width of the loop of the second element of an axis, where coupling has hysteresis: wider than any actuator's.
_WIDE = 0.95


class PortMotion(NamedTuple):
    """What one axis did: `time`, `voltage`, `own` displacement and that of its `second` element (n,) [s, V, m, m]."""

    time: Array
    voltage: Array
    own: Array
    second: Array


class AxisPort:
    """One actuator of a stage as a `VirtualActuator`, which notes what it does for the other axes.

    `actuator`: the axis' own. `second`: another element that follows the same voltage, or None.
    """

    def __init__(self, actuator: VirtualActuator, second: VirtualActuator | None) -> None:
        self.stroke, self.highest = actuator.stroke, actuator.highest
        self._actuator, self._second = actuator, second
        self.motions: list[PortMotion] = []

    def relax(self) -> None:
        """Reset to rest at 0 V, without residual strain."""
        self._actuator.relax()
        if self._second is not None:
            self._second.relax()
        self.motions.clear()

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n,) [V]; see `VirtualActuator.play`. `time` is noted; `measured` has no effect."""
        v = np.asarray(voltage, dtype=np.float64)
        at = np.full(v.size, np.nan) if time is None else np.asarray(time, dtype=np.float64)
        own = self._actuator.play(v, time=time, measured=False)
        second = np.zeros(v.size) if self._second is None else self._second.play(v, time=time, measured=False)
        self.motions.append(PortMotion(at, v, own, second))
        return own

    def take(self) -> PortMotion:
        """Return all motions noted so far as one; the last sample stays noted."""
        joined = PortMotion(*(np.concatenate(columns) for columns in zip(*self.motions, strict=True)))
        self.motions = [PortMotion(*(column[-1:] for column in joined))]
        return joined


class VirtualStage:
    """Virtual actuators on one moving body: ``y = C h(v)``, and with hysteretic coupling ``y = C h(v) + K g(v)``.

    Parameters
    ----------
    actuators : sequence of VirtualActuator or Actuator
        One an axis; their own noise is not used.
    coupling : (axes, axes) array_like
        Displacement of axis i by the displacement of actuator j; 1 on the diagonal.
    hysteretic : (axes, axes) array_like, optional
        Displacement of axis i by the second element of actuator j, whose loop has another shape; default: none.
    seconds : sequence of VirtualActuator, optional
        The second elements; default: plays with wide loops and the strokes of the actuators.
    noise : float
        Standard deviation of each sensor [m].
    seed : int
        Of the noise.

    Attributes
    ----------
    ports : tuple of AxisPort
        The actuators, each for an amplifier of its own.
    strokes, highest : (axes,) array
        Stroke [m] and highest voltage [V] of each actuator.
    serial : str
        The same for equal parameters.

    Raises
    ------
    ModelError
        If the matrices do not fit the actuators, or the diagonal of the coupling is not 1.
    """

    def __init__(
        self,
        actuators: Sequence[VirtualActuator | Actuator],
        coupling: ArrayLike,
        *,
        hysteretic: ArrayLike | None = None,
        seconds: Sequence[VirtualActuator] | None = None,
        noise: float = 2e-9,
        seed: int = 0,
    ) -> None:
        driven = [ModelledActuator(one) if isinstance(one, Actuator) else one for one in actuators]
        count = len(driven)
        self.coupling = _square(coupling, count, "coupling")
        if np.any(np.diag(self.coupling) != 1):
            raise ModelError(
                argument="coupling", got=f"the diagonal {np.diag(self.coupling).tolist()}", need="1 for each axis"
            )
        self.hysteretic = np.zeros((count, count)) if hysteretic is None else _square(hysteretic, count, "hysteretic")
        others = seconds or [_second(one) for one in driven]
        if len(others) != count:
            raise ModelError(argument="seconds", got=len(others), need=f"{count}, one an axis")
        used = [bool(column.any()) for column in self.hysteretic.T]
        self.ports = tuple(
            AxisPort(one, other if needed else None) for one, other, needed in zip(driven, others, used, strict=True)
        )
        self.strokes = np.array([one.stroke for one in driven])
        self.highest = np.array([one.highest for one in driven])
        self.noise, self.seed = noise, seed
        self._sensors = [Sensor(noise, seed + j) for j in range(count)]
        parts = [*map(fingerprint, driven), self.coupling.tobytes().hex(), self.hysteretic.tobytes().hex()]
        self.serial = f"stage-{hashlib.sha256(' '.join(parts).encode()).hexdigest()[:12]}"

    @classmethod
    def of_one(cls, actuator: VirtualActuator | Actuator) -> VirtualStage:
        """Return a body that one `actuator` moves, with its noise."""
        noise, seed = getattr(actuator, "noise", 0.0), getattr(actuator, "seed", 0)
        return cls([actuator], np.eye(1), noise=float(noise), seed=int(seed))

    def __len__(self) -> int:
        return len(self.ports)

    def relax(self) -> None:
        """Reset every actuator to rest at 0 V."""
        for port in self.ports:
            port.relax()

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n, axes) [V] at `time` (n,) [s]; return the displacements (n, axes) [m].

        `time` is needed by actuators that move in time. With `measured` the sensors' noise is added.
        """
        v = matrix(voltage, "voltage", "V")
        if v.shape[1] != len(self.ports):
            raise ModelError(argument="voltage", got=f"{v.shape[1]} columns", need=f"{len(self.ports)}, one an axis")
        for j, port in enumerate(self.ports):
            port.play(np.ascontiguousarray(v[:, j]), time=time)
        moved = [port.take() for port in self.ports]
        count = len(v)
        y = self.joined([one.own[-count:] for one in moved], [one.second[-count:] for one in moved])
        return np.column_stack([sensor.read(y[:, i]) for i, sensor in enumerate(self._sensors)]) if measured else y

    def joined(self, own: Sequence[Array], second: Sequence[Array]) -> Array:
        """Return the displacements (n, axes) [m] of the body.

        `own`, `second`: those of each actuator and of each second element, (n,) [m].
        """
        # In a fixed order: a product of matrices would depend on the number of samples in its last digits.
        parts = [*zip(self.coupling.T, own, strict=True), *zip(self.hysteretic.T, second, strict=True)]
        y = np.zeros((len(own[0]), len(own)))
        for column, moved in parts:
            y += moved[:, None] * column
        return y

    def present(self) -> Array:
        """Return the displacements (axes,) [m] of the body after all that was played."""
        last = [port.motions[-1] for port in self.ports]
        return np.asarray(self.joined([one.own[-1:] for one in last], [one.second[-1:] for one in last])[0])


def spread_coupling(axes: int, share: float) -> Array:
    """Return a matrix (axes, axes) with zeros on its diagonal and other entries of `share` at most, no two alike."""
    i, j = np.indices((axes, axes))
    sign = np.where((i + j) % 2 == 0, 1.0, -1.0)
    size = 1.0 - 0.5 * ((axes * i + j) % (axes * axes)) / (axes * axes)
    return np.asarray(np.where(i == j, 0.0, share * sign * size))


def _second(actuator: VirtualActuator) -> PlayActuator:
    return PlayActuator(stroke=actuator.stroke, highest=actuator.highest, width=_WIDE, noise=0.0)


def _square(values: ArrayLike, count: int, what: str) -> Array:
    table = matrix(values, what)
    if table.shape != (count, count):
        raise ModelError(
            argument=what, got=f"{table.shape[0]} x {table.shape[1]} numbers for {count} axes", need="one a pair"
        )
    return table
