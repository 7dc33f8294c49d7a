"""A virtual stage: several virtual actuators whose displacements are coupled, by a matrix or with hysteresis."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import matrix
from dehyst.virtual.base import Sensor, VirtualActuator
from dehyst.virtual.plays import PlayActuator

# Width of the loop of the second element of an axis, where coupling has hysteresis: wider than any actuator's.
_WIDE = 0.95


class VirtualStage:
    """Virtual actuators on one moving body: ``y = C h(v)``, and with hysteretic coupling ``y = C h(v) + K g(v)``.

    Raise `ModelError` if the matrices do not fit the actuators, or the diagonal of the coupling is not 1. `strokes` [m]
    and `highest` [V] (axes,) belong to the actuators; the `serial` number is the same for equal parameters.

    Parameters
    ----------
    actuators : sequence of VirtualActuator
        One for each axis; their own noise is not used.
    coupling : (axes, axes) array_like
        Displacement of axis i by the displacement of actuator j; 1 on the diagonal.
    hysteretic : (axes, axes) array_like, optional
        Displacement of axis i by a second element of actuator j, a play with a wide loop; default: none.
    noise, seed : float, int
        Standard deviation [m] and seed of the noise of each sensor.
    """

    def __init__(
        self,
        actuators: Sequence[VirtualActuator],
        coupling: ArrayLike,
        *,
        hysteretic: ArrayLike | None = None,
        noise: float = 2e-9,
        seed: int = 0,
    ) -> None:
        driven = list(actuators)
        self.coupling = _square(coupling, len(driven), "coupling")
        if np.any(np.diag(self.coupling) != 1):
            raise ModelError(
                argument="coupling", got=f"the diagonal {np.diag(self.coupling).tolist()}", need="1 for each axis"
            )
        none = np.zeros_like(self.coupling)
        self.hysteretic = none if hysteretic is None else _square(hysteretic, len(driven), "hysteretic")
        # A second element that moves nothing is left out.
        self._driven = [
            (one, _second(one) if column.any() else None) for one, column in zip(driven, self.hysteretic.T, strict=True)
        ]
        # Of each axis what was played since the last `take`: time, voltage, own and second displacement, (4, n) each.
        self._motions: list[list[Array]] = [[] for _ in driven]
        self.strokes = np.array([one.stroke for one in driven])
        self.highest = np.array([one.highest for one in driven])
        self.noise, self.seed = noise, seed
        self._sensors = [Sensor(noise, seed + j) for j in range(len(driven))]
        parts = [*(one.fingerprint() for one in driven), self.coupling.tobytes().hex(), self.hysteretic.tobytes().hex()]
        self.serial = f"stage-{hashlib.sha256(' '.join(parts).encode()).hexdigest()[:12]}"

    @classmethod
    def of_one(cls, actuator: VirtualActuator) -> VirtualStage:
        """Return a body that one `actuator` moves, with its noise and its fingerprint."""
        noise, seed = getattr(actuator, "noise", 0.0), getattr(actuator, "seed", 0)
        stage = cls([actuator], np.eye(1), noise=float(noise), seed=int(seed))
        stage.serial = actuator.fingerprint()
        return stage

    def __len__(self) -> int:
        return len(self._driven)

    def relax(self) -> None:
        """Reset every actuator to rest at 0 V."""
        for one, second in self._driven:
            one.relax()
            if second is not None:
                second.relax()
        self._motions = [[] for _ in self._driven]

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n, axes) [V] at `time` (n,) [s]; return the displacements (n, axes) [m].

        `time` is needed by actuators that move in time. With `measured` the sensors' noise is added.
        """
        v = matrix(voltage, "voltage")
        if v.shape[1] != len(self):
            raise ModelError(argument="voltage", got=f"{v.shape[1]} columns", need=f"{len(self)}, one an axis")
        for j in range(len(self)):
            self.drive(j, np.ascontiguousarray(v[:, j]), time)
        y = self.joined([one[:, -len(v) :] for one in self.take()])
        return np.column_stack([sensor.read(y[:, i]) for i, sensor in enumerate(self._sensors)]) if measured else y

    def drive(self, axis: int, voltage: Array, time: ArrayLike | None = None) -> None:
        """Play a `voltage` (n,) [V] at `time` (n,) [s] on the actuator of an `axis` (0, 1, ...), noting it."""
        actuator, second = self._driven[axis]
        at = np.full(voltage.size, np.nan) if time is None else np.asarray(time, dtype=np.float64)
        own = actuator.play(voltage, time=time, measured=False)
        other = np.zeros(voltage.size) if second is None else second.play(voltage, time=time, measured=False)
        self._motions[axis].append(np.array([at, voltage, own, other]))

    def take(self) -> list[Array]:
        """Return the motion of each axis since the last call and one sample before: rows (4, n) as in `joined`."""
        taken = [np.concatenate(motions, axis=1) for motions in self._motions]
        self._motions = [[motion[:, -1:]] for motion in taken]
        return taken

    def joined(self, motions: Sequence[Array]) -> Array:
        """Return the displacements (n, axes) [m] of the body.

        `motions`: for each axis time, voltage, own displacement, and displacement of its second element, (4, n).
        """
        # In a fixed order: a product of matrices would depend on the number of samples in its last digits.
        parts = [(column, motion[2]) for column, motion in zip(self.coupling.T, motions, strict=True)]
        parts += [(column, motion[3]) for column, motion in zip(self.hysteretic.T, motions, strict=True)]
        y = np.zeros((motions[0].shape[1], len(motions)))
        for column, moved in parts:
            y += moved[:, None] * column
        return y

    def present(self) -> Array:
        """Return the displacements (axes,) [m] of the body after all voltages so far."""
        return np.asarray(self.joined([motions[-1][:, -1:] for motions in self._motions])[0])


def spread_coupling(axes: int, share: float) -> Array:
    """Return a matrix (axes, axes) with zeros on its diagonal; other entries are different and at most `share`."""
    i, j = np.indices((axes, axes))
    sign = np.where((i + j) % 2 == 0, 1.0, -1.0)
    size = 1.0 - 0.5 * ((axes * i + j) % (axes * axes)) / (axes * axes)
    return np.asarray(np.where(i == j, 0.0, share * sign * size))


def _second(one: VirtualActuator) -> PlayActuator:
    return PlayActuator(stroke=one.stroke, highest=one.highest, width=_WIDE, noise=0.0)


def _square(values: ArrayLike, count: int, what: str) -> Array:
    table = matrix(values, what)
    if table.shape != (count, count):
        raise ModelError(
            argument=what, got=f"{table.shape[0]} x {table.shape[1]} numbers for {count} axes", need="one a pair"
        )
    return table
