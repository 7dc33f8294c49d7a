"""What a path unlike the records would be missed by."""

import itertools

import numpy as np

from dehyst import Actuator, Record, identify
from dehyst.identification import Structure
from dehyst.identification.held_out import disagreement
from dehyst.identification.structure_selection import StructureTrial
from dehyst.identification.structured_fit import StructuredFit
from dehyst.model import MaxwellSlip, Spring

STROKE = 1e-5


def record(turns, seed=0, noise=0.0, bend=0.0):
    """A plain actuator between these voltages; with `bend` one whose branches depend on where they begin."""
    v = np.concatenate([np.linspace(a, b, 60, endpoint=False) for a, b in itertools.pairwise(turns)])
    rho = STROKE / 2 * np.array([0.05, 0.2, 0.5, 0.9])
    ends = np.array([-0.2 * STROKE, 1.5 * STROKE])
    y = Actuator(MaxwellSlip(rho, np.array([2e6, 1e6, 8e5, 4e5])), Spring(ends, 7e6 * ends)).simulate(v).displacement
    y = y + bend * STROKE * np.sin(3 * np.pi * y / STROKE) + noise * np.random.default_rng(seed).normal(size=y.size)
    return Record(np.arange(v.size) * 0.01, v, y)


def captured(monkeypatch, records, **options):
    """The regression of a fit, and its data."""
    from dehyst.identification import run

    kept = {}

    def look(self, frame, regression, actuator):
        kept.update(frame=frame, regression=regression, actuator=actuator)

    monkeypatch.setattr(run.IdentificationRun, "estimate_heldout_errors", look)
    identify(records, **options)
    return kept


def test_structures_that_explain_as_well_but_differ_disagree(monkeypatch):
    kept = captured(monkeypatch, record([0.0, 80, 0, 80, 0, 60, 0, 40, 0], noise=2e-9), structure=Structure(grades=8))
    frame, actuator, limits = kept["frame"], kept["actuator"], (0.0, 80.0)
    same, other = Structure(grades=8), Structure(elements=5)
    nothing = disagreement(frame, actuator, limits, [StructureTrial(same, 1e-9, 1e-9, 0.0)])
    much = disagreement(frame, actuator, limits, [StructureTrial(other, 1e-9, 1e-9, 0.0)])
    assert nothing < 0.003 * STROKE < much
    worse = [StructureTrial(same, 1e-9, 1e-9, 0.0), StructureTrial(other, 2e-9, 1e-9, 0.0)]
    assert disagreement(frame, actuator, limits, worse) == nothing
    assert StructuredFit.solve(frame, same, "l2").found.solved.optimal
