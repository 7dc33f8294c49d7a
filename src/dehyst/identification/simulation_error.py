"""Records played back through a model, and what the model then misses: errors of simulation, not of an equation."""

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
        Of the piece.
    epoch : Epoch
    state : State
        At its first sample, on the model's axis.
    offset : float
        Of its voltages [V].
    datum : float
        Of its displacements [m].
    """

    record: Prepared
    number: int
    epoch: Epoch
    state: State
    offset: float
    datum: float
    _known: dict[tuple[float, float], Record] = field(default_factory=dict, init=False, repr=False)

    def piece(self, delay: float, lag: float = 0.0) -> Record:
        """Its samples, the voltages those that act, their offset left in."""
        if (delay, lag) not in self._known:
            _, whole, _ = self.record.delayed(0, delay, lag)[self.number]
            self._known.clear()
            self._known[delay, lag] = whole.slice(self.epoch.start, self.epoch.stop)
        return self._known[delay, lag]

    def error(self, actuator: Actuator) -> Array:
        """Measured less simulated (n,) [m], but for a constant."""
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
    """The stretches of some records from whose states models like the one given are simulated.

    Attributes
    ----------
    stretches : tuple of FinalEpoch
    """

    stretches: tuple[FinalEpoch, ...]

    @classmethod
    def of(cls, actuator: Actuator, records: Sequence[Prepared], datum: Array, stroke: float) -> SimulationError:
        """States and offsets as they are found beside an actuator; `datum` [m] of each record."""
        found = []
        for record, shift in zip(records, datum, strict=True):
            beside = compare(actuator, record, Protocol("training", actuator.delay, float(shift), False, stroke))
            for number, (own, offset) in enumerate(zip(beside.epochs, beside.last_offsets(), strict=True)):
                if own:
                    state = beside.state_before(actuator, number, own[-1]).shifted(beside.datum)
                    found.append(FinalEpoch(record, number, own[-1], state, offset, beside.datum))
        return cls(tuple(found))

    def errors(self, actuator: Actuator) -> Array:
        """Of every sample (n,) [m], each stretch but for a constant."""
        return np.concatenate([one.error(actuator) for one in self.stretches])

    def voltage(self, delay: float = 0.0) -> Array:
        """Of every sample (n,) [V]."""
        return np.concatenate([one.piece(delay).voltage for one in self.stretches])

    def stretch(self) -> NDArray[np.intp]:
        """Number of the stretch of every sample (n,)."""
        sizes = [one.epoch.stop - one.epoch.start for one in self.stretches]
        return np.repeat(np.arange(len(sizes)), sizes)
