"""A clock that a test sets."""


class Hand:
    """A clock that only the test sets."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        return self.time

    def wait(self, seconds):
        self.time += seconds
