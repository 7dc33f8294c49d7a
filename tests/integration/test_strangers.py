"""The suite of `benchmarks/strangers.py`: its truths are physical, its design is complete, and a case of it runs."""

import numpy as np
import pytest
from strangers import command, scores
from strangers.cases import design, named
from strangers.disturbances import DISTURBANCES
from strangers.protocols import PROTOCOLS
from strangers.truths import TRUTHS, Bench

STILL = [truth for truth in TRUTHS.values() if not truth.parts]


def loops(truth, turns, samples=100):
    """Times and voltages through turns, given as parts of the range."""
    u = np.interp(np.arange(1, samples * (len(turns) - 1) + 1) / samples, np.arange(len(turns)), turns)
    return truth.period / (2 * samples) * np.arange(1, u.size + 1), truth.low + (truth.high - truth.low) * u


@pytest.mark.parametrize("truth", TRUTHS.values(), ids=lambda truth: truth.name)
def test_a_truth_has_its_stroke_and_a_hysteresis(truth):
    y = Bench(truth).play(*loops(truth, [0, 1, 0, 1, 0]))[200:]
    assert np.ptp(y) == pytest.approx(truth.stroke, rel=0.03)
    assert 0.05 < (y[150] - y[49]) / truth.stroke < 0.25


@pytest.mark.parametrize("truth", STILL, ids=lambda truth: truth.name)
def test_no_susceptibility_is_negative(truth):
    time, voltage = loops(truth, [0, 1, 0, 0.7, 0.2, 0.5, 0.3, 0.6, 0.1, 0.9, 0])
    y = Bench(truth).play(time, voltage)
    assert np.all(np.diff(y) * np.diff(voltage) >= -1e-12 * truth.stroke)


@pytest.mark.parametrize("name", ["relays", "voigt"])
def test_a_passed_turn_is_wiped_out(name):
    truth = TRUTHS[name]
    compliant = [Bench(truth), Bench(truth)]
    for bench in compliant:
        if hasattr(bench.mechanism, "compliance"):
            bench.mechanism.compliance = (0.0, 0.0, 0.0)
    with_loop, without = (
        bench.play(*loops(truth, [0, 1, 0.2, *within, 0.8, 0.4]))[-100:]
        for bench, within in zip(compliant, ([0.6, 0.3, 0.5, 0.3], []), strict=True)
    )
    np.testing.assert_allclose(with_loop, without, atol=1e-12 * truth.stroke)


@pytest.mark.parametrize("truth", TRUTHS.values(), ids=lambda truth: truth.name)
def test_a_voltage_may_be_played_in_pieces(truth):
    time, voltage = loops(truth, [0, 0.8, 0.3, 1.0])
    late = 2.5 * float(time[0])
    whole, pieces = Bench(truth, late), Bench(truth, late)
    played = np.concatenate([pieces.play(time[a:b], voltage[a:b]) for a, b in ((0, 77), (77, 210), (210, 300))])
    np.testing.assert_allclose(played, whole.play(time, voltage), rtol=1e-12)


def test_the_design_is_complete():
    cases = design(3)
    assert len({case.name for case in cases}) == len(cases) == len(TRUTHS) * len(DISTURBANCES)
    assert {(case.truth.name, case.disturbance.name) for case in cases} == {
        (t, d) for t in TRUTHS for d in DISTURBANCES
    }
    assert {(case.truth.name, case.protocol.name) for case in cases[:40]} == {(t, p) for t in TRUTHS for p in PROTOCOLS}


def test_a_case_is_repeatable_and_disturbed():
    clean, disturbed, again = (named(f"relays/speeds/{what}", 1).experiment() for what in ("none", *2 * ("drift",)))
    for record, other, same in zip(clean.records, disturbed.records, again.records, strict=True):
        np.testing.assert_array_equal(other.displacement, same.displacement)
        assert 0.02 < np.ptp(other.displacement - record.displacement) / TRUTHS["relays"].stroke < 0.04
    assert clean.end == sum(map(len, clean.records))


def test_a_refusal_is_no_silent_failure():
    refused = {"said": "got no loop", "seconds": 0.0}
    verdicts = scores.judged(named("relays/tops/none", 0), {"auto": refused, "plain": refused}, None)
    assert verdicts["refused"] == "got no loop"
    assert not verdicts["silent"]


@pytest.mark.nightly
def test_a_process_of_its_own_finds_the_same():
    cases = [named("stribeck/sparse/vibration", 0)]
    (alone,), (sent,) = (list(command.run(cases, jobs)) for jobs in (1, 2))
    assert sent["methods"]["auto"]["rms"] == alone["methods"]["auto"]["rms"]
