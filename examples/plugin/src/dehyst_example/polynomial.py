"""A polynomial from voltage to displacement: what many controllers offer as linearisation. It has no hysteresis."""

from dataclasses import dataclass

import numpy as np

from dehyst import ModelError, State
from dehyst.baselines import AbstractBaseline, fit_with_delay


@dataclass(frozen=True, eq=False)
class Polynomial(AbstractBaseline):
    """A polynomial at 65 knots (v [V], y [m]), with straight lines between them and beyond: its inverse is exact."""

    v: np.ndarray
    y: np.ndarray
    delay: float
    parameters: int
    state = State(0.0, [])

    def _run(self, drive, state, time, *, inverse):
        x, f = (self.y, self.v) if inverse else (self.v, self.y)
        j = np.clip(np.searchsorted(x, drive, side="right") - 1, 0, x.size - 2)
        return f[j] + (f[j + 1] - f[j]) * ((drive - x[j]) / (x[j + 1] - x[j])), state

    @classmethod
    def fit(cls, records, *, delay=None, degree=3):
        """Fit by least squares, with a constant for each record."""

        def fit_model(training):
            low, high = training.limits
            powers, knots = np.arange(1, degree + 1), np.linspace(0, 1, 65)
            columns = ((training.sampled(lambda piece: piece.voltage) - low) / (high - low))[:, None] ** powers
            matrix = np.hstack([columns, training.nuisances])
            weights = np.linalg.lstsq(matrix, training.displacement, rcond=None)[0][:degree]
            constant, residual = training.fit_constant(training.displacement - columns @ weights)
            y = constant + (knots[:, None] ** powers) @ weights
            if not (np.diff(y) > 0).all():
                raise ModelError("the polynomial does not rise over the whole range; need wider records")
            return cls(low + (high - low) * knots, y, training.delay, degree + 1), residual

        return fit_with_delay(records, delay, fit_model)
