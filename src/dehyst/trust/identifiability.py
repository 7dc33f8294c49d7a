"""Identifiability of each part of a model: which combinations of its coefficients the records determine despite noise.

Coefficients are scaled to volts: stiffness times breakaway elongation, slope times the length of its segment, and so
on. The columns are computed along simulated paths, because measurement noise could be mistaken for information. Each
combination of a part's coefficients then has an RMS voltage that all other coefficients together cannot compensate.
This RMS voltage and the scatter of the legs' mean residuals give its standard deviation. The constraint that
stiffnesses are not negative is ignored: it can only determine more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._types import Array, Mask
from dehyst._views.fields import json_values
from dehyst.control import StateBounds, first_known_by_displacement, least_width, time_dependence
from dehyst.identification import RecordComparison, Regression, triangle_of
from dehyst.model import Actuator, GradedSlip, MaxwellSlip
from dehyst.records import Record, rms
from dehyst.trust.evidence import Evidence

# A combination is known if its standard deviation is at most this part of the range of the voltages.
SHARP = 0.01
# Less than this [V/V] is rounding.
_ROUNDING = 1e-7
# A coefficient with less than this in every direction that is not seen is determined by itself.
_SMALL = 0.02


@dataclass(frozen=True, eq=False)
class PartIdentifiability:
    """Identifiability of a part from records.

    Attributes
    ----------
    part : str
    deviations : (m,) array
        Standard deviation of each combination of its coefficients, the best known first [V]; infinite if the records
        do not determine it at all.
    allowed : float
        Largest standard deviation with which a combination counts as known [V].
    alone : (m,) bool array
        Whether the records determine a coefficient by itself, regardless of noise.
    """

    part: str
    deviations: Array
    allowed: float
    alone: Mask

    @property
    def of(self) -> int:
        """Number of coefficients."""
        return self.deviations.size

    @property
    def known(self) -> int:
        """Number of combinations known."""
        return int(np.count_nonzero(self.deviations <= self.allowed))

    @property
    def sentence(self) -> str:
        """The number of known combinations in words."""
        if self.known == self.of:
            return f"{self.part}: {'all ' if self.of > 1 else ''}{self.of} known."
        return f"{self.part}: {self.known} of {self.of} combinations known."

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        shown = [float(one) if np.isfinite(one) else None for one in self.deviations]
        return {"part": self.part, "known": self.known, "of": self.of, "deviations_V": shown}


def part_identifiability(evidence: Evidence) -> tuple[PartIdentifiability, ...]:
    """Return the identifiability of each part of a model; creep from before the records is left out."""
    regression = evidence.with_pieces(_made(evidence))
    weights = evidence.weights / np.median(evidence.weights)
    columns = regression.bounded / _holds(regression) * weights[:, None]
    nuisances = regression.nuisances() * weights[:, None]
    scatter = _scatter(evidence, weights)
    allowed = SHARP * float(np.ptp(regression.rows.voltage))
    found = []
    for part, own in _parts(regression):
        others = np.ones(columns.shape[1], dtype=bool)
        others[own] = False
        rest = np.hstack([nuisances, columns[:, others]])
        # What no sample sees would make the factorisation divide by nothing.
        rest = rest[:, np.abs(rest).max(axis=0) > _ROUNDING]
        triangle = triangle_of(np.hstack([rest, columns[:, own]]))
        _, values, vectors = np.linalg.svd(triangle[rest.shape[1] :, rest.shape[1] :])
        seen = np.zeros(own.stop - own.start)
        seen[: values.size] = values / np.sqrt(len(columns))
        deviations = np.divide(scatter, seen, out=np.full(seen.size, np.inf), where=seen > _ROUNDING)
        alone = np.linalg.norm(vectors[seen <= _ROUNDING], axis=0) <= _SMALL
        found.append(PartIdentifiability(part, deviations, allowed, alone))
    return tuple(found)


def _parts(regression: Regression) -> list[tuple[str, slice]]:
    """Return name and columns of each part of the model."""
    grid = regression.grid
    sizes = {
        "slip elements" if grid.segments == 1 else "graded elements": int(grid.movable.sum()) * grid.segments,
        "parallel spring": grid.knots.size - 1,
        "creep": grid.time_constants.size,
        "smooth elements": grid.lengths.size,
        "transformer": max(grid.drive.size - 2, 0),
    }
    edges = np.cumsum([0, *sizes.values()]).tolist()
    found = zip(sizes, edges[:-1], edges[1:], strict=True)
    return [(name, slice(start, stop)) for name, start, stop in found if stop > start]


def _holds(regression: Regression) -> Array:
    """Return the scale (q,) of each column: the coefficient that holds one volt."""
    grid = regression.grid
    stroke, lengths = float(np.ptp(grid.knots)), np.diff(grid.drive)
    found = np.concatenate(
        [
            np.repeat(grid.breakaway[grid.movable], grid.segments),
            np.diff(grid.knots),
            np.full(grid.time_constants.size, stroke),
            grid.lengths,
            lengths[:-1],
        ]
    )
    return np.concatenate([found, np.ones(regression.bounded.shape[1] - found.size)])


def _made(evidence: Evidence) -> list[list[Record]]:
    """Return the pieces with the displacements simulated by the model."""
    made = []
    for one in evidence.comparisons:
        paths = [piece.displacement.copy() for piece in one.measured]
        for number, epoch, played in one.played(evidence.actuator):
            paths[number][epoch.start : epoch.stop] = played[3] - one.datum
        made.append([replace(piece, displacement=y) for piece, y in zip(one.measured, paths, strict=True)])
    return made


def _scatter(evidence: Evidence, weights: Array) -> float:
    """Return the standard deviation of the legs' mean residuals [V]."""
    residual, starts = evidence.model.solved.residual * weights, evidence.leg_starts
    means = np.add.reduceat(residual, starts) / np.diff(np.append(starts, residual.size))
    white = rms(residual) / np.sqrt(residual.size)
    return float(max(rms(means) / np.sqrt(means.size), white))


