"""Goldfarb and Celanovic's identification: Maxwell-slip elements and a linear spring, read off the relaxed first rise.

M. Goldfarb, N. Celanovic, "Modeling piezoelectric stack actuators for control of micromanipulation", IEEE Control
Systems Magazine 17(3), 1997, 69-79, and "A lumped parameter electromechanical model for describing the nonlinear
behavior of piezoelectric actuators", ASME J. Dyn. Syst. Meas. Control 119, 1997, 478-485: the paper's reference 6.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import IdentifyError
from dehyst._types import Array
from dehyst._validation import count, vector
from dehyst.baselines.base import AbstractBaseline
from dehyst.identification.diagnostics.branches import Branch, voltage_at
from dehyst.identification.preprocessing.cleaning import remove_glitches
from dehyst.model import Actuator, MaxwellSlip, Spring, State
from dehyst.records import Record


@final
@dataclass(frozen=True, eq=False)
class GoldfarbCelanovic(AbstractBaseline):
    """A relaxed actuator with a linear spring, whose loops follow from its first rise alone (Masing's rule).

    Attributes
    ----------
    actuator : Actuator
        It starts relaxed at the displacement and voltage at which the rise began.
    remarks : tuple of str
        Sentences: what the user should know of the fit.
    """

    actuator: Actuator
    remarks: tuple[str, ...] = ()
    state: State = field(init=False, repr=False)
    delay: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", self.actuator.state)

    def _displaced(self, v: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        motion = self.actuator.simulate(v, time=time, state=state, extrapolate=True)
        return motion.displacement, motion.state

    def _driven(self, y: Array, state: State, time: ArrayLike | None) -> tuple[Array, State]:
        motion = self.actuator.compensate(y, time=time, state=state, extrapolate=True)
        return motion.voltage, motion.state

    @classmethod
    def fit(cls, record: Record, *, elements: int = 10, breakaway: ArrayLike | None = None) -> GoldfarbCelanovic:
        """Read the elements off the first rise of a record, in closed form.

        Between break points i and i + 1 of the rise its slope is that of the spring and of all elements m > i, so that
        kappa_i = slope_{i-1} - slope_i; element i lets go at the elongation rho_i at which the rise has break point i,
        and the slope beyond the last one is the spring's. Nothing after the rise is looked at.

        Where the rise is not concave a stiffness would be negative. Such a break point is left out, and the slopes
        beside it are those of one straight segment: the model's rise is the least concave one above the break points,
        and meets all that were kept.

        Parameters
        ----------
        record : Record
            Its voltage rises first, from an actuator at rest and relaxed: no voltage for a day, or a decaying
            alternation. It may rest before; noise is allowed.
        elements : int, optional
            Number N of elements; the rise X is cut in equal parts, rho_i = i X / (N + 1).
        breakaway : (N,) array_like, optional
            Elongations rho_i [m] in place of equal parts; `elements` is not looked at then.

        Returns
        -------
        GoldfarbCelanovic

        Raises
        ------
        IdentifyError
            If `record` is no Record, its voltage does not rise first, the rise is too short for so many elements, or a
            break point is impossible.
        """
        if not isinstance(record, Record):
            raise IdentifyError(f"got {type(record).__name__}, need a record; read a file with dehyst.read(path)")
        record, _, said = remove_glitches(record)
        rise, rest, height = _first_rise(record)
        rho = _equal_parts(elements, height) if breakaway is None else _given(breakaway, height, record.name)
        if len(rise[0]) < rho.size + 2:
            raise IdentifyError(
                f"record '{record.name}': its first rise has {len(rise[0])} samples, {rho.size} elements need "
                f"{rho.size + 2} at least. Sample faster, rise slower, or use fewer elements"
            )
        places = np.concatenate([[0.0], rho, [height]])
        volts = voltage_at(rise, rest + places)
        slopes, remarks = _falling(np.diff(volts) / np.diff(places), np.diff(places))
        if slopes[-1] <= 0:
            raise IdentifyError(
                f"record '{record.name}': the voltage does not rise beyond {rho[-1] * 1e6:.4g} um, so that no "
                "stiffness is left for the spring. Leave out what follows the peak, or use fewer elements"
            )
        slip = MaxwellSlip(rho, slopes[:-1] - slopes[1:])
        spring = Spring.of_slopes(rest + np.array([0.0, height]), slopes[-1:], float(volts[0]))
        return cls(Actuator(slip, spring, State(rest, np.full(rho.size, rest)), name=record.name), (*said, *remarks))


def _first_rise(record: Record) -> tuple[Branch, float, float]:
    """Branch from the first sample to the first turning point of the voltage, displacement at rest, height [m]."""
    turns = record.reversals()
    end = int(turns[0]) if turns.size else len(record) - 1
    y, v = record.displacement[: end + 1], record.voltage[: end + 1]
    if v[-1] <= v[0]:
        raise IdentifyError(
            f"record '{record.name}': its voltage does not rise first but goes from {v[0]:.4g} to {v[-1]:.4g} V; "
            "need a first rise from relaxation. Cut the record where such a rise begins, or use dehyst.identify, which "
            "needs none"
        )
    rest = float(y[: np.argmax(v > v[0])].mean())
    height = float(y[-1]) - rest
    if height <= 0:
        raise IdentifyError(
            f"record '{record.name}': the displacement goes from {rest * 1e6:.4g} to {y[-1] * 1e6:.4g} um while the "
            "voltage rises; need one that rises too. Check the sensor's sign"
        )
    return (y, v), rest, height


def _equal_parts(elements: int, height: float) -> Array:
    """Break points that cut the rise in N + 1 equal parts, the last of which is the spring's."""
    count(elements, "elements", most=None)
    return np.asarray(height / (elements + 1) * np.arange(1, elements + 1), dtype=np.float64)


def _given(breakaway: ArrayLike, height: float, name: str) -> Array:
    rho = vector(breakaway, "breakaway", error=IdentifyError)
    if not rho.size or rho[0] <= 0 or np.any(np.diff(rho) <= 0):
        raise IdentifyError(
            f"breakaway: got {rho}, need one or more positive, strictly increasing elongations in metres"
        )
    if rho[-1] >= height:
        raise IdentifyError(
            f"breakaway: the last is {rho[-1] * 1e6:.4g} um, but the first rise of '{name}' is {height * 1e6:.4g} um "
            "high; need it smaller, for the slope beyond it is the spring's. Give smaller ones or record a higher rise"
        )
    return rho


def _falling(slopes: Array, widths: Array) -> tuple[Array, tuple[str, ...]]:
    """The nearest slopes that do not increase, neighbours pooled by their widths, and what was done to get them."""
    from scipy.optimize import isotonic_regression

    pooled = np.asarray(isotonic_regression(slopes, weights=widths, increasing=False).x, dtype=np.float64)
    # What rounding alone makes negative is no finding.
    slight = 1e-9 * float(np.abs(slopes).max())
    steps = slopes[:-1] - slopes[1:]
    negative = steps < -slight
    if not negative.any():
        return pooled, ()
    beside = (pooled[:-1] == pooled[1:]) & (steps > slight)
    also = f", nor did {_listed(beside)} beside" if beside.any() else ""
    part = 100 * float(-steps.min() / np.average(slopes, weights=widths))
    return pooled, (
        f"The first rise is not concave: {_listed(negative)} came out with a negative stiffness, at most {part:.3g} % "
        f"of the mean slope, and got none{also}. Small ones come from noise, large ones from residual strain or a "
        "curved spring: then the loop is not that of this model.",
    )


def _listed(chosen: NDArray[np.bool_]) -> str:
    numbers = [str(i + 1) for i in np.flatnonzero(chosen)]
    return f"element{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
