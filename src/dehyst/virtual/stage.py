"""A virtual stage: several virtual actuators whose displacements are coupled by a matrix."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import matrix
from dehyst.virtual.base import Sensor, VirtualActuator


class VirtualStage:
    """Virtual actuators on one moving body: ``y = C h(v)``.

    Raise `ModelError` if the matrix does not fit the actuators, or the diagonal of the coupling is not 1. `strokes` [m]
    and `highest` [V] (axes,) belong to the actuators; the `serial` number is the same for equal parameters.

    Parameters
    ----------
    actuators : sequence of VirtualActuator
        One for each axis; the noise of the actuators is not used.
    coupling : (axes, axes) array_like
        Displacement of axis i per displacement of actuator j; 1 on the diagonal.
    noise, seed : float, int
        Standard deviation [m] and seed of the noise of each sensor.
    """

    def __init__(
        self,
        actuators: Sequence[VirtualActuator],
        coupling: ArrayLike,
        *,
        noise: float = 2e-9,
        seed: int = 0,
    ) -> None:
        self._driven = driven = list(actuators)
        self.coupling = _square(coupling, len(driven), "coupling")
        if np.any(np.diag(self.coupling) != 1):
            raise ModelError(
                argument="coupling", got=f"the diagonal {np.diag(self.coupling).tolist()}", need="1 for each axis"
            )
        # Time, voltage and displacement of each actuator since the last `take`, (3, n) each.
        self._motions: list[list[Array]] = [[] for _ in driven]
        self.strokes = np.array([actuator.stroke for actuator in driven])
        self.highest = np.array([actuator.highest for actuator in driven])
        self.noise, self.seed = noise, seed
        self._sensors = [Sensor(noise, seed + j) for j in range(len(driven))]
        parts = [*(actuator.fingerprint() for actuator in driven), self.coupling.tobytes().hex()]
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
        for actuator in self._driven:
            actuator.relax()
        self._motions = [[] for _ in self._driven]

    def play(self, voltage: ArrayLike, *, time: ArrayLike | None = None, measured: bool = True) -> Array:
        """Play a `voltage` (n, axes) [V] at `time` (n,) [s]; return the displacements (n, axes) [m].

        `time` is needed by actuators that depend on time. With `measured` the noise of the sensors is added.
        """
        v = matrix(voltage, "voltage")
        if v.shape[1] != len(self):
            raise ModelError(argument="voltage", got=f"{v.shape[1]} columns", need=f"{len(self)}, one per axis")
        for j in range(len(self)):
            self.drive(j, np.ascontiguousarray(v[:, j]), time)
        y = self.joined([motion[:, -len(v) :] for motion in self.take()])
        return np.column_stack([sensor.read(y[:, i]) for i, sensor in enumerate(self._sensors)]) if measured else y

    def drive(self, axis: int, voltage: Array, time: ArrayLike | None = None) -> None:
        """Play a `voltage` (n,) [V] at `time` (n,) [s] on the actuator of an `axis` (0, 1, ...); keep the motion."""
        at = np.full(voltage.size, np.nan) if time is None else np.asarray(time, dtype=np.float64)
        own = self._driven[axis].play(voltage, time=time, measured=False)
        self._motions[axis].append(np.array([at, voltage, own]))

    def take(self) -> list[Array]:
        """Return the motion of each axis since the last call, and one sample before: arrays (3, n) for `joined`."""
        taken = [np.concatenate(motions, axis=1) for motions in self._motions]
        self._motions = [[motion[:, -1:]] for motion in taken]
        return taken

    def joined(self, motions: Sequence[Array]) -> Array:
        """Return the displacements (n, axes) [m] of the body.

        `motions`: time, voltage and displacement (3, n) of the actuator of each axis.
        """
        # The order of the sum is fixed: the last digits of a matrix product would depend on the number of samples.
        y = np.zeros((motions[0].shape[1], len(motions)))
        for column, motion in zip(self.coupling.T, motions, strict=True):
            y += motion[2][:, None] * column
        return y

    def present(self) -> Array:
        """Return the displacements (axes,) [m] of the body after all voltages so far."""
        return np.asarray(self.joined([motions[-1][:, -1:] for motions in self._motions])[0])


def _square(values: ArrayLike, count: int, what: str) -> Array:
    table = matrix(values, what)
    if table.shape != (count, count):
        raise ModelError(
            argument=what, got=f"{table.shape[0]} x {table.shape[1]} numbers for {count} axes", need="one per pair"
        )
    return table
