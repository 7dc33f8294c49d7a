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
        """Refuse a `size` [bytes] of `what` that exceeds the remaining memory."""
        if size > self.left:
            raise FileFormatError(
                f"{what} has {size / 1e6:.4g} MB, more than the {self.left / 1e6:.4g} MB left of the "
                f"{self.most / 1e6:.4g} MB that are allowed",
                hint="save every second sample, or several records",
            )
