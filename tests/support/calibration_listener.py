"""A listener of a calibration that keeps the progress it receives, and may interrupt the calibration."""


class Heard:
    """A listener that keeps what it receives."""

    def __init__(self, stop_at=None, after=0):
        self.steps, self.samples_of = [], {}
        self._stop_at, self._after = stop_at, after

    def step(self, name, seconds=0.0):
        self.steps.append(name)

    def samples(self, samples):
        name = self.steps[-1]
        self.samples_of[name] = self.samples_of.get(name, 0) + samples.time.size
        if name == self._stop_at and self.samples_of[name] >= self._after:
            raise KeyboardInterrupt

    def message(self, text):
        pass
