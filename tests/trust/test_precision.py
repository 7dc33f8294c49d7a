"""Known means known to a stated precision: the rule, its words, and that every interval contains the estimate."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records

import dehyst
from dehyst import ModelError
from dehyst._io import finite
from dehyst.identification import Structure
from dehyst.report.html import document
from dehyst.report.trust_section import sections
from dehyst.trust import insight
from dehyst.trust.precision import NumberVerdict, PartPrecision, Precision

NAMES = ("stiffness", "stiffnesses", "V/m")


def judged(estimate, low, high, *, determined=True, precision=0.2, compatible=None):
    noise = np.array([[low], [high]], dtype=float)
    free = None if compatible is None else np.array([[end] for end in compatible], dtype=float)
    return PartPrecision.of(NAMES, np.array([float(estimate)]), noise, np.array([determined]), precision, free)


@pytest.mark.parametrize(
    ("part", "verdict", "words"),
    [
        (judged(1e6, 0.9e6, 1.1e6), NumberVerdict.KNOWN, "known, ± 10 %"),
        (judged(1e6, 0.8e6, 1.2e6), NumberVerdict.KNOWN, "known, ± 20 %"),
        (judged(1e6, 0.7e6, 1.2e6), NumberVerdict.WIDE, "± 25 %"),
        (judged(1e6, 0.0, 1.1e6), NumberVerdict.ZERO, "contains zero"),
        (judged(1e6, -0.1e6, 1.1e6, precision=0.9), NumberVerdict.ZERO, "contains zero"),
        (judged(1e6, 0.9e6, 1.1e6, determined=False), NumberVerdict.OPEN, "not determined"),
        (judged(1e6, 0.9e6, 1.1e6, compatible=(0.0, 1.1e6)), NumberVerdict.ZERO, "contains zero"),
        (judged(1e6, 0.9e6, 1.1e6, compatible=(0.6e6, 1.1e6)), NumberVerdict.WIDE, "± 25 %"),
        (judged(1e6, 1.1e6, 1.2e6), NumberVerdict.KNOWN, "known, ± 10 %; noise makes it too small"),
        (judged(1e6, 0.4e6, 0.5e6), NumberVerdict.WIDE, "± 30 %; noise makes it too large"),
        # Without any number to compare it with, nothing is small.
        (judged(0.0, 0.0, 1e-3), NumberVerdict.ZERO, "contains zero"),
    ],
)
def test_the_rule(part, verdict, words):
    assert part.verdicts == (verdict,)
    assert part.words(0) == words
    assert part.interval[0, 0] <= part.estimate[0] <= part.interval[1, 0]


@pytest.mark.parametrize(("high", "verdict"), [(0.9e5, NumberVerdict.BELOW), (1.1e5, NumberVerdict.ZERO)])
def test_an_estimate_of_zero_is_known_to_be_small_or_not_at_all(high, verdict):
    noise = np.array([[0.95e6, 0.0], [1.05e6, high]])
    part = PartPrecision.of(NAMES, np.array([1e6, 0.0]), noise, np.ones(2, dtype=bool), 0.2)
    assert part.verdicts == (NumberVerdict.KNOWN, verdict)
    assert (part.words(1) == "known to be below 0.09 V/um") == (verdict is NumberVerdict.BELOW)


def test_the_sentences_count_by_the_rule():
    noise = np.array([[0.9, 0.0, 0.5, 0.9], [1.1, 2.0, 1.5, 1.1]])
    part = PartPrecision.of(NAMES, np.ones(4), noise, np.array([True, True, True, False]), 0.2)
    found = Precision((part,), 0.2, 0.9)
    assert found.sentence == "1 of 4 stiffnesses is known within 20 %."
    assert found.others == (
        "Not known: 1 not determined by themselves, 1 with an interval that contains zero and 1 with a wider interval."
    )
    assert found.next.startswith("Record more cycles")
    wide = PartPrecision.of(NAMES, np.ones(1), noise[:, :1], np.ones(1, dtype=bool), 0.2, np.array([[0.0], [3.0]]))
    assert Precision((wide,), 0.2, 0.9).next.startswith("By noise alone 1 more is known")


@cache
def noisy():
    plant = plain_records.plant(5, seed=1)
    record = plain_records.loops(plant, plain_records.DESCENDING_TOPS, noise=4e-8)
    fit = dehyst.identify(
        record, breakaway=plant.slip.breakaway[:-1], norm="l2", delay=0.0, drift=False, knots=6, slope_floor=0.05
    )
    return fit.actuator, record


def test_an_interval_that_contains_zero_is_not_known_and_all_outputs_agree():
    actuator, record = noisy()
    found = insight(actuator, record, repeats=20, precision=0.02)
    precision, told = found.precision, json.loads(json.dumps(finite(found.as_dict()), allow_nan=False))["known"]
    page = document("", sections(found, None))
    for part, other in zip(precision.parts, told["parts"], strict=True):
        low, high = part.interval
        assert ((low <= part.estimate) & (part.estimate <= high)).all()
        assert other["known"] == part.known == sum(word.startswith("known") for word in other["words"])
        for i, verdict in enumerate(part.verdicts):
            if verdict is NumberVerdict.KNOWN:
                assert not low[i] <= 0 <= high[i]
                assert high[i] - low[i] <= 0.04 * abs(part.estimate[i])
    assert not precision.all_known
    assert any(precision.sentence in warning for warning in found.warnings())
    assert len(replace(found, exact=False).warnings()) == len(found.warnings()) - 1
    assert precision.sentence in page
    assert 'class="outcome amber"' in page
    assert precision.parts[0].words(0) in page


def test_the_precision_is_what_is_asked_for():
    actuator, record = noisy()
    counts = [
        sum(part.known for part in insight(actuator, record, repeats=20, precision=asked).precision.parts)
        for asked in (0.001, 0.02, 0.5)
    ]
    assert counts == sorted(counts)
    assert counts[0] < counts[-1]
    with pytest.raises(ModelError, match="precision: got 0"):
        insight(actuator, record, precision=0.0)


def test_without_intervals_nothing_is_said_of_precision():
    actuator, record = noisy()
    found = insight(actuator, record, repeats=0)
    assert found.precision is None
    assert found.as_dict()["known"] is None
    assert "no intervals" in document("", sections(found, None))


def test_open_stiffnesses_are_not_known_however_narrow_their_intervals():
    plant = plain_records.plant(5, seed=1)
    record = plain_records.loops(plant, plain_records.MAJOR)
    fit = dehyst.identify(record, breakaway=plant.slip.breakaway[:-1], delay=0.0, drift=False, knots=6)
    found = insight(fit.actuator, record, repeats=20)
    verdicts = found.precision.parts[0].verdicts
    assert [verdict is NumberVerdict.OPEN for verdict in verdicts] == (~found.identifiability.alone[:4]).tolist()
    assert "excite" not in found.precision.next


def test_each_part_of_a_structured_model_is_judged():
    structure = Structure(elements=6, grades=3, knots=7, transformer=5, creep=3, smooth=True)
    record = structured_records.plant(structure).record(noise=5e-9)
    fit = dehyst.identify(record, structure=structure, delay=0.0)
    found = insight(fit.actuator, record, repeats=20)
    actuator, parts = fit.actuator, {part.part: part for part in found.precision.parts}
    assert parts["stiffness"].of_all == 3 * found.evidence.regression.grid.movable.sum()
    assert parts["spring segment"].of_all == 6
    assert parts["creep branch"].of_all == actuator.creep.stiffness.size
    assert parts["smooth element"].of_all == actuator.smooth.stiffness.size
    assert parts["transformer segment"].of_all == 5
    for part in parts.values():
        assert ((part.interval[0] <= part.estimate) & (part.estimate <= part.interval[1])).all()
    assert "Number by number" in document("", sections(found, None))
