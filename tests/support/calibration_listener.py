"""A listener of a calibration that keeps what it is given, and may interrupt it."""

import numpy as np


class Heard:
    """A watcher that remembers."""

    def __init__(self, stop_at=None, after=0):
        self.steps, self.samples_of, self.errors = [], {}, {}
        self._stop_at, self._after = stop_at, after

    def step(self, name, seconds=0.0):
        self.steps.append(name)

    def samples(self, samples, expected=None, stroke=None):
        name = self.steps[-1]
        self.samples_of[name] = self.samples_of.get(name, 0) + samples.time.size
        if expected is not None:
            self.errors.setdefault(name, []).append(np.abs(samples.displacement - expected) / stroke)
        if name == self._stop_at and self.samples_of[name] >= self._after:
            raise KeyboardInterrupt

    def message(self, text):
        pass

    def largest(self, name):
        """The largest error that a step had, as a share of the stroke."""
        return np.nanmax(np.concatenate(self.errors[name]))