# An element that holds less of the voltage than this has nothing to be homed for.
_SMALL = 1e-9


@dataclass(frozen=True)
class StateKnowledge:
    """Time after which the hysteresis state is observable from a record.

    Attributes
    ----------
    record : str
    by_displacement, by_voltage : float or None
        Time since the record's start [s] after which every element with stiffness is known, from the measured
        displacement and from the voltage alone; None if never.
    judged : bool
        Whether `by_voltage` was judged: the order of voltages does not determine it with creep, inertia, a lag or
        smooth elements.
    """

    record: str
    by_displacement: float | None
    by_voltage: float | None
    judged: bool = True

    @classmethod
    def of(cls, actuator: Actuator, compared: RecordComparison) -> StateKnowledge:
        """Return the state knowledge from a record that was compared with an actuator."""
        stiff, record = _stiff(actuator), compared.record.record
        # Noise widens a range by its extremes; what it adds is no excursion.
        reach = 2 * stiff.slip.breakaway + 4 * compared.record.noise
        ordered = not time_dependence(actuator)
        if not reach.size:
            return cls(record.name, 0.0, 0.0 if ordered else None, ordered)
        # With inertia the elements see what the resonance had to follow, which the pieces hold.
        path = record.displacement if actuator.dynamics is None else compared.pieces[0][1].displacement
        seen = first_known_by_displacement(0.5 * reach, path)
        played = None
        if ordered:
            bounds = StateBounds.at_rest(stiff, float(record.voltage[0]))
            played = bounds.propagate(stiff, record.voltage).first_known(least_width(stiff))

        def time(sample: int | None) -> float | None:
            return None if sample is None else float(record.time[sample] - record.time[0])

        return cls(record.name, time(seen), time(played), ordered)

    def as_dict(self) -> dict[str, object]:
        """JSON values."""
        return json_values(self, "record known_by_displacement_s=by_displacement known_by_voltage_s=by_voltage")


def _stiff(actuator: Actuator) -> Actuator:
    """Return the actuator with only spring, transformer and the slip elements that have stiffness."""
    slip = actuator.slip
    keep = slip.friction > _SMALL * float(np.ptp(actuator.spring.voltage))
    rho, kappa = slip.breakaway[keep], slip.stiffness[keep]
    kept = GradedSlip(rho, slip.knots, kappa) if isinstance(slip, GradedSlip) else MaxwellSlip(rho, kappa)
    return Actuator(kept, actuator.spring, limits=actuator.limits, transformer=actuator.transformer)
