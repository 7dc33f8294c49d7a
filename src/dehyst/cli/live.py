"""The progress of a calibration: on a terminal a picture that moves, elsewhere a line when a step begins or ends."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Protocol, Self, TextIO

import numpy as np
from numpy.typing import ArrayLike

from dehyst._text import escaped
from dehyst.records.recording import SampleBlock

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

Status = Literal["waits", "runs", "done", "failed"]

# Marks, their ASCII form and their styles.
_MARKS: dict[Status, tuple[str, str, str]] = {
    "waits": ("·", ".", "dim"),
    "runs": ("▶", ">", "bold"),
    "done": ("✓", "x", "green"),
    "failed": ("✗", "!", "bold red"),
}


@dataclass
class ShownStep:
    """One step: its status, how long it plays [s], when it began and how long it took [s of the host]."""

    name: str
    seconds: float = 0.0
    status: Status = "waits"
    began: float = 0.0
    took: float = 0.0
    samples: int = 0
    first: float | None = None
    played: float = 0.0
    error: float | None = None
    largest: float | None = None

    @property
    def share(self) -> float | None:
        """Played share of the step, 0 to 1, by the device's clock; None if it is not known."""
        if not self.seconds or not self.samples:
            return None
        return min(1.0, self.played / self.seconds)

    def left(self, now: float) -> float | None:
        """Return the seconds of the host until the end of the step; a device's clock may run faster."""
        if not self.seconds:
            return None
        return self.seconds if not self.share else (now - self.began) * (1 - self.share) / self.share


class Display(Protocol):
    """A form of the display."""

    def begin(self, live: Live, step: ShownStep) -> None:
        """Show that a step begins."""

    def end(self, live: Live, step: ShownStep) -> None:
        """Show that a step ended."""

    def close(self) -> None:
        """End the display."""


