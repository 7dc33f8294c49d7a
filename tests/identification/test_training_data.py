"""Records to the regression of a structure: what starts of creep, leads, holds and speeds tell."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import plain_records
import pytest
import structured_records as wide
from truths import BoucWenActuator

import dehyst
from dehyst import Record, State
from dehyst.identification import Structure
from dehyst.identification.lag_search import find_lag
from dehyst.identification.preprocessing.preparation import prepare
from dehyst.identification.run import IdentificationRun
from dehyst.identification.settings import Settings
from dehyst.waveforms import Sampling, descending_tops

CREEPING = Structure(elements=8, knots=7, creep=4)
HOLDING = wide.wandering(30, samples=30, hold=30)


@cache
def creeping():
    return wide.plant(CREEPING, seed=1, path=HOLDING)


def begun(strains):
    plant = creeping()
    state = State(plant.state.deformation, plant.state.carts, np.asarray(strains) * plain_records.STROKE)
    return plant.record(state=state, noise=1e-4 * plain_records.STROKE)


def test_a_record_that_begins_at_rest_is_given_no_start():
    frame = wide.frame([creeping().record(noise=1e-4 * plain_records.STROKE)])
    assert frame.strained == ()
    assert frame.regression(CREEPING).strained == ()


def test_a_record_that_begins_unrelaxed_is_told():
    """Of two records, the one that was moved slowly before: its slow branches hold."""
    records = [creeping().record(noise=1e-4 * plain_records.STROKE), begun([0, 0, 0.1, 0.3])]
    records[1] = replace(records[1], name="second")
    frame = wide.frame(records)
    assert frame.strained == (1,)
    assert frame.regression(CREEPING).strained == (1,)
    # Without creep there is nothing that a start could be of.
    assert frame.regression(Structure()).strained == ()


def test_the_lead_of_a_transient_counts_in_the_fit():
    """A start-up transient is left out of the rows, but creep remembers it."""
    plant = creeping()
    path = np.concatenate(
        [plain_records.STROKE * np.full(150, 0.4), plain_records.path((0.4, 1.0), 20)[1:], plant.path[1:]]
    )
    other = replace(plant, path=path, state=plant.actuator.relaxed(15.0))
    record = other.record()
    prepared = prepare(record)
    assert prepared.lead is not None
    assert len(prepared.lead) + len(prepared.record) == len(record)
    frame = wide.frame([record])
    without = replace(frame, training=[replace(prepared, lead=None)])
    errors = []
    for one in (frame, without):
        regression = replace(one.regression(CREEPING), strained=())
        found = regression.fit("l2")
        errors.append(regression.rms(found) / plain_records.STROKE)
    assert errors[0] < 0.3 * errors[1]


def swept(rates, *, hold=0):
    """A record at each rate [Hz of samples]."""
    plant = plain_records.plant(10)
    records = []
    for k, rate in enumerate(rates):
        y = plain_records.path((1, 0, 1, 0, 0.6, 0, 0.3, 0), 60)
        if hold:
            y = np.append(y, np.concatenate([np.zeros(hold), plain_records.path((0, 0.5, 0), 60)]))
        records.append(plain_records.record(plant, y, rate=rate, name=f"{k}"))
    return records


@pytest.mark.parametrize(
    ("rates", "hold", "supported"),
    [
        ((200.0,), 0, False),
        ((200.0, 100.0), 0, False),
        ((200.0, 50.0), 0, True),
        ((200.0,), 30, False),
        ((200.0,), 100, True),
    ],
)
def test_creep_needs_a_hold_of_a_leg_or_loops_at_speeds_three_times_apart(rates, hold, supported):
    frame = wide.frame(swept(rates, hold=hold))
    assert frame.supports_creep() is supported
    run = IdentificationRun(Settings(), list(frame.training), [], lambda _: None)
    _, trials = run.search(frame, Structure(elements=10, knots=11))
    tried, remarks = any(trial.structure.creep for trial in trials), run.remarks
    assert tried is supported
    assert len(remarks) == (not supported)
    # A hold that is too short is reported with what is missing.
    if hold and not supported:
        (needed,) = [float(number) for number in re.findall(r"is (\S+) s too short", remarks[0])]
        assert needed == pytest.approx(60 / 200 - hold / 200, abs=0.03)


@pytest.mark.parametrize(("pace", "shape"), [("rate", "triangle"), ("frequency", "cosine")])
def test_loops_of_falling_height_are_one_speed(pace, shape):
    """At one slew rate small loops are shorter, at one frequency they are slower: neither shows creep."""
    drive = Sampling(frequency=0.1, sample_rate=20.0, shape=shape, pace=pace)
    played = descending_tops(100, drive=drive)
    y = BoucWenActuator(highest=100.0).play(played.voltage, time=played.time)
    assert not wide.frame([Record(played.time, played.voltage, y)]).supports_creep()


def test_times_are_those_of_the_finest_and_the_longest_record():
    records = swept((200.0, 50.0))
    assert wide.frame(records).times == pytest.approx((1 / 200, float(np.ptp(records[1].time))))


def test_delayed_voltages_are_taken_back():
    record = creeping().record()
    late = Record(record.time, record.voltage, np.append(np.full(5, record.displacement[0]), record.displacement[:-5]))
    found = [
        wide.frame([one], delay).regression(CREEPING).fit("l2")
        for one, delay in ((record, 0.0), (late, 5 / wide.RATE), (late, 0.0))
    ]
    errors = [np.abs(one.stiffness - found[0].stiffness).max() / found[0].stiffness.max() for one in found[1:]]
    assert errors[0] < 0.1 * errors[1]


@pytest.mark.nightly
def test_friction_that_lets_go_gradually_is_no_delay():
    """A Bouc-Wen actuator at 0.01 Hz: plain elements take it to be seconds late, wider ones know better."""
    truth = BoucWenActuator()
    tops = descending_tops(truth.highest, drive=Sampling(frequency=0.01, sample_rate=4.0))
    record = Record(tops.time, tops.voltage, truth.play(tops.voltage, time=tops.time), "slow")
    assert dehyst.identify(record, norm="l2").actuator.delay < 0.05


def test_fast_creep_is_no_delay():
    """Creep of a few samples trails behind at every turn."""
    structure = Structure(elements=10, knots=11, creep=8)
    record = wide.plant(structure, seed=2).record(noise=1e-5 * plain_records.STROKE)
    lagging = find_lag(wide.frame([record]), 4 / wide.RATE, 60 / wide.RATE)
    assert (lagging.delay, lagging.lag) == (0, 0)
