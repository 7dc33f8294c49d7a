"""A clock that a test sets."""

from types import SimpleNamespace


class Hand:
    """A clock that is set by hand."""

    def __init__(self):
        self.time = 0.0

    def __call__(self):
        return self.time

    def wait(self, seconds):
        self.time += seconds


def ramps_by(monkeypatch, clock):
    """Let rigs take the time from a `clock`: answers of a link then take none, however busy the machine is."""
    own = SimpleNamespace(monotonic=clock, sleep=lambda seconds: None)
    for module in ("base", "output", "waves"):
        monkeypatch.setattr(f"dehyst.instruments.{module}.time", own)
