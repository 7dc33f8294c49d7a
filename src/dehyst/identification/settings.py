"""Options of an identification, and the deadline of its searches."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from math import inf
from typing import Any, Literal, TypeVar

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._types import Progress
from dehyst.identification.structure import Structure

_POSITIVE = _validation.Numbers(positive=True, error=IdentifyError)
_T = TypeVar("_T")
_U = TypeVar("_U")


class _StepLeftError(Exception):
    """The running step ends early, as the deadline has passed."""


class Deadline:
    """Deadline of the searches of one identification: a time limit, or a call of `end`.

    Pass it to `dehyst.identify` as `time_limit`. After the deadline, no further step of a search begins, and the best
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
        Names of steps that did not begin or did not finish.

    Raises
    ------
    IdentifyError
        If the seconds are not a positive, finite number.
    """

    def __init__(self, seconds: float | None = None) -> None:
        self.seconds = inf if seconds is None else _POSITIVE(seconds, "time_limit")
        self.ended = False
        self.cut: list[str] = []
        self._cause = "" if seconds is None else f"The time limit of {self.seconds:g} s"
        self._begin = time.monotonic()
        self._inside = False

    @property
    def left(self) -> float:
        """Remaining time [s], at least 0; infinite without a limit."""
        return 0.0 if self.ended else max(self.seconds - (time.monotonic() - self._begin), 0.0)

    @property
    def passed(self) -> bool:
        """Whether no further step may begin."""
        return self.left <= 0

    def end(self, cause: str = "A request", *, leave_step: bool = False) -> None:
        """End the searches; `cause` is the subject of the sentence that reports it: "Ctrl-C".

        `leave_step` also ends the running step; only a signal handler of the identifying thread may use it.
        """
        self.ended, self._cause = True, cause
        if leave_step:
            self.check()

    def check(self) -> None:
        """If the deadline has passed, end the step that `attempt` runs; without such a step, do nothing."""
        if self._inside and self.passed:
            raise _StepLeftError

    def watched(self, report: Progress) -> Progress:
        """Wrap a progress `report`, so that it also ends the step when the deadline has passed."""

        def watched(words: str) -> None:
            self.check()
            report(words)

        return watched

    def attempt(self, step: Callable[[], _T], otherwise: _U, name: str) -> _T | _U:
        """Return the result of a step; if the deadline passes before, add `name` to `cut` and return `otherwise`.

        A call of `check` in the step, or a signal, can end the step.
        """
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
        """Return a sentence about the cut steps, empty if there are none; `best`: words for the best model so far."""
        if not self.cut:
            return [f"{self._cause} came when all searches had ended: the model is complete."] if self.ended else []
        cut = self.cut[0] if len(self.cut) == 1 else f"{', '.join(self.cut[:-1])} and {self.cut[-1]}"
        return [f"{self._cause} ended {cut}: the model is the best so far, {best}."]


@dataclass(frozen=True, eq=False)
class Settings:
    """Options of `dehyst.identify`, see there; raise `IdentifyError` if one is impossible."""

    delay: float | None = None
    sensor_lag: float | None = None
    lag_of: Literal["actuator", "sensor"] | None = None
    shared_zero: bool = False
    drift: bool = True
    structure: Structure | Literal["auto", "maxwell_slip"] = "auto"
    goal: float = 1.0

    def __post_init__(self) -> None:
        for name in ("delay", "sensor_lag"):
            _validation.Numbers(least=0.0, optional=True, error=IdentifyError)(getattr(self, name), name)
        if self.lag_of is not None:
            _validation.choice(self.lag_of, "lag_of", ("actuator", "sensor"))
        if self.structure not in ("auto", "maxwell_slip") and not isinstance(self.structure, Structure):
            need = "'auto', 'maxwell_slip' or a dehyst.Structure"
            raise IdentifyError(argument="structure", got=repr(self.structure), need=need)
        _validation.Numbers(least=1e-3, most=100.0, error=IdentifyError)(self.goal, "goal")

    @property
    def lags(self) -> str | None:
        """Cause of the lag of the records: as stated; or the actuator, if the lag of the sensor is known."""
        return self.lag_of if self.lag_of is not None or self.sensor_lag is None else "actuator"

    def as_dict(self) -> dict[str, Any]:
        """Return the options that affect the result as JSON values."""
        return {
            "shared_zero": self.shared_zero,
            "drift": self.drift,
            **({} if self.sensor_lag is None else {"sensor_lag": self.sensor_lag}),
            **({} if self.lags is None else {"lag_of": self.lags}),
        }
