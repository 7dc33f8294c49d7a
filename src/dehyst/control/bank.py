"""Many actuators in one call: inverse control and simulation, bit for bit as with one `Compensator` for each."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._native import Bank as Loops
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import FARTHEST, for_each
from dehyst.control.axis import axes_of, restore_all
from dehyst.control.limits import Clamps, ClampWarning
from dehyst.model import Actuator, State


class Bank:
    """Many actuators: wanted displacements in, voltages within limits out, or voltages in and displacements out.

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
        # The bank warns, of all actuators at once.
        begins = for_each(states, len(self.actuators), "states")
        given = {"limits": limits, "slew_rate": slew_rate, "state": begins}
        self._axes = axes_of(self.actuators, names, period, **given, runs=True)
        self._warned: set[str] = set()
        self.reset()

    def __len__(self) -> int:
        return len(self.actuators)

    def __repr__(self) -> str:
        period = "" if self.period is None else f", every {self.period:g} s"
        return f"<Bank of {counted(len(self), 'actuator')}{period}>"

    def step(self, displacement: ArrayLike, out: Array | None = None) -> Array:
        """Return the voltages (M,) [V] to send for wanted displacements (M,) [m], and commit them.

        `out` (M,): array for the result, so that no memory is allocated.

        Raises
        ------
        ModelError
            If a shape is wrong or a value not finite: the memory is unchanged, and no time has passed.

        Warns
        -----
        ClampWarning
            Once for limits and once for the slew rate; `clamps` counts all clamped samples.
        """
        row = np.asarray(displacement)
        if row.shape != (len(self),):
            raise ModelError(
                argument="displacement", got=f"the shape {row.shape}", need=f"one for each of {len(self)} actuators"
            )
        result: Array = np.empty(len(self)) if out is None else out
        fits = isinstance(result, np.ndarray) and result.shape == (len(self),) and result.dtype == np.float64
        if not (fits and result.flags.c_contiguous and result.flags.writeable):
            raise ModelError(f"out: need a writeable array of {len(self)} float64 in a row")
        # It sends nothing if a displacement is refused or a voltage clamped.
        if row.dtype != np.float64 or not row.flags.c_contiguous or not self._loops.step(row, result):
            self._follow(self._table(row[None], "displacement"), result[None])
        return result

    def compensate(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n, M) [V] to send for wanted displacements (n, M) [m], and commit them.

        Raises
        ------
        ModelError
            If the shape is wrong, a value is not finite, or a displacement lies more than a stroke outside of its
            model's reach: the memory is unchanged.

        Warns
        -----
        ClampWarning
            As `step`.
        """
        wanted = self._table(displacement, "displacement")
        for i, axis in enumerate(self._axes):
            if sentence := axis.strays(wanted[:, i]):
                raise ModelError(f"actuator {i}: {sentence}")
        result = np.empty(wanted.shape)
        self._follow(wanted, result)
        return result

    def simulate(self, voltage: ArrayLike) -> Array:
        """Return the displacements (n, M) [m] that voltages (n, M) [V] cause without limits, and update the memory.

        Raises
        ------
        ModelError
            If the shape is wrong or a value not finite: the memory is unchanged. If a displacement would be too large
            to compute with: this voltage has no effect.
        """
        played = self._table(voltage, "voltage")
        result, before = np.empty(played.shape), self._counts[2]
        if refused := self._loops.run(played, result, True)[2] - before:
            raise ModelError(f"voltage: {refused} of {played.size} cause displacements too large to compute with")
        return result

    @property
    def states(self) -> tuple[State, ...]:
        """State of each actuator after all voltages sent."""
        return tuple(axis.state for axis in self._axes)

    @property
    def clamps(self) -> tuple[Clamps, ...]:
        """Numbers of samples clamped so far, of each actuator."""
        return tuple(axis.clamps for axis in self._axes)

    def snapshot(self) -> tuple[bytes, ...]:
        """Return the whole memory, one snapshot for each actuator."""
        return tuple(axis.snapshot() for axis in self._axes)

    def restore(self, snapshots: Sequence[bytes]) -> None:
        """Continue from `snapshots`, one for each actuator.

        Raise `ModelError` as `Compensator.restore`, or if the number of snapshots is wrong: the memory is unchanged.
        """
        restore_all(self._axes, snapshots)

    def reset(self) -> None:
        """Return to the initial states and set the counts of clamped samples to 0."""
        self._axes = tuple(replace(axis) for axis in self._axes)
        self._loops = Loops([axis.loop for axis in self._axes])

    @property
    def _counts(self) -> tuple[int, int, int]:
        """Numbers of samples limited, slewed and refused, of all actuators."""
        return self._loops.run(np.empty((0, len(self))), np.empty((0, len(self))), False)

    def _follow(self, wanted: Array, voltage: Array) -> None:
        """Compute the `voltage` (n, M) [V] for displacements (n, M) [m], and warn of the first clamps of each kind."""
        before, memory = self._counts, () if len(self._warned) == 2 else self.snapshot()
        after = self._loops.run(wanted, voltage, False)
        if after == before:
            return
        each, kinds = np.array(self.clamps), ("at a limit", "by the slew rate")
        for kind, now, then, clamped in zip(kinds, after[:2], before[:2], each.T, strict=True):
            if now == then or kind in self._warned:
                continue
            i = int(np.argmax(clamped))
            sentence = self._axes[i].strays(wanted[:, i])
            more = f". {sentence}" if sentence else ""
            words = f"{now - then} of {wanted.size} voltages clamped {kind}, of actuator {i} the most{more}"
            try:
                warnings.warn(words, ClampWarning, 3)
            except ClampWarning:
                self.restore(memory)
                raise
            self._warned.add(kind)

    def _table(self, values: ArrayLike, what: str) -> Array:
        """Return samples (n, M); raise `ModelError` if they have another shape, or one is not a finite number."""
        given, count = np.asarray(values), len(self)
        if given.dtype.kind not in "iuf":
            raise ModelError(argument=what, got=f"an array of {given.dtype}", need="numbers")
        table = np.ascontiguousarray(given, dtype=np.float64)
        if table.ndim != 2 or table.shape[1] != count:
            need = f"a column for each of {count} actuators"
            raise ModelError(argument=what, got=f"the shape {table.shape}", need=need)
        if table.size and not (table.max() <= FARTHEST and table.min() >= -FARTHEST):
            t, i = np.argwhere(~(np.abs(table) <= FARTHEST))[0]
            raise ModelError(f"{what}: sample {t} of actuator {i} is {table[t, i]}, need finite numbers")
        return table
