"""What records tell of a wider model: how sharp its parts and its predictions are, and how to home it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.control import Compensator, Homing, shortest_homing
from dehyst.identification.diagnostics.identifiability import Identifiability, probe_identifiability
from dehyst.identification.preprocessing.cleaning import cycle_time
from dehyst.model import Actuator, State
from dehyst.records import Record
from dehyst.uncertainty.bootstrap import Intervals, resample
from dehyst.uncertainty.messages import beyond, misfit_of, not_homed, of_another
from dehyst.uncertainty.part_identifiability import SHARP, PartIdentifiability, part_identifiability
from dehyst.uncertainty.prediction_band import PredictionBand, rise_excitation, state_after_rise, state_at_top
from dehyst.uncertainty.state_knowledge import StateKnowledge
from dehyst.uncertainty.wide_evidence import WideEvidence

NOT_JUDGED = (
    "Not judged of a wider model: what other models of its class the records do not contradict, whether its structure "
    "is the right one, and which excitation would tell most. Delay, inertia and sensor zeros are held where they are."
)

_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class MajorLoopWidth:
    """The major loop at the pace of the records, after one before it.

    Attributes
    ----------
    voltage, displacement : (n,) array
        Through the limits [V], up first, and what the model does [m].
    noise : (2, n) array
        Lowest and highest displacement of models identified from resampled cycles [m].
    """

    voltage: Array
    displacement: Array
    noise: Array

    @classmethod
    def of(cls, evidence: WideEvidence, intervals: Intervals, limits: tuple[float, float]) -> MajorLoopWidth:
        """Play two cycles through the limits; the second counts."""
        seconds = min(cycle_time(one.record.record) for one in evidence.comparisons)
        phase = np.linspace(0, 2, 2 * _SAMPLES + 1)
        low, high = limits
        voltage = low + (high - low) * (0.5 - 0.5 * np.cos(2 * np.pi * phase))
        time = seconds * phase if evidence.actuator.needs_time else None

        def state(model: Actuator) -> State:
            return model.turned(float(model.spring.displacement[0]), rising=False)

        noise = intervals.prediction(voltage, state, time)[:, _SAMPLES:]
        actuator = evidence.actuator
        own = actuator.simulate(voltage, time=time, state=state(actuator), extrapolate=True).displacement
        return cls(voltage[_SAMPLES:], own[_SAMPLES:], noise)

    @property
    def off(self) -> float:
        """The largest distance of the noise's models from the model [m]."""
        return float(np.abs(self.noise - self.displacement).max())


