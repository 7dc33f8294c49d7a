"""Many actuators in one call: inverse control and simulation, bit for bit as with one `Compensator` for each."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import ModelError, of_part
from dehyst._native import BankCore, BankMemory, CoreState, checked, has_avx2
from dehyst._text import counted
from dehyst._types import Array
from dehyst._validation import for_each, number
from dehyst.control.compensator import Compensator
from dehyst.control.limits import ClampWarning, stray_sentence
from dehyst.control.loop import step_numbers
from dehyst.model import Actuator, State

_COLUMNS = ("displacement", "carts", "creep", "voltage")


class BankClamps(NamedTuple):
    """Clamped samples of each actuator.

    `limited` (M,): number of samples clamped at a limit. `slewed` (M,): number of samples held back by the slew rate.
    """

    limited: NDArray[np.int64]
    slewed: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BankState:
    """The memory of the M actuators of a bank, one column for each actuator.

    Attributes
    ----------
    displacement : (M,) array
        Displacement of each actuator [m].
    carts : (N, M) array
        Position of each cart [m]; the last rows are unused by an actuator with fewer than N elements.
    creep : (J, M) array
        Strain of each creep branch [m].
    voltage : (M,) array
        Last voltage of each actuator [V].
    alone : mapping of int to array
        Complete memory of each actuator that is computed one by one, see `Bank.alone`.
    actuators : str
        Digest of the models and the period; a bank with others refuses the state. Empty: not checked.
    """

    displacement: Array
    carts: Array
    creep: Array
    voltage: Array
    alone: Mapping[int, Array] = field(default_factory=dict)
    actuators: str = ""

    def copy(self) -> BankState:
        """Return a copy that no longer changes with the bank."""
        alone = {i: row.copy() for i, row in self.alone.items()}
        return replace(self, alone=alone, **{name: getattr(self, name).copy() for name in _COLUMNS})


class Bank:
    """Many actuators: wanted displacements in, voltages within limits out, or voltages in and displacements out.

    In arrays, each row is a sample and each column an actuator. Every actuator has its own memory, limits and slew
    rate. Its voltages are bit for bit those of a `Compensator` of its own::

        bank = dehyst.Bank(actuators, (0, 100), slew_rate=2e4, period=1e-3)
        for wanted in path:          # (n, M) [m]
            dac.write(bank.step(wanted))

    Plain elements, a transformer and creep are computed several actuators at a time. An actuator with graded or smooth
    elements, a mass or a lagging amplifier is computed alone, which takes longer; `alone` holds these and the reasons.

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
    threads : int, optional
        Number of threads among which the actuators are divided; default 1.

    Attributes
    ----------
    actuators : tuple of Actuator
    alone : dict of int to str
        The actuators that are computed one by one, and for each the part that is the reason.
    period, threads
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
        threads: int = 1,
    ) -> None:
        self.actuators = tuple(_listed(actuators, "actuators"))
        if not self.actuators:
            raise ModelError("actuators: got none, need one at least")
        many = number(threads, "threads")
        if many < 1 or many != int(many):
            raise ModelError(f"threads: got {threads}, need a whole number from 1 on")
        self.period, self.threads, size = period, int(many), len(self.actuators)
        given = {"limits": limits, "slew_rate": slew_rate, "states": states}
        columns = zip(self.actuators, *(for_each(one, size, what) for what, one in given.items()), strict=True)
        # They check what was given. Their own warnings would not say which actuator it is.
        self._each: list[Compensator] = []
        for i, (actuator, bounds, slew, state) in enumerate(columns):
            try:
                self._each.append(Compensator(actuator, bounds, slew, period=period, state=state))
            except ModelError as error:
                raise of_part(error, f"actuator {i}") from error
        self.alone = {i: reason for i, one in enumerate(self.actuators) if (reason := _reason_alone(one))}
        self._laned = np.array([i for i in range(size) if i not in self.alone], dtype=np.intp)
        self._whole = self._laned.size == size
        self._core = self._lanes() if self._laned.size else None
        self._warned: set[str] = set()
        self.reset()

    def __len__(self) -> int:
        return len(self.actuators)

    def __repr__(self) -> str:
        how = "AVX2" if has_avx2() else "no AVX2"
        alone = f", {len(self.alone)} of them alone" if self.alone else ""
        period = "" if self.period is None else f", every {self.period:g} s"
        return f"<Bank of {counted(len(self), 'actuator')}{alone}{period}, {how}, {counted(self.threads, 'thread')}>"

    def step(self, displacement: ArrayLike, out: Array | None = None) -> Array:
        """Return the voltages (M,) [V] to send for wanted displacements (M,) [m], and commit them.

        Parameters
        ----------
        displacement : (M,) array
            Wanted displacements [m].
        out : (M,) array, optional
            Array for the result, so that no memory is allocated.

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
        wanted = _table(row[None], "displacement", len(self))
        result: Array = np.empty(len(self)) if out is None else out
        fits = isinstance(result, np.ndarray) and result.shape == (len(self),) and result.dtype == np.float64
        if not (fits and result.flags.c_contiguous and result.flags.writeable):
            raise ModelError(f"out: need a writeable array of {len(self)} float64 in a row")
        self._run(wanted, result[None], plays=False)
        self._report(wanted)
        return result

    def compensate(self, displacement: ArrayLike) -> Array:
        """Return the voltages (n, M) [V] to send for n samples of wanted displacements, and commit them.

        Parameters
        ----------
        displacement : (n, M) array
            Wanted displacements [m].

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
        wanted = _table(displacement, "displacement", len(self))
        self._refuse_strays(wanted)
        result = np.empty(wanted.shape)
        self._run(wanted, result, plays=False)
        self._report(wanted)
        return result

    def simulate(self, voltage: ArrayLike) -> Array:
        """Return the displacements (n, M) [m] that voltages cause, without regard to limits, and update the memory.

        Parameters
        ----------
        voltage : (n, M) array
            Voltages [V].

        Raises
        ------
        ModelError
            If the shape is wrong or a value not finite: the memory is unchanged. If a displacement would be too large
            to compute with: this voltage has no effect.
        """
        played = _table(voltage, "voltage", len(self))
        result = np.empty(played.shape)
        before = self._memory.counts[2].sum()
        self._run(played, result, plays=True)
        if refused := self._memory.counts[2].sum() - before:
            raise ModelError(f"voltage: {refused} of {played.size} cause displacements too large to compute with")
        return result

    @property
    def state(self) -> BankState:
        """A copy of the present memory, for a later `restore`."""
        return self.memory.copy() if self._whole else self._scattered()

    @property
    def memory(self) -> BankState:
        """The memory itself, without a copy: it changes with the next step, and writing into it sets the state.

        Raise `ModelError` if an actuator is computed alone, because its memory is not a column of these arrays.
        """
        if not self._whole:
            raise ModelError(f"memory: {counted(len(self.alone), 'actuator')} computed alone; take state, a copy")
        one = self._memory
        return BankState(one.w, one.carts, one.strains, one.sent, {}, self._digest)

    def restore(self, state: BankState) -> None:
        """Set the memory to a `state` of this bank, or of another bank of the same actuators with the same period.

        Raise `ModelError` if the state does not fit: the memory is unchanged.
        """
        self._demand_fitting(state)
        before = {i: loop.row() for i, loop in self._loops.items()}
        try:
            for i, loop in self._loops.items():
                checked(loop.place, state.alone[i])
        except ModelError:
            for i, loop in self._loops.items():
                loop.place(before[i])
            raise
        memory, columns = self._memory, self._laned
        memory.w[:], memory.sent[:] = state.displacement[columns], state.voltage[columns]
        for mine, theirs in ((memory.carts, state.carts), (memory.strains, state.creep)):
            mine[:] = theirs[: mine.shape[0], columns]

    def _demand_fitting(self, state: BankState) -> None:
        if not isinstance(state, BankState):
            raise ModelError(f"state: got {type(state).__name__}, need the state of a bank")
        own = self.state
        for name in _COLUMNS:
            given, shape = getattr(state, name), getattr(own, name).shape
            if np.shape(given) != shape:
                raise ModelError(f"state: {name} has the shape {np.shape(given)}, this bank needs {shape}")
            if not np.isfinite(given).all():
                raise ModelError(f"state: {name} holds a value that is not finite")
        if set(state.alone) != set(own.alone) or state.actuators not in ("", own.actuators):
            raise ModelError("state: belongs to a bank of other actuators; take the state of a bank made the same way")
        for i in self._laned:
            rho, y = self.actuators[i].slip.breakaway, state.displacement[i]
            if np.any(np.abs(y - state.carts[: rho.size, i]) - rho > 1e-12 * rho + 1e-14 * abs(y)):
                raise ModelError(
                    f"state: a cart of actuator {i} lies farther from its displacement than its breakaway elongation"
                )

    def reset(self) -> None:
        """Return to the initial states and set the counts of clamped samples to 0."""
        elements, branches = self._core.rows if self._core else (0, 0)
        m = self._laned.size
        self._memory = BankMemory(
            np.zeros(m), np.zeros((elements, m)), np.zeros((branches, m)), np.zeros(m), np.zeros((3, m), dtype=np.int64)
        )
        for k, i in enumerate(self._laned):
            one, start = self._each[i], self._each[i].start()
            self._memory.w[k] = start.w
            self._memory.carts[: start.carts.size, k] = start.carts
            self._memory.strains[: start.strains.size, k] = start.strains
            self._memory.sent[k] = one.bounds.nearest(one.actuator.core.voltage(start))
        self._loops = {i: self._each[i].new_loop() for i in self.alone}
        self._warned.clear()
        self._reported = (0, 0)

    @property
    def clamps(self) -> BankClamps:
        """Clamped samples of each actuator since the construction or the last reset."""
        counts = np.zeros((2, len(self)), dtype=np.int64)
        counts[:, self._laned] = self._memory.counts[:2]
        for i, loop in self._loops.items():
            counts[:, i] = loop.counts()[:2]
        return BankClamps(*counts)

    def _lanes(self) -> BankCore:
        """Return the tables of the actuators that are computed in lanes."""
        each = [self._each[i] for i in self._laned]
        steps = [step_numbers(one.actuator, one.bounds, self.period) for one in each]
        decay, gain = (np.concatenate([np.ravel(one[0][part]) for one in steps]) for part in (1, 2))
        limits = np.array([numbers[:3] for _, numbers in steps]).T
        return BankCore([one.actuator.core for one in each], decay, gain, np.ascontiguousarray(limits))

    def _run(self, values: Array, out: Array, *, plays: bool, build: str = "") -> None:
        if self._whole and self._core:
            self._core.run(values, out, self._memory, plays, self.threads, build)
            return
        if self._core:
            part = np.empty((values.shape[0], self._laned.size))
            given = np.ascontiguousarray(values[:, self._laned])
            self._core.run(given, part, self._memory, plays, self.threads, build)
            out[:, self._laned] = part
        if self.threads > 1 and values.shape[0] > 1:
            with ThreadPoolExecutor(self.threads) as pool:
                list(pool.map(lambda one: one[1].run_column(values, out, one[0], plays), self._loops.items()))
        else:
            for i, loop in self._loops.items():
                loop.run_column(values, out, i, plays)

    @cached_property
    def _digest(self) -> str:
        """Return a key of the models and the period of this bank; limits and starts do not count."""
        ids = []
        for one in self._each:
            ids.append(one.model_ids()[0])
            # Its loop is of no more use.
            one.reset()
        return hashlib.sha256(np.array(ids, dtype="<u4").tobytes()).hexdigest()

    def _scattered(self) -> BankState:
        """Return a copy of the state that includes the columns of actuators that are computed alone."""
        rows = {i: loop.row() for i, loop in self._loops.items()}
        m, alone = len(self), {i: CoreState(*loop.state()) for i, loop in self._loops.items()}
        elements = max([self._memory.carts.shape[0], *(one.carts.size for one in alone.values())])
        branches = {i: 0 if (creep := self.actuators[i].creep) is None else len(creep) for i in alone}
        most = max([self._memory.strains.shape[0], *branches.values()])
        state = BankState(np.zeros(m), np.zeros((elements, m)), np.zeros((most, m)), np.zeros(m), rows, self._digest)
        state.displacement[self._laned], state.voltage[self._laned] = self._memory.w, self._memory.sent
        state.carts[: self._memory.carts.shape[0], self._laned] = self._memory.carts
        state.creep[: self._memory.strains.shape[0], self._laned] = self._memory.strains
        for i, one in alone.items():
            state.displacement[i], state.voltage[i] = one.w, self._loops[i].sent()
            state.carts[: one.carts.size, i] = one.carts
            state.creep[: branches[i], i] = one.strains[: branches[i]]
        return state

    def _refuse_strays(self, displacement: Array) -> None:
        low, high = self._plausible
        if not displacement.size or (displacement.min() >= low.max() and displacement.max() <= high.min()):
            return
        for i in np.flatnonzero((displacement.min(axis=0) < low) | (displacement.max(axis=0) > high)):
            sentence = stray_sentence(self.actuators[i], self._each[i].bounds, displacement[:, i])
            if sentence:
                raise ModelError(f"actuator {i}: {sentence}")

    @cached_property
    def _plausible(self) -> tuple[Array, Array]:
        """Lowest and highest accepted displacement (M,) [m]: each plausible range, extended by its width."""
        low, high = np.array([(one.plausible.low, one.plausible.high) for one in self.actuators]).T
        return low - (high - low), high + (high - low)

    def _report(self, wanted: Array) -> None:
        """Warn of the first clamped samples of each kind; the samples of `wanted` (n, M) [m] are not yet reported."""
        limited, slewed = (int(n) for n in self._memory.counts[:2].sum(axis=1))
        for loop in self._loops.values():
            counts = loop.counts()
            limited, slewed = limited + counts[0], slewed + counts[1]
        before, self._reported = self._reported, (limited, slewed)
        if self._reported == before:
            return
        kinds = ("at a limit", "by the slew rate")
        for kind, now, then, each in zip(kinds, self._reported, before, self.clamps, strict=True):
            if now == then or kind in self._warned:
                continue
            self._warned.add(kind)
            i = int(np.argmax(each))
            sentence = stray_sentence(self.actuators[i], self._each[i].bounds, wanted[:, i])
            more = f". {sentence}" if sentence else ""
            words = f"{now - then} of {wanted.size} voltages clamped {kind}, of actuator {i} the most{more}"
            warnings.warn(words, ClampWarning, 3)


