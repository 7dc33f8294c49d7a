"""dehyst's straight line, fitted like the models here: with a delay, and a constant and a drift of each record."""

from __future__ import annotations

from collections.abc import Sequence

from dehyst import Record
from dehyst.trust.baselines import Linear
from dehyst_rivals.training import Training, fit_with_delay


def linear_ratio(records: Record | Sequence[Record], *, delay: float | None = None) -> Linear:
    """Take the slope from the end points of the widest loop, and fit the offset by least squares.

    `delay` [s]: lag of the displacement; default: estimated. It raises the errors of every fit here.
    """

    def fit_model(training: Training) -> tuple[Linear, float]:
        rest = training.displacement - training.slope * training.sampled(lambda piece: piece.voltage)
        constant, residual = training.fit_constant(rest)
        return Linear(training.slope, constant, training.delay), residual

    return fit_with_delay(records, delay, fit_model)
