"""What rivals share that are curves of plays and nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst.baselines.base import AbstractBaseline
from dehyst.baselines.play_bank import PlayBank, PlayState
from dehyst.baselines.training import Training


@dataclass(frozen=True, eq=False)
class AbstractPlayModel(AbstractBaseline):
    """A bank of play operators behind the common interface.

    Attributes
    ----------
    bank : PlayBank
        Its operators.
    state : PlayState
        Where it starts: by default after a long descent to the lowest voltage of its records.
    delay : float
        Seconds by which the displacement lags the voltage; `simulate` and `compensate` leave it to the caller.
    remarks : tuple of str
        Sentences: what was repaired in the records.
    """

    bank: PlayBank
    state: PlayState
    delay: float = 0.0
    remarks: tuple[str, ...] = ()

    @property
    def parameters(self) -> int:
        """Numbers that the fit chose."""
        return self.bank.parameters

    def _displaced(self, v: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        return self.bank.simulate(v, state, time)

    def _driven(self, y: Array, state: PlayState, time: ArrayLike | None) -> tuple[Array, PlayState]:
        return self.bank.compensate(y, state, time)

    @classmethod
    def _of(cls, bank: PlayBank, ready: Training) -> Self:
        """The rival that these records told."""
        return cls(bank, bank.descended(ready.limits[0]), ready.delay, ready.sentences)
