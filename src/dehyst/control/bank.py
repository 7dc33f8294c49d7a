"""Many actuators in one call: their voltages, bit for bit as with one `Compensator` for each."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Bank as Loops
from dehyst._types import Array
from dehyst._validation import FARTHEST, for_each, matrix, vector
from dehyst.control.axis import Axis, axes_of, restore_all
from dehyst.control.limits import Clamps, ClampWarning
from dehyst.model import Actuator, State


class Bank:
    """Many actuators: wanted displacements in, voltages within limits out.

    In arrays, each row is a sample and each column an actuator. Every actuator has its own memory, limits and slew
    rate. Its voltages are bit for bit those of a `Compensator` of its own::

        bank = dehyst.Bank(actuators, (0, 100), slew_rate=2e4, period=1e-3)
        for wanted in path:          # (n, M) [m]
            dac.write(bank.step(wanted))

    Parameters
    ----------
    actuators : sequence of M Actuator
    limits : (float, float) or sequence of M such pairs, optional
        Lowest and highest voltage [V]; default: those of each actuator.
    slew_rate : float or sequence of M floats, optional
        Largest abs(dv/dt) [V/s] between samples; default: not limited.
    period : float, optional
        Seconds between samples; needed with a slew rate, and by actuators with creep, dynamics or a lag.
    states : State or sequence of M State, optional
        Where each actuator starts; default: its own state, usually the top of its records, as in `Compensator`.

    Attributes
    ----------
    actuators : tuple of Actuator
    period
        As given.

    Raises
    ------
    ModelError
        If there is no actuator, a list has another length than the actuators, or one of them cannot have a
        `Compensator` with these arguments; the error names this actuator.
    """

    def __init__(
        self,
        actuators: Sequence[Actuator],
        limits: Any = None,
        slew_rate: float | Sequence[float] | None = None,
        *,
        period: float | None = None,
        states: State | Sequence[State] | None = None,
    ) -> None:
        if not isinstance(actuators, Iterable):
            got = type(actuators).__name__
            raise ModelError(argument="actuators", got=got, need="a list with one for each actuator")
        self.actuators, self.period = tuple(actuators), period
        if not self.actuators:
            raise ModelError("actuators: got none, need one at least")
        names = [f"actuator {i}" for i in range(len(self.actuators))]
        # The bank itself warns, once for all actuators.
        begins = for_each(states, len(self.actuators), "states")
        given = {"limits": limits, "slew_rate": slew_rate, "state": begins}
        self._axes = axes_of(self.actuators, names, period, **given, runs=True)
        self._warned: set[str] = set()
        self._loops = Loops([axis.loop for axis in self._axes])

    def __len__(self) -> int:
        return len(self.actuators)

    def step(self, displacement: ArrayLike) -> Array:
        """Return the voltages (M,) [V] to send for wanted displacements (M,) [m], and commit them.

        Raise `ModelError` and warn `ClampWarning` as `run`; a displacement outside of the reach is clamped.
        """
        given, result = displacement, np.empty(len(self))
        row = given if isinstance(given, np.ndarray) else vector(given, "displacement")
        plain = row.shape == result.shape and row.dtype == np.float64 and row.flags.c_contiguous
        # The step in C sends nothing if it refuses a displacement or would clamp a voltage.
        if not plain or not self._loops.step(row, result):
            result = self._follow(self._table(row[None]))[0]
        return result

    def run(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n, M) [V] to send for wanted displacements (n, M) [m], and commit them.

        Raises
        ------
        ModelError
            If the shape is wrong, a value is not finite, or a displacement lies more than a stroke outside of its
            model's reach: the memory is unchanged, and no time has passed.

        Warns
        -----
        ClampWarning
            Once for limits and once for the slew rate; `clamps` counts all clamped samples.
        """
        wanted = self._table(displacement)
        for i, axis in enumerate(self._axes):
            if sentence := axis.strays(wanted[:, i]):
                raise ModelError(f"actuator {i}: {sentence}")
        return self._follow(wanted)

    @property
    def states(self) -> tuple[State, ...]:
        """State of each actuator after all voltages sent."""
        return tuple(axis.state for axis in self._axes)

    @property
    def clamps(self) -> tuple[Clamps, ...]:
        """Numbers of samples clamped so far, of each actuator."""
        return tuple(axis.clamps for axis in self._axes)

    def _follow(self, wanted: Array) -> Array:
        """Return the voltages (n, M) [V] for displacements (n, M) [m], and warn of the first clamps of each kind."""
        voltage, memory = np.empty(wanted.shape), [] if len(self._warned) == 2 else [*map(Axis.snapshot, self._axes)]
        none = np.empty((0, len(self)))
        before, after = self._loops.run(none, none, False), self._loops.run(wanted, voltage, False)
        for kind, now, then in zip(("limited", "slewed"), after[:2], before[:2], strict=True):
            if now > then and kind not in self._warned:
                most = int(np.argmax([getattr(clamps, kind) for clamps in self.clamps]))
                words = f"{now - then} of {wanted.size} voltages {kind}; actuator {most} has the most so far"
                try:
                    warnings.warn(words, ClampWarning, 3)
                except ClampWarning:
                    restore_all(self._axes, memory)
                    raise
                self._warned.add(kind)
        return voltage

    def _table(self, displacement: ArrayLike) -> Array:
        """Return displacements (n, M); raise `ModelError` if the shape is wrong, or a value is not finite."""
        table = matrix(displacement, "displacement")
        if table.shape[1] != len(self):
            need = f"a column for each of {len(self)} actuators"
            raise ModelError(argument="displacement", got=f"the shape {table.shape}", need=need)
        for t, i in np.argwhere(np.abs(table) > FARTHEST):
            raise ModelError(f"displacement: sample {t} of actuator {i} is {table[t, i]}, too large to compute with")
        return table
