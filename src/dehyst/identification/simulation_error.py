"""Simulation errors of a model on the last epochs of records, as opposed to equation errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.identification.preprocessing.preparation import Prepared
from dehyst.identification.preprocessing.regressors import Epoch
from dehyst.identification.validation import Protocol, compare, without_offset
from dehyst.model import Actuator, State
from dehyst.records import Record


@dataclass(frozen=True, eq=False)
class FinalEpoch:
    """The last epoch of one piece of a record.

    Attributes
    ----------
    record : Prepared
    number : int
        Number of the piece.
    epoch : Epoch
    state : State
        At its first sample, on the model's axis.
    offset : float
        Offset of its voltages [V].
    datum : float
        Datum of its displacements [m].
    """

    record: Prepared
    number: int
    epoch: Epoch
    state: State
    offset: float
    datum: float
    _cache: dict[tuple[float, float], Record] = field(default_factory=dict, init=False, repr=False)

    def piece(self, delay: float, lag: float = 0.0) -> Record:
        """Return its samples with acting voltages, their offset included."""
        if (delay, lag) not in self._cache:
            _, whole, _ = self.record.delayed(0, delay, lag)[self.number]
            self._cache.clear()
            self._cache[delay, lag] = whole.slice(self.epoch.start, self.epoch.stop)
        return self._cache[delay, lag]

    def error(self, actuator: Actuator) -> Array:
        """Return measured minus simulated displacement (n,) [m], mean zero."""
        piece, rho = self.piece(actuator.delay, actuator.lag), actuator.slip.breakaway
        actuator = replace(actuator, lag=0.0)
        y = self.state.displacement
        start = replace(self.state, carts=np.clip(self.state.carts, y - rho, y + rho))
        time = piece.time if actuator.needs_time else None
        voltage = without_offset(actuator, piece.voltage, self.offset)
        played = actuator.simulate(voltage, time=time, state=start, extrapolate=True)
        error = piece.displacement + self.datum - played.displacement
        return np.asarray(error - error.mean())


@dataclass(frozen=True, eq=False)
class SimulationError:
    """The last epochs of records, from whose start states models of the same structure are simulated.

    Attributes
    ----------
    epochs : tuple of FinalEpoch
    """

    epochs: tuple[FinalEpoch, ...]

    @classmethod
    def of(cls, actuator: Actuator, records: Sequence[Prepared], datum: Array, stroke: float) -> SimulationError:
        """Find states and offsets by comparison with an actuator; `datum` [m] of each record."""
        finals = []
        for record, shift in zip(records, datum, strict=True):
            comparison = compare(actuator, record, Protocol("training", actuator.delay, float(shift), False, stroke))
            for number, (of_piece, offset) in enumerate(zip(comparison.epochs, comparison.last_offsets(), strict=True)):
                if of_piece:
                    state = comparison.state_before(actuator, number, of_piece[-1]).shifted(comparison.datum)
                    finals.append(FinalEpoch(record, number, of_piece[-1], state, offset, comparison.datum))
        return cls(tuple(finals))

    def errors(self, actuator: Actuator) -> Array:
        """Return the error of every sample (n,) [m], mean zero in each epoch."""
        return np.concatenate([epoch.error(actuator) for epoch in self.epochs])

    def voltage(self, delay: float = 0.0) -> Array:
        """Return the voltage of every sample (n,) [V]."""
        return np.concatenate([epoch.piece(delay).voltage for epoch in self.epochs])

    def epoch_numbers(self) -> NDArray[np.intp]:
        """Return the number of the epoch of every sample (n,)."""
        sizes = [epoch.epoch.stop - epoch.epoch.start for epoch in self.epochs]
        return np.repeat(np.arange(len(sizes)), sizes)