def _reason_alone(actuator: Actuator) -> str:
    """Return the part for which an actuator must be computed alone, or nothing."""
    if actuator.lag:
        return "an amplifier that lags"
    if actuator.core.in_lanes:
        return ""
    if actuator.dynamics is not None:
        return "a mass"
    if actuator.displacement_creep is not None:
        return "creep in displacement"
    return "smooth elements" if actuator.smooth is not None else "graded elements"


def _listed(values: Any, what: str) -> list[Any]:
    if not isinstance(values, Iterable):
        raise ModelError(argument=what, got=type(values).__name__, need="a list with one for each actuator")
    return list(values)


def _table(values: ArrayLike, what: str, count: int) -> Array:
    """Return samples (n, count); raise `ModelError` if they have another shape, or one is not a finite number."""
    given = np.asarray(values)
    if given.dtype.kind not in "iuf":
        raise ModelError(argument=what, got=f"an array of {given.dtype}", need="numbers")
    table = np.ascontiguousarray(given, dtype=np.float64)
    if table.ndim != 2 or table.shape[1] != count:
        got = table.shape[1:] if table.ndim == 2 and what == "displacement" else table.shape
        raise ModelError(argument=what, got=f"the shape {got}", need=f"a column for each of {count} actuators")
    if not np.isfinite(table).all():
        t, i = np.argwhere(~np.isfinite(table))[0]
        raise ModelError(f"{what}: sample {t} of actuator {i} is {table[t, i]}, need finite numbers")
    return table
