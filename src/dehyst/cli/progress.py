"""The progress of a calibration: bars on a terminal with the package rich, else a line where a step begins or ends."""

from __future__ import annotations

import sys
import time
from typing import Any, Self

import numpy as np

from dehyst._text import escaped
from dehyst._types import Array
from dehyst.cli.terminal import note
from dehyst.instruments import Samples


class Progress:
    """A listener of a calibration, for a with-statement, which writes to standard error."""

    def __init__(self) -> None:
        self._bars, self._bar, self._name, self._first = _bars(), None, "", 0.0

    def __enter__(self) -> Self:
        if self._bars is not None:
            self._bars.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end("done in" if kind is None else "failed after")
        if self._bars is not None:
            self._bars.stop()

    def step(self, name: str, seconds: float = 0.0) -> None:
        """End the present step and begin another; it plays for `seconds` [s], 0 if it computes."""
        self._end("done in")
        self._name, self._began, self._count, self._largest = name, time.monotonic(), 0, 0.0
        if self._bars is None:
            note(f"{name}: begins" + (f", {seconds:.1f} s" if seconds else ""))
        else:
            self._bar = self._bars.add_task(escaped(name), total=seconds or None, text="")

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Show received samples; `expected` (n,) [m], NaN where none is, and the `stroke` [m] give their error."""
        self._first = self._first if self._count else float(samples.time[0])
        self._count += samples.time.size
        if expected is not None and stroke:
            error = 100 * np.abs(samples.displacement - expected) / stroke
            self._largest = max(self._largest, float(np.max(error, initial=0.0, where=np.isfinite(error))))
        self._show(text=self._told(), completed=float(samples.time[-1]) - self._first)

    def message(self, text: str) -> None:
        """Show the present activity of the step."""
        self._show(text=escaped(text))

    def _told(self) -> str:
        off = f", off the path by at most {self._largest:.3f} % of the stroke" if self._largest else ""
        return f"{self._count} samples{off}" if self._count else ""

    def _show(self, **fields: Any) -> None:
        if self._bars is not None:
            self._bars.update(self._bar, **fields)

    def _end(self, how: str) -> None:
        if self._name and self._bars is None:
            took = f"{time.monotonic() - self._began:.1f} s"
            note(f"{self._name}: {how} {', '.join(filter(None, [took, self._told()]))}")
        elif self._name:
            self._show(text=self._told(), **({"total": 1, "completed": 1} if how == "done in" else {}))
        self._name = ""


def _bars() -> Any:
    """Return the bars of rich; None without a terminal, or without rich."""
    try:
        from rich import console, progress
    except ImportError:
        return None
    name, text = (progress.TextColumn(f"{{task.{field}}}", markup=False) for field in ("description", "fields[text]"))
    bars = name, progress.BarColumn(), progress.TimeRemainingColumn(), text
    return progress.Progress(*bars, console=console.Console(file=sys.stderr)) if sys.stderr.isatty() else None