class Live:
    """The state of a running calibration; made by `display`.

    Its `steps`, the `count` of received samples, the last `voltage` [V] and `displacement` [m], and the `message` of
    the present step.
    """

    def __init__(self, names: Sequence[str], form: Callable[[Live], Display], clock: Callable[[], float]) -> None:
        self.steps = [ShownStep(name) for name in names]
        self.count, self.text = 0, ""
        self.voltage: float | None = None
        self.displacement: float | None = None
        self._low, self._high = np.inf, -np.inf
        self._present: ShownStep | None = None
        self.clock = clock
        self._display = form(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        self._end("done" if error is None else "failed")
        self._display.close()

    @property
    def present(self) -> ShownStep | None:
        """The running step."""
        return self._present

    def step(self, name: str, seconds: float = 0.0) -> None:
        """End the present step and begin another; it plays for `seconds` [s], 0 if it computes."""
        self._end("done")
        waiting = next((step for step in self.steps if step.status == "waits" and step.name == name), None)
        if waiting is None:
            waiting = ShownStep(name)
            self.steps.insert(sum(step.status != "waits" for step in self.steps), waiting)
        waiting.seconds, waiting.status, waiting.began = float(seconds), "runs", self.clock()
        self._present, self.text = waiting, ""
        self._display.begin(self, waiting)

    def samples(self, samples: SampleBlock, expected: ArrayLike | None = None, stroke: float | None = None) -> None:
        """Show received samples.

        `expected` (n,): wanted displacement of each sample [m]; NaN where there is none. `stroke`: stroke to which
        errors refer [m]; default: the range of the displacement until now.
        """
        t, v, y = (
            np.asarray(column, dtype=np.float64) for column in (samples.time, samples.voltage, samples.displacement)
        )
        if not t.size:
            return
        self.count += t.size
        self.voltage, self.displacement = float(v[-1]), float(y[-1])
        self._low, self._high = min(self._low, float(y.min())), max(self._high, float(y.max()))
        step = self._present
        if step is None:
            return
        step.samples += t.size
        step.first = float(t[0]) if step.first is None else step.first
        step.played = float(t[-1]) - step.first
        of = self._high - self._low if stroke is None else stroke
        if expected is None or not of > 0:
            return
        errors = 100 * np.abs(y - np.asarray(expected, dtype=np.float64)) / of
        errors = errors[np.isfinite(errors)]
        if errors.size:
            step.error, step.largest = float(errors[-1]), max(step.largest or 0.0, float(errors.max()))

    def message(self, text: str) -> None:
        """Show the present activity of the step."""
        self.text = text

    def _end(self, status: Status) -> None:
        if (step := self._present) is not None:
            step.status, step.took, self._present = status, self.clock() - step.began, None
            self._display.end(self, step)


def display(
    steps: Sequence[str] = (),
    *,
    console: Console | None = None,
    stream: TextIO | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> Live:
    """Show the progress of a calibration on standard error.

    ::

        with display(["look", "loops"]) as live:
            live.step("look", 24.0)
            rig.play(excitation, live.samples)

    `steps`: names of the planned steps. `console`: console for the picture. `stream`: stream for lines; default:
    standard error. The picture is drawn only if it is a terminal. `clock`: seconds of the host.

    Returns
    -------
    Live
        For a with-statement. Without a terminal, or without the package rich, it writes one line when a step begins
        and one when it ends.
    """
    stream = sys.stderr if stream is None else stream
    if console is None and stream.isatty():
        console = _console(stream)
    if console is None or not console.is_terminal:
        return Live(steps, lambda _: _Lines(stream), clock)
    drawn_on = console
    return Live(steps, lambda live: _Picture(live, drawn_on), clock)


def _console(stream: TextIO) -> Console | None:
    try:
        from rich.console import Console
    except ImportError:
        return None
    return Console(file=stream)


class _Lines:
    """One line when a step begins, one when it ends."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def begin(self, live: Live, step: ShownStep) -> None:
        self._write(f"{step.name}: begins" + (f", {_duration(step.seconds)}" if step.seconds else ""))

    def end(self, live: Live, step: ShownStep) -> None:
        self._write(f"{step.name}: {step.status} {'in' if step.status == 'done' else 'after'} {summary(step)}")

    def close(self) -> None:
        pass

    def _write(self, line: str) -> None:
        # The reader may be gone.
        with suppress(OSError):
            print(f"dehyst: {escaped(line)}", file=self._stream, flush=True)


class _Picture:
    """All steps, a bar and the present numbers, redrawn eight times a second."""

    def __init__(self, live: Live, console: Console) -> None:
        from rich.live import Live as Screen

        plain = not console.encoding.lower().startswith("utf")
        self._screen = Screen(get_renderable=lambda: picture(live, plain=plain), console=console, refresh_per_second=8)
        self._screen.start()

    def begin(self, live: Live, step: ShownStep) -> None:
        self._screen.refresh()

    def end(self, live: Live, step: ShownStep) -> None:
        self._screen.refresh()

    def close(self) -> None:
        self._screen.stop()


def picture(live: Live, *, plain: bool = False) -> RenderableType:
    """Return the picture for rich; `plain` in ASCII."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    rows = Table.grid(padding=(0, 1))
    rows.add_column(width=1)
    rows.add_column(no_wrap=True)
    rows.add_column(no_wrap=True, overflow="ellipsis")
    for step in live.steps:
        mark, letter, style = _MARKS[step.status]
        text = summary(step) if step.status in ("done", "failed") else _progress(live, step)
        rows.add_row(
            Text(letter if plain else mark, style),
            Text(escaped(step.name), "" if step.status == "done" else style),
            Text(escaped(text)),
        )
    lines = [Text(f"  {line}", no_wrap=True, overflow="ellipsis") for line in _numbers(live)]
    return Group(rows, *_bars(live), *lines)


def _bars(live: Live) -> Iterator[RenderableType]:
    """Yield a bar for the step that plays, if there is one."""
    from rich.padding import Padding
    from rich.progress_bar import ProgressBar

    step = live.present
    if step is not None and step.seconds:
        bar = ProgressBar(total=1.0, completed=step.share or 0.0, width=60, pulse=step.share is None)
        yield Padding(bar, (0, 0, 0, 2))


def _progress(live: Live, step: ShownStep) -> str:
    if step.status != "runs":
        return ""
    now = live.clock()
    left = step.left(now)
    if left is None:
        return f"{live.text or 'computing'}, {_duration(now - step.began)}"
    return f"{100 * (step.share or 0.0):.0f} %, {_duration(left)} left" + (f", {live.text}" if live.text else "")


def _numbers(live: Live) -> Iterator[str]:
    """Yield a line of samples, voltage and displacement, and a line of the error."""
    if live.voltage is None or live.displacement is None:
        return
    yield f"{_grouped(live.count)} samples on disk   {live.voltage:8.3f} V   {1e6 * live.displacement:9.4f} um"
    step = live.present
    if step is not None and step.error is not None and step.largest is not None:
        yield f"off the path by {step.error:.3f} % of the stroke now, at most {step.largest:.3f} %"


def summary(step: ShownStep) -> str:
    """Return duration and error of an ended step as text."""
    parts = [_duration(step.took)]
    if step.samples:
        parts.append(f"{_grouped(step.samples)} samples")
    if step.largest is not None:
        parts.append(f"off the path by at most {step.largest:.3f} % of the stroke")
    return ", ".join(parts)


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", " ")


def _duration(seconds: float) -> str:
    if seconds < 59.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"
