"""Options of an identification, and the deadline of its searches."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any, TypeVar

import numpy as np

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._types import Array, Progress
from dehyst.identification.solvers.program import NORMS, Norm

_T = TypeVar("_T")
_U = TypeVar("_U")


class _StepLeftError(Exception):
    """The running step is left, since the deadline has passed."""


class Deadline:
    """Deadline of the searches of one identification: a time limit, or a call of `end`.

    Pass it to `dehyst.identify` as `time_limit`. Once it has passed, no further step of a search begins, and the best
    model so far is completed.

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
        Names of steps that were not begun or not finished.

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
        """If the deadline has passed, leave the step that `attempt` runs; without such a step, do nothing."""
        if self._inside and self.passed:
            raise _StepLeftError

    def watched(self, report: Progress) -> Progress:
        """Wrap a progress report so that it also leaves the step once the deadline has passed.

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
        """Return the result of a step; if the deadline passes before its end, note its `name` and return `otherwise`.

        Parameters
        ----------
        step : callable
            A function that may be left where it calls `check`, or by a signal. A nested step is left together with its
            outer step.
        otherwise : object
            Result if the step is left.
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
        """Return a sentence about the steps that were cut; empty if all were done.

        Parameters
        ----------
        best : str
            The model that remained, in words.
        """
        if not self.cut:
            return [f"{self._cause} came when all searches had ended: the model is complete."] if self.ended else []
        cut = self.cut[0] if len(self.cut) == 1 else f"{', '.join(self.cut[:-1])} and {self.cut[-1]}"
        return [f"{self._cause} ended {cut}: the model is the best so far, {best}."]


# Default number of elements: twice the paper's, because every sample is in the fit.
_ELEMENTS = 20


@dataclass(frozen=True, eq=False)
class Settings:
    """Options of `dehyst.identify`; see there.

    Raise `IdentifyError` if an option is impossible, or two exclude each other.
    """

    elements: int | None = None
    breakaway: Array | None = None
    norm: Norm = "l1"
    knots: int | None = None
    slope_floor: float = 0.2
    delay: float | None = None
    sensor_lag: float | None = None
    shared_datum: bool = False
    drift: bool = True

    def __post_init__(self) -> None:
        _validation.choice(self.norm, "norm", NORMS)
        if self.elements is not None:
            _validation.count(self.elements, "elements")
        if self.knots is not None:
            _validation.count(self.knots, "knots", least=2)
        _validation.fraction(self.slope_floor, "slope_floor")
        if self.delay is not None:
            _validation.seconds(self.delay, "delay")
        if self.sensor_lag is not None:
            _validation.seconds(self.sensor_lag, "sensor_lag")
        if self.breakaway is None:
            return
        rho = _validation.vector(self.breakaway, "breakaway", error=IdentifyError)
        if self.elements is not None:
            raise IdentifyError("got both elements and breakaway, need only one of them")
        if not 1 <= rho.size <= 500 or rho[0] <= 0 or np.any(np.diff(rho) <= 0):
            raise IdentifyError("breakaway: need 1 to 500 positive, strictly increasing elongations in metres")
        object.__setattr__(self, "breakaway", rho)

    @property
    def of_maxwell_slip(self) -> list[str]:
        """Names of given options that only Maxwell-slip elements have."""
        return [name for name in ("elements", "knots", "breakaway") if getattr(self, name) is not None]

    @property
    def count(self) -> int:
        """Number of elements N."""
        if self.breakaway is not None:
            return self.breakaway.size
        return self.elements or _ELEMENTS

    def as_dict(self) -> dict[str, Any]:
        """Return the options that affect the result as JSON values."""
        return {
            "norm": self.norm,
            "elements": self.count,
            "slope_floor": self.slope_floor,
            "shared_datum": self.shared_datum,
            "drift": self.drift,
            **({} if self.sensor_lag is None else {"sensor_lag": self.sensor_lag}),
        }
