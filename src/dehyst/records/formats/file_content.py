"""The limits of the size of a file and of the memory for its numbers."""

from __future__ import annotations

from dehyst._errors import FileFormatError

# Limit of the bytes of a file and of its numbers: 20 million samples.
MOST = 500_000_000
# Bytes of a double.
_DOUBLE = 8


class Allowance:
    """The memory [bytes] for the numbers of a file, of which declared sizes are taken; its stem and decimal sign."""

    def __init__(self, most: int, stem: str = "", decimal: str | None = None) -> None:
        self.most, self.left, self.stem, self.decimal = most, most, stem, decimal

    def take(self, numbers: int, what: str) -> None:
        """Reserve memory for a count of `numbers`; raise FileFormatError, with `what` has them, if it is too little."""
        self.check(numbers * _DOUBLE, what)
        self.left -= numbers * _DOUBLE

    def check(self, size: int, what: str) -> None:
        """Refuse a `size` [bytes] of `what` that is negative or exceeds the remaining memory."""
        if size < 0:
            raise FileFormatError(f"{what} declares a negative size; the file is damaged, take a copy")
        if size > self.left:
            raise FileFormatError(
                f"{what} has {_in_words(size)}, more than the {_in_words(self.left)} left of the "
                f"{_in_words(self.most)} that are allowed",
                hint="save every second sample, or several records",
            )


def _in_words(size: int) -> str:
    return f"{size / 1e6:.4g} MB" if size >= 1_000_000 else f"{size} bytes"
