"""The memory of a bank, and its counts of clamped samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.model import Actuator


class BankClamps(NamedTuple):
    """Clamped samples of each actuator.

    `limited` (M,): number of samples cut at a limit. `slewed` (M,): number held back by the slew rate.
    """

    limited: NDArray[np.int64]
    slewed: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class BankState:
    """The memory of the M actuators of a bank, an actuator a column.

    Attributes
    ----------
    displacement : (M,) array
        [m].
    carts : (N, M) array
        Position of each cart [m]; an actuator with fewer than N elements has no use for the last ones.
    creep : (J, M) array
        Strain of each creep branch [m].
    voltage : (M,) array
        The last voltage [V].
    alone : mapping of int to array
        Of each actuator that the bank computes by itself, all numbers that decide what comes next.
    actuators : str
        A digest of the actuators, which tells a state of others; empty: not checked.
    """

    displacement: Array
    carts: Array
    creep: Array
    voltage: Array
    alone: Mapping[int, Array] = field(default_factory=dict)
    actuators: str = ""

    def copy(self) -> BankState:
        """Return a copy that no longer changes with the bank."""
        return BankState(
            self.displacement.copy(),
            self.carts.copy(),
            self.creep.copy(),
            self.voltage.copy(),
            {i: row.copy() for i, row in self.alone.items()},
            self.actuators,
        )

    def demand_like(self, other: BankState) -> None:
        """Raise `ModelError` unless the arrays have the shapes of those of the `other`, and finite numbers."""
        for name in ("displacement", "carts", "creep", "voltage"):
            mine, theirs = getattr(self, name), getattr(other, name)
            if np.shape(mine) != theirs.shape:
                raise ModelError(f"state: {name} has the shape {np.shape(mine)}, this bank needs {theirs.shape}")
            if not np.isfinite(mine).all():
                raise ModelError(f"state: {name} holds a value that is not finite")
        if set(self.alone) != set(other.alone) or self.actuators not in ("", other.actuators):
            raise ModelError("state: it is of a bank of other actuators; take the state of a bank made in the same way")

    def demand_carts(self, actuators: Sequence[Actuator], columns: NDArray[np.intp]) -> None:
        """Raise `ModelError` if a cart of `actuators` in `columns` is farther from its displacement than possible."""
        for i in columns:
            actuator = actuators[i]
            far = np.abs(self.displacement[i] - self.carts[: len(actuator.slip), i]) - actuator.slip.breakaway
            if np.any(far > 1e-12 * actuator.slip.breakaway + 1e-14 * abs(self.displacement[i])):
                raise ModelError(
                    f"state: a cart of actuator {i} lies farther from its displacement than its breakaway elongation"
                )
