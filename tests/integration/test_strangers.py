"""The suite of `benchmarks/strangers.py`: its truths are physical, and a case of it is repeatable."""

import numpy as np
import pytest
from strangers.cases import named
from strangers.truths import TRUTHS, Bench


def loops(truth, turns, samples=100):
    """Times and voltages through turns, given as parts of the range."""
    u = np.interp(np.arange(1, samples * (len(turns) - 1) + 1) / samples, np.arange(len(turns)), turns)
    return truth.period / (2 * samples) * np.arange(1, u.size + 1), truth.low + (truth.high - truth.low) * u


@pytest.mark.parametrize("truth", TRUTHS.values(), ids=lambda truth: truth.name)
def test_a_truth_has_its_stroke_and_a_hysteresis(truth):
    y = Bench(truth).play(*loops(truth, [0, 1, 0, 1, 0]))[200:]
    assert np.ptp(y) == pytest.approx(truth.stroke, rel=0.03)
    assert 0.05 < (y[150] - y[49]) / truth.stroke < 0.25


def test_a_case_is_repeatable_and_disturbed():
    clean, disturbed, again = (named(f"relays/speeds/{what}", 1).experiment() for what in ("none", *2 * ("drift",)))
    for record, other, same in zip(clean.records, disturbed.records, again.records, strict=True):
        np.testing.assert_array_equal(other.displacement, same.displacement)
        assert 0.02 < np.ptp(other.displacement - record.displacement) / TRUTHS["relays"].stroke < 0.04
    assert clean.end == sum(map(len, clean.records))
