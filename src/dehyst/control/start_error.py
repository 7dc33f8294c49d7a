"""What an unknown start leaves open of a motion: how far apart the displacements from the possible states are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dehyst._types import Array
from dehyst._validation import vector
from dehyst.model import Actuator, State

# Shares of the stroke: the error of a good model, for a model whose file does not hold its own, and the least one.
_MODEL_ERROR, _LEAST = 1e-3, 1e-6


@dataclass(frozen=True, eq=False)
class StartError:
    """The displacements that a voltage causes from all possible states.

    Attributes
    ----------
    lowest, highest : (n,) array
        Bounds of the displacement [m]; with dynamics those of its slow part, about which a mass may ring.
    stroke : float
        Between the voltage limits [m], to which percentages refer.
    model_error : float
        Largest error of the model on its training records [m]; a thousandth of the stroke if the model does not hold
        it.
    time : (n,) array or None
        [s].
    """

    lowest: Array
    highest: Array
    stroke: float
    model_error: float
    time: Array | None = None

    @classmethod
    def along(
        cls,
        actuator: Actuator,
        states: Sequence[State],
        voltage: ArrayLike,
        *,
        time: ArrayLike | None = None,
        first: int = 0,
    ) -> StartError:
        """Play a voltage from each of the possible states.

        Parameters
        ----------
        actuator : Actuator
        states : sequence of State
            That bound the start: `PossibleStart.states`.
        voltage : (n,) array_like
            [V].
        time : (n,) array_like, optional
            [s]; needed by an actuator with creep, dynamics or a lag.
        first : int, optional
            Leave out the samples before this one, such as those of a homing.

        Raises
        ------
        ModelError
            If the voltage is not finite, or the time or a state does not fit.
        """
        v = vector(voltage, "voltage")
        when = time if actuator.needs_time else None
        lowest, highest = np.full(v.size - first, np.inf), np.full(v.size - first, -np.inf)
        for state in states:
            y = actuator.simulate(v, time=when, state=state, extrapolate=True).displacement[first:]
            np.minimum(lowest, y, out=lowest)
            np.maximum(highest, y, out=highest)
        stroke = float(np.ptp(actuator.reach))
        kept = None if time is None else vector(time, "time")[first:]
        return cls(lowest, highest, stroke, model_error(actuator), kept)

    @property
    def difference(self) -> Array:
        """Between the highest and the lowest displacement (n,) [m]."""
        return self.highest - self.lowest

    @property
    def first(self) -> float:
        """Difference at the first sample [m]."""
        return float(self.difference[0]) if self.difference.size else 0.0

    @property
    def largest(self) -> float:
        """Largest difference [m]."""
        return float(self.difference.max(initial=0.0))

    @property
    def matters(self) -> bool:
        """Whether the start matters more than the error of the model, somewhere along the voltage."""
        return self.largest > self.model_error

    @property
    def settled(self) -> int | None:
        """First sample from which the difference stays below the model's error; None if it is above at the end."""
        above = np.flatnonzero(self.difference > self.model_error)
        after = int(above[-1]) + 1 if above.size else 0
        return after if after < self.difference.size or not above.size else None

    @property
    def settled_seconds(self) -> float | None:
        """Seconds from the first sample to `settled`; None without it, or without a time."""
        settled = self.settled
        if settled is None or self.time is None or not self.time.size:
            return None
        return float(self.time[settled] - self.time[0])

    def percent(self, length: float) -> float:
        """Return a `length` [m] in % of the stroke."""
        return 100 * length / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {
            "first_difference_percent": self.percent(self.first),
            "largest_difference_percent": self.percent(self.largest),
            "model_error_percent": self.percent(self.model_error),
            "settled_sample": self.settled,
            "settled_s": self.settled_seconds,
        }


def model_error(actuator: Actuator) -> float:
    """Return the largest error [m] of the model on its training records, by its provenance."""
    error, stroke = actuator.provenance.get("largest_error_m"), float(np.ptp(actuator.reach))
    if not isinstance(error, int | float) or isinstance(error, bool) or not 0 <= error < np.inf:
        return _MODEL_ERROR * stroke
    return max(float(error), _LEAST * stroke)