@dataclass(frozen=True, eq=False)
class WideInsight:
    """How far a wider model may be trusted.

    Attributes
    ----------
    actuator : Actuator
    evidence : WideEvidence
    parts : tuple of PartIdentifiability
        What the records tell of each part.
    identifiability : Identifiability
        What their turning points tell of ten plain elements: whether there are inner loops enough.
    intervals : Intervals or None
        From resampled cycles; None if they were not asked for.
    loop : MajorLoopWidth or None
        The major loop, with the intervals.
    knowledge : tuple of StateKnowledge
    homing : Homing or None
        None if the model has no voltage limits.
    band : PredictionBand or None
        If a trajectory was given; without what the records do not contradict.
    misfit : float
        The largest error of the model on these records [m].
    limits : (float, float) or None
        Voltages allowed [V].
    """

    actuator: Actuator
    evidence: WideEvidence
    parts: tuple[PartIdentifiability, ...]
    identifiability: Identifiability
    intervals: Intervals | None
    loop: MajorLoopWidth | None
    knowledge: tuple[StateKnowledge, ...]
    homing: Homing | None
    band: PredictionBand | None
    misfit: float
    limits: tuple[float, float] | None

    def warnings(self) -> tuple[str, ...]:
        """What must be known before the model is used."""
        found = [
            of_another(self.actuator, self.misfit, self.evidence.stroke),
            self._open(),
            beyond(self.actuator, self.limits),
        ]
        if self.band is not None:
            found += [*self.band.warnings, not_homed(self.homing)]
        return tuple(one for one in found if one)

    @property
    def trustworthy(self) -> bool:
        """Whether the records have inner loops enough to tell ten plain elements apart."""
        return self.identifiability.determined == self.identifiability.of

    def _open(self) -> str | None:
        if self.trustworthy:
            return None
        open_, of = self.identifiability.of - self.identifiability.determined, self.identifiability.of
        top = "" if self.limits is None else f" (dehyst excite descending-tops {self.limits[1]:.6g} -o voltage.csv)"
        return (
            f"The turning points of these records leave {open_} of {of} directions of plain elements open, let alone "
            "of this model's: motions that turn elsewhere than the records do may be predicted wrongly. Add tops that "
            f"descend{top}."
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values; lengths in metres."""
        return {
            **self.evidence.as_dict(),
            "warnings": list(self.warnings()),
            "not_judged": NOT_JUDGED,
            "misfit_m": self.misfit,
            "probed": {"determined": self.identifiability.determined, "of": self.identifiability.of},
            "told": {"allowed_deviation_of_the_voltages": SHARP, "parts": [one.as_dict() for one in self.parts]},
            "parts": {
                name: {"model": model.tolist(), "noise": None if noise is None else noise.tolist()}
                for name, (model, noise) in self.numbers().items()
            },
            "major_loop_off_m": None if self.loop is None else self.loop.off,
            "level": None if self.intervals is None else self.intervals.level,
            "state": [one.as_dict() for one in self.knowledge],
            "homing": None
            if self.homing is None
            else {
                "turns_V": list(self.homing.turns),
                "travel_V": self.homing.travel,
                "certified": self.homing.certified,
                "seconds": None if self.homing.played is None else self.homing.played.duration,
                "error_m": self.homing.error,
                "remarks": list(self.homing.remarks),
            },
            "trajectory": None
            if self.band is None
            else {f"{name}_m": error for name, error in self.band.errors().items()},
        }

    def numbers(self) -> dict[str, tuple[Array, Array | None]]:
        """By name with its unit: coefficients of the parts that stand alone, and their lowest and highest by noise."""
        own, noise = self.actuator, self.intervals
        found: dict[str, tuple[Array, Array | None]] = {}
        if own.transformer is not None:
            found["transformer_V"] = own.transformer.drive, None if noise is None else noise.drive
        if own.creep is not None:
            found["creep_V_per_m"] = own.creep.stiffness, None if noise is None else noise.creep
        if own.smooth is not None:
            found["smooth_V_per_m"] = own.smooth.stiffness, None if noise is None else noise.smooth
        return found


def look(
    actuator: Actuator,
    records: Record | Sequence[Record],
    trajectory: Array | None,
    time: Array | None,
    *,
    limits: tuple[float, float] | None,
    level: float,
    repeats: int,
    seed: int,
    progress: Callable[[str], None],
) -> WideInsight:
    """Look at a wider model beside records; parameters and errors are those of `dehyst.insight.insight`."""
    evidence = WideEvidence.of(actuator, records)
    misfit = misfit_of(actuator, evidence.comparisons)
    intervals = loop = band = homing = None
    if repeats:
        intervals = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
    progress("looking for a homing")
    if intervals is not None and limits is not None:
        loop = MajorLoopWidth.of(evidence, intervals, limits)
    if limits is not None:
        homing = shortest_homing(actuator, limits=limits, present=limits[0], stiff_only=True)
    if trajectory is not None and intervals is not None:
        played = None if limits is None else rise_excitation(actuator, limits)
        start = state_at_top(actuator, limits) if limits is None else state_after_rise(actuator, limits, played)
        command = Compensator(actuator, limits).trajectory(trajectory, time=time, state=start)
        clock = time if actuator.needs_time else None
        band = PredictionBand.of(
            trajectory, command, intervals, None, misfit=misfit, limits=limits, time=clock, played=played
        )
    progress("counting what is told")
    known = tuple(StateKnowledge.of(actuator, one) for one in evidence.comparisons)
    return WideInsight(
        actuator,
        evidence,
        part_identifiability(evidence),
        _probed(evidence),
        intervals,
        loop,
        known,
        homing,
        band,
        misfit,
        limits,
    )


def _probed(evidence: WideEvidence) -> Identifiability:
    own = evidence.regression
    pieces = [
        replace(piece, displacement=piece.displacement + one.datum)
        for one in evidence.comparisons
        for _, piece, _ in one.pieces
    ]
    return probe_identifiability(pieces, own.rows, (float(own.knots[0]), float(own.knots[-1])))
