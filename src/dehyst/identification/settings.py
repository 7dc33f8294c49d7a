"""Checked options of an identification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from dehyst import _validation
from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst.identification.solvers.program import NORMS, Norm

Method = Literal["record", "breakpoints", "antisymmetric"]
Direction = Literal["descending", "ascending"]
METHODS: tuple[Method, ...] = ("record", "breakpoints", "antisymmetric")
# Default numbers of elements: the paper's for its methods; with every sample in the fit twice as many.
_ELEMENTS = {"record": 20, "breakpoints": 10, "antisymmetric": 10}


@dataclass(frozen=True, eq=False)
class Settings:
    """Options of `dehyst.identify`; see there.

    Raises
    ------
    IdentifyError
        If an option is impossible, or two exclude each other.
    """

    method: Method = "record"
    elements: int | None = None
    breakaway: Array | None = None
    norm: Norm = "l1"
    knots: int | None = None
    slope_floor: float = 0.2
    delay: float | None = None
    sensor_lag: float | None = None
    shared_datum: bool = False
    drift: bool = True
    branch: Direction = "descending"

    def __post_init__(self) -> None:
        _validation.choice(self.method, "method", METHODS)
        _validation.choice(self.norm, "norm", NORMS)
        _validation.demand(
            self.branch in ("descending", "ascending"), "branch", self.branch, "'descending' or 'ascending'"
        )
        if self.elements is not None:
            _validation.count(self.elements, "elements")
        if self.knots is not None:
            _validation.count(self.knots, "knots", least=2)
        _validation.fraction(self.slope_floor, "slope_floor")
        if self.delay is not None:
            _validation.seconds(self.delay, "delay")
        if self.sensor_lag is not None:
            _validation.seconds(self.sensor_lag, "sensor_lag")
        if self.breakaway is not None:
            self._check_breakaway(self.breakaway)

    def _check_breakaway(self, breakaway: ArrayLike) -> None:
        rho = _validation.vector(breakaway, "breakaway", error=IdentifyError)
        if self.elements is not None:
            raise IdentifyError("got both elements and breakaway, need only one of them")
        if self.method != "record":
            raise IdentifyError(f"breakaway: method {self.method!r} needs the uniform grid; give elements instead")
        if not 1 <= rho.size <= 500 or rho[0] <= 0 or np.any(np.diff(rho) <= 0):
            raise IdentifyError("breakaway: need 1 to 500 positive, strictly increasing elongations in metres")
        object.__setattr__(self, "breakaway", rho)

    @property
    def count(self) -> int:
        """Number of elements N."""
        if self.breakaway is not None:
            return self.breakaway.size
        return self.elements or _ELEMENTS[self.method]

    def as_dict(self) -> dict[str, Any]:
        """Return the options that affect the result as JSON values."""
        return {
            "method": self.method,
            "norm": self.norm,
            "elements": self.count,
            "slope_floor": self.slope_floor,
            "shared_datum": self.shared_datum,
            "drift": self.drift,
            **({} if self.sensor_lag is None else {"sensor_lag": self.sensor_lag}),
        }
