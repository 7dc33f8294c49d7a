"""The end of an identification's searches: a time limit, or a request from outside such as Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf
from typing import TypeVar

from dehyst import _validation
from dehyst._types import Progress

_T = TypeVar("_T")
_U = TypeVar("_U")


class _StepLeftError(Exception):
    """The running step is left, since the deadline has passed."""


class Deadline:
    """When the searches of one identification end: after some seconds, or when `end` is called.

    Give it to `dehyst.identify` as `time_limit`. Once it has passed no step of a search begins, and the best model so
    far is completed.

    Parameters
    ----------
    seconds : float, optional
        Wall-clock time from now [s]; default: no limit.

    Attributes
    ----------
    seconds : float
        The limit [s]; infinite if there is none.
    ended : bool
        Whether `end` was called.
    cut : list of str
        What was not begun or not finished, in words.

    Raises
    ------
    IdentifyError
        If the seconds are not a positive, finite number.
    """

    def __init__(self, seconds: float | None = None) -> None:
        self.seconds = inf if seconds is None else _validation.duration(seconds, "time_limit")
        self.ended = False
        self.cut: list[str] = []
        self._cause = "" if seconds is None else f"The time limit of {self.seconds:g} s"
        self._begin = time.monotonic()
        self._inside = False

    @property
    def so_far(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._begin

    @property
    def left(self) -> float:
        """Seconds left, 0 at least; infinite without a limit."""
        return 0.0 if self.ended else max(self.seconds - self.so_far, 0.0)

    @property
    def passed(self) -> bool:
        """Whether no further step may begin."""
        return self.left <= 0

    @property
    def clock(self) -> str:
        """Seconds so far and, with a limit, left, in words."""
        return f"{self.so_far:.0f} s so far" + (f", {self.left:.0f} s left" if self.left < inf else "")

    def end(self, cause: str = "A request", *, leave_step: bool = False) -> None:
        """End the searches.

        Parameters
        ----------
        cause : str, optional
            Subject of the sentence that reports it: "Ctrl-C".
        leave_step : bool, optional
            Leave the running step too. Only for a signal handler of the thread that identifies.
        """
        self.ended, self._cause = True, cause
        if leave_step:
            self.check()

    def check(self) -> None:
        """Leave the step that `attempt` runs, if the deadline has passed; do nothing outside of one."""
        if self._inside and self.passed:
            raise _StepLeftError

    def watched(self, report: Progress) -> Progress:
        """Return the same report of a step's progress, at which a step is left once the deadline has passed.

        Parameters
        ----------
        report : callable
            Called with a few words.
        """

        def watched(words: str) -> None:
            self.check()
            report(words)

        return watched

    def attempt(self, step: Callable[[], _T], otherwise: _U, name: str) -> _T | _U:
        """Return what a step makes; if the deadline passes before, `otherwise`, and note the name of what was cut.

        Parameters
        ----------
        step : callable
            Left where it calls `check`, or by a signal. A step inside another one is left together with it.
        otherwise : object
            What the step should improve.
        name : str
            For `cut`.
        """
        if self._inside:
            self.check()
            return step()
        if not self.passed:
            try:
                self._inside = True
                return step()
            except _StepLeftError:
                pass
            finally:
                self._inside = False
        self.cut.append(name)
        return otherwise

    def remarks(self, best: str) -> list[str]:
        """Return the sentence about what was cut; none if all was done.

        Parameters
        ----------
        best : str
            The model that remained, in words.
        """
        if not self.cut:
            return [f"{self._cause} came when all searches had ended: the model is complete."] if self.ended else []
        cut = self.cut[0] if len(self.cut) == 1 else f"{', '.join(self.cut[:-1])} and {self.cut[-1]}"
        return [f"{self._cause} ended {cut}: the model is the best so far, {best}."]
