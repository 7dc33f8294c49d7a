"""Goldfarb and Celanovic's identification: Maxwell-slip elements and a linear spring from a relaxed first rise.

M. Goldfarb, N. Celanovic, "Modeling piezoelectric stack actuators for control of micromanipulation", IEEE Control
Systems Magazine 17(3), 1997, 69-79, and "A lumped parameter electromechanical model for describing the nonlinear
behavior of piezoelectric actuators", ASME J. Dyn. Syst. Meas. Control 119, 1997, 478-485: the paper's reference 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst import IdentifyError
from dehyst._types import Array
from dehyst._validation import count, keep, vector
from dehyst.identification import as_list
from dehyst.model import Actuator, MaxwellSlip, Spring, State
from dehyst.paper.methods import Branch, voltage_at
from dehyst.records import Record, cleaned, reversals
from dehyst.trust import AbstractBaseline


@final
@dataclass(frozen=True, eq=False)
class GoldfarbCelanovic(AbstractBaseline):
    """A relaxed actuator with a linear spring; all its loops follow from its first rise (Masing's rule).

    `actuator`: starts relaxed at the displacement and voltage at which the rise began. `remarks`: sentences on the fit.
    """

    actuator: Actuator
    remarks: tuple[str, ...] = ()
    state: State = field(init=False, repr=False)
    delay: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        keep(self, state=self.actuator.state)

    def _run(self, drive: Array, state: State, time: ArrayLike | None, *, inverse: bool) -> tuple[Array, State]:
        play = self.actuator.compensate if inverse else self.actuator.simulate
        motion = play(drive, time=time, state=state, extrapolate=True)
        return motion.voltage if inverse else motion.displacement, motion.state

    @classmethod
    def fit(
        cls, records: Record | Sequence[Record], *, elements: int = 10, breakaway: ArrayLike | None = None
    ) -> GoldfarbCelanovic:
        """Compute the elements from the first rise of a record, in closed form.

        Between break points i and i + 1, the slope of the rise is the sum over the spring and all elements m > i; hence
        kappa_i = slope_{i-1} - slope_i. Element i slips at the elongation rho_i at which the rise has break point i,
        and the slope beyond the last one is the spring's. The record after the rise is not used.

        Where the rise is not concave, a stiffness would be negative. Such a break point is left out, and one straight
        segment replaces the two slopes next to it. The model's rise is then the least concave curve above the break
        points, and passes through all kept ones.

        `records`: one, or several of which the first counts. Its voltage rises first, from an actuator at rest and
        relaxed: no voltage for a day, or a decaying alternation. It may rest before; noise is allowed. `elements`:
        number N; the rise X is divided into equal parts, rho_i = i X / (N + 1). `breakaway` (N,): elongations rho_i [m]
        in place of equal parts and `elements`.

        Raise `IdentifyError` if there is no record, its voltage does not rise first, the rise is too short for
        this number of elements, or a break point is impossible.
        """
        given = as_list(records)
        if not given:
            raise IdentifyError("got no records, need the first rise of a relaxed actuator")
        record, *_, repairs = cleaned(given[0])
        rise, rest, height = _first_rise(record)
        rho = _break_points(elements, breakaway, height, record.name)
        if len(rise[0]) < rho.size + 2:
            raise IdentifyError(
                f"record '{record.name}': its first rise has {len(rise[0])} samples, {rho.size} elements need at least "
                f"{rho.size + 2}. Sample faster, rise slower, or use fewer elements"
            )
        places = np.concatenate([[0.0], rho, [height]])
        volts = voltage_at(rise, rest + places)
        slopes, remarks = _non_increasing(np.diff(volts) / np.diff(places), np.diff(places))
        if slopes[-1] <= 0:
            raise IdentifyError(
                f"record '{record.name}': the voltage does not rise beyond {rho[-1] * 1e6:.4g} um, so that no "
                "stiffness is left for the spring. Leave out the samples after the peak, or use fewer elements"
            )
        slip = MaxwellSlip(rho, slopes[:-1] - slopes[1:])
        spring = Spring.of_slopes(rest + np.array([0.0, height]), slopes[-1:], float(volts[0]))
        return cls(Actuator(slip, spring, State(rest, np.full(rho.size, rest)), name=record.name), (*repairs, *remarks))


def _first_rise(record: Record) -> tuple[Branch, float, float]:
    """Return the branch up to the first turning point of the voltage, the displacement at rest and the height [m]."""
    turns = reversals(record)
    end = int(turns[0]) if turns.size else len(record) - 1
    y, v = record.displacement[: end + 1], record.voltage[: end + 1]
    if v[-1] <= v[0]:
        raise IdentifyError(
            f"record '{record.name}': its voltage does not rise first but goes from {v[0]:.4g} to {v[-1]:.4g} V; "
            "need a first rise of a relaxed actuator. Cut the record where such a rise begins, or use dehyst.identify, "
            "which does not need it"
        )
    rest = float(y[: np.argmax(v > v[0])].mean())
    height = float(y[-1]) - rest
    if height <= 0:
        raise IdentifyError(
            f"record '{record.name}': the displacement goes from {rest * 1e6:.4g} to {y[-1] * 1e6:.4g} um while the "
            "voltage rises; need a displacement that rises too. Check the sensor's sign"
        )
    return (y, v), rest, height


def _break_points(elements: int, breakaway: ArrayLike | None, height: float, name: str) -> Array:
    """Return the given elongations, or those that divide the rise into N + 1 equal parts, the last for the spring."""
    if breakaway is None:
        count(elements, "elements", most=None)
        return np.asarray(height / (elements + 1) * np.arange(1, elements + 1), dtype=np.float64)
    rho = vector(breakaway, "breakaway", error=IdentifyError)
    if not rho.size or rho[0] <= 0 or np.any(np.diff(rho) <= 0):
        raise IdentifyError(
            f"breakaway: got {rho}, need one or more positive, strictly increasing elongations in metres"
        )
    if rho[-1] >= height:
        raise IdentifyError(
            f"breakaway: the last is {rho[-1] * 1e6:.4g} um, but the first rise of '{name}' is {height * 1e6:.4g} um "
            "high; need a smaller one, because the slope beyond it is the spring's. Give smaller ones, or record a "
            "higher rise"
        )
    return rho


def _non_increasing(slopes: Array, widths: Array) -> tuple[Array, tuple[str, ...]]:
    """Return the nearest slopes that do not increase (neighbours pooled by their widths), and remarks on the change."""
    from scipy.optimize import isotonic_regression

    pooled = np.asarray(isotonic_regression(slopes, weights=widths, increasing=False).x, dtype=np.float64)
    # Ignore slopes that only rounding makes negative.
    slight = 1e-9 * float(np.abs(slopes).max())
    steps = slopes[:-1] - slopes[1:]
    negative = steps < -slight
    if not negative.any():
        return pooled, ()

    def listed(chosen: NDArray[np.bool_]) -> str:
        return f"element{'s' if chosen.sum() > 1 else ''} {', '.join(map(str, np.flatnonzero(chosen) + 1))}"

    neighbours = (pooled[:-1] == pooled[1:]) & (steps > slight)
    also = f"; so was that of neighbouring {listed(neighbours)}" if neighbours.any() else ""
    part = 100 * float(-steps.min() / np.average(slopes, weights=widths))
    return pooled, (
        f"The first rise is not concave: the stiffness of {listed(negative)} would be negative, by at most "
        f"{part:.3g} % of the mean slope, and was set to 0{also}. Small negative stiffnesses come from noise, large "
        "ones from residual strain or a curved spring: then this model does not describe the loop.",
    )
