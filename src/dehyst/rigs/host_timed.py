"""The former place of `dehyst.instruments.host_timed`."""

from dehyst.instruments import HIGHEST_RATE, host_timed

__all__ = ["HIGHEST_RATE", "host_timed"]
