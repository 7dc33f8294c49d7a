"""Rows that never exist all at once say the same as rows in memory, and long records leave the memory alone."""

import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import places
import plain_records
import pytest

import dehyst
from dehyst.identification import validation
from dehyst.identification.preprocessing import denoising, regressors
from dehyst.identification.preprocessing.preparation import prepare
from dehyst.identification.preprocessing.regressors import Rows, RowSource, collect
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers.program import NORMS
from dehyst.identification.structure import Grid
from dehyst.model import Creep, Dynamics, SmoothSlip, Transformer
from dehyst.records import signals
from examples import at_night

RHO = plain_records.plant(12).slip.breakaway


def pieces(noise=2e-9):
    """Two noisy records of one actuator, the second of growing range: several epochs."""
    actuator = plain_records.plant(12)
    one = plain_records.loops(actuator, plain_records.THREE_LOOPS, samples=150, noise=noise)
    two = plain_records.loops(
        actuator, (0.5, 0.4, 0.6, 0.4, 0.6, 0.3, 0.7, 0.3, 0.7, 0.0, 1.0, 0.0, 1.0), noise=noise, seed=1
    )
    return [(q, record, np.log1p(record.time)) for q, record in enumerate((one, two))]


def stream(most, drifting=(1,)):
    """All rows of these records, `most` of them in memory."""
    grid = Grid.maxwell_slip(RHO, np.linspace(0, plain_records.STROKE, 13), 2 * RHO < plain_records.STROKE * 0.999)
    source = RowSource.of(pieces(), grid, [2e-9, 2e-9])
    return Regression(source.thinned(most), grid, 1e5, np.zeros(2), drifting, source=source)


def twice(grid, path, lead, size):
    """Something that moves along a path, and differs from path to path."""
    rows = np.column_stack([path.displacement, path.displacement[3] + path.time])
    return (rows[begin : begin + size] for begin in range(0, len(rows), size))


def source():
    return RowSource.of(pieces(), Grid.maxwell_slip(RHO, np.zeros(2)), [2e-9, 2e-9])


@pytest.mark.parametrize("size", [1, 97, 1000])
@pytest.mark.parametrize("moving", [False, True])
def test_blocks_of_any_size_are_the_rows(monkeypatch, size, moving):
    if moving:
        monkeypatch.setattr(regressors, "internal_states", twice)
    whole = source().thinned(10**9)
    assert whole.moved.shape == (len(whole), 2 if moving else 0)
    if moving:
        np.testing.assert_array_equal(whole.moved[:, 0], whole.displacement)
    else:
        found, _ = collect(pieces(), RHO, [2e-9, 2e-9])
        np.testing.assert_array_equal(found.elongation, whole.elongation)
    monkeypatch.setattr(regressors, "_BLOCK", size)
    made = source()
    assert len(made) == len(whole)
    assert made.count == np.unique(whole.epoch).size
    for name in Rows.__dataclass_fields__:
        got = np.concatenate([getattr(block, name) for block in made.blocks()])
        np.testing.assert_array_equal(got, getattr(whole, name))
        np.testing.assert_array_equal(getattr(made.thinned(100), name), getattr(whole.thinned(100), name))


@pytest.mark.parametrize("norm", NORMS)
def test_a_stream_has_the_optimum_of_the_rows_in_memory(monkeypatch, norm):
    memory = stream(10**9)
    assert memory.whole
    one = memory.fit_weighted(norm)
    monkeypatch.setattr(regressors, "_BLOCK", 211)
    streamed = stream(300)
    assert not streamed.whole
    other = streamed.fit_weighted(norm)
    assert other.solution.optimal
    assert abs(other.solution.gap) < 1e-6
    weights = 1 / memory.slope(memory.fit("l2"))
    free, bounded, target = memory.table()

    def residual(found):
        x = np.concatenate([found.stiffness[memory.grid.movable, 0], found.slopes - memory.floor])
        a = np.array([*found.offsets.values(), *found.drifts.values()])
        return np.abs(free @ a + bounded @ x - target) * weights

    order = {"l1": 1, "l2": 2}[norm]
    got, best = (np.linalg.norm(residual(found), order) for found in (other, one))
    assert got == pytest.approx(best, rel=1e-6)
    if norm == "l2":
        np.testing.assert_allclose(other.stiffness, one.stiffness, rtol=1e-6, atol=1e-6 * one.stiffness.max())


def test_constants_and_drifts_of_a_given_model_are_the_same():
    memory = stream(10**9)
    model = memory.fit_weighted("l2")
    one, other = memory.fit_nuisances(model), stream(300).fit_nuisances(model)
    np.testing.assert_allclose(list(other.offsets.values()), list(one.offsets.values()), rtol=1e-9)
    assert other.drifts[1] == pytest.approx(one.drifts[1], rel=1e-6)


def test_a_record_played_in_stretches_has_the_same_errors(monkeypatch):
    record = plain_records.loops(plain_records.plant(12), plain_records.THREE_LOOPS, samples=150, noise=2e-9)
    one = dehyst.identify(record, elements=12)
    monkeypatch.setattr(validation, "_AT_A_TIME", 113)
    monkeypatch.setattr(validation, "_STOPS_AT_A_TIME", 41)
    monkeypatch.setattr(validation, "_MOST_DRAWN", 200)
    other = dehyst.identify(record, elements=12)
    for name in ("largest", "rms", "largest_with_drift", "rms_with_drift"):
        assert getattr(other.errors[0], name) == pytest.approx(getattr(one.errors[0], name), rel=1e-6)
    assert other.errors[0].samples == one.errors[0].samples
    step = one.traces[0].time.size // 200
    np.testing.assert_array_equal(other.traces[0].time, one.traces[0].time[::step])
    np.testing.assert_allclose(
        other.traces[0].simulated, one.traces[0].simulated[::step], atol=1e-12 * plain_records.STROKE
    )


TAU = Transformer(
    [-10.0, 0.4 * plain_records.VOLTS, 1.5 * plain_records.VOLTS],
    [-10.0, 0.5 * plain_records.VOLTS, 1.5 * plain_records.VOLTS],
)
WIDE = {
    "creep": {"creep": Creep([0.03, 2.0], [4e5, 6e5])},
    "dynamics": {"dynamics": Dynamics(600.0, 0.1)},
    "lag": {"lag": 2e-3},
    "a transformer": {"transformer": TAU},
    "smooth elements": {"smooth": SmoothSlip([2e-6], [0.5], [4e5])},
}
WIDE["everything"] = {name: part for one in WIDE.values() for name, part in one.items()}


def wide_record(actuator, volts):
    """A noisy record of sines that grow and shrink, begun away from rest."""
    time = np.arange(2400) / 200.0
    size = np.interp(time, [0, 3, 6, 9, 12], [0.6, 1.0, 1.0, 0.5, 0.9])
    voltage = 0.5 * volts * (1 - size * np.cos(2 * np.pi * time))
    y = actuator.simulate(voltage, time=time).displacement + 1e-9 * np.random.default_rng(0).normal(size=time.size)
    return prepare(dehyst.Record(time, voltage + 0.3, y, "wide"))


@pytest.mark.parametrize("parts", WIDE.values(), ids=WIDE)
@pytest.mark.parametrize("size", [1, 113])
@pytest.mark.nightly
def test_a_wider_actuator_played_in_stretches_carries_its_state_on(parts, size):
    plain = plain_records.plant(12)
    actuator = dehyst.Actuator(plain.slip, plain.spring, **parts)
    record = wide_record(actuator, 0.9 * plain_records.VOLTS)
    compared = validation.compare(actuator, record, plain_records.STROKE, datum=0.0, drifting=True)
    ((number, epoch, whole),) = compared.played(actuator)[-1:]
    begin = compared.state_before(actuator, number, epoch), compared.offsets[-1]
    stretches = list(compared.play(actuator, number, slice(epoch.start, epoch.stop), begin, size))
    assert len(stretches) == -(-(epoch.stop - epoch.start) // size)
    for one, other in zip(map(np.concatenate, zip(*stretches, strict=True)), whole, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-11 * np.ptp(other))
    np.testing.assert_allclose(whole[3], whole[2], rtol=0, atol=0.01 * plain_records.STROKE)


def test_an_epoch_without_a_row_has_the_offset_of_the_nearest():
    plain = plain_records.plant(12)
    actuator = dehyst.Actuator(plain.slip, plain.spring, creep=WIDE["creep"]["creep"])
    record = wide_record(actuator, 0.9 * plain_records.VOLTS)
    compared = validation.compare(actuator, record, plain_records.STROKE, datum=0.0, drifting=True)
    assert compared.source.count > 1
    last = compared.source.count - 1
    few = replace(compared, found=replace(compared.found, offsets={last: compared.found.offsets[last]}))
    assert few.offsets == [compared.offsets[last]] * compared.source.count


def test_interpolation_in_blocks_is_interpolation(monkeypatch):
    rng = np.random.default_rng(0)
    x = np.cumsum(rng.uniform(0.5, 1.5, 3000))
    y, asked = np.cumsum(rng.normal(size=3000)), np.clip(x - 7.3, x[0], x[-1])
    one = signals.interpolate(x, y, asked, "pchip")
    monkeypatch.setattr(signals, "_BLOCK", 64)
    np.testing.assert_allclose(signals.interpolate(x, y, asked, "pchip"), one, rtol=1e-12, atol=1e-12)


def test_what_a_long_signal_tells_is_told_from_parts_of_it(monkeypatch):
    rng = np.random.default_rng(0)
    values = np.sin(np.arange(40_000) / 300) + 1e-3 * rng.normal(size=40_000)
    noise, turns = signals.white_noise(values), signals.turning_points(values, 0.1)
    monkeypatch.setattr(signals, "_STRETCH", 1000)
    monkeypatch.setattr(signals, "_BLOCK", 97)
    assert signals.white_noise(values) == pytest.approx(noise, rel=0.05)
    assert signals.white_noise(values) != noise
    np.testing.assert_array_equal(signals.turning_points(values, 0.1), turns)
    assert len(turns) == round(40_000 / 300 / np.pi)


@pytest.mark.parametrize("size", [1, 97])
def test_a_path_is_made_monotone_in_blocks_too(monkeypatch, size):
    record = wide_record(plain_records.plant(12), 0.9 * plain_records.VOLTS).record
    held = replace(record, voltage=np.maximum(record.voltage, 20.0))
    one = denoising.monotone(held).displacement
    monkeypatch.setattr(denoising, "_BLOCK", size)
    np.testing.assert_array_equal(denoising.monotone(held).displacement, one)


def test_a_record_is_not_copied_by_its_slices_but_its_maker_may_go_on_writing():
    y = np.arange(100.0)
    record = dehyst.Record(np.arange(100.0), y, y)
    y[3] = -1
    assert record.voltage[3] == 3
    assert np.shares_memory(record.slice(10, 50).voltage, record.voltage)
    view = y.view()
    view.flags.writeable = False
    other = dehyst.Record(np.arange(100.0), view, view)
    y[4] = -1
    assert other.voltage[4] == 4


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(("samples", "most"), [(250_000, 300), at_night(1_000_000, 512)])
def test_a_million_samples_take_half_a_gigabyte_at_most(samples, most):
    script = places.BENCHMARKS / "size.py"
    command = [sys.executable, script, str(samples), "l1", "maxwell_slip"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found["peak_MiB"] < most
    assert abs(found["gap"]) < 1e-6
    rows = int(re.search(r"of (\d+) rows", found["status"])[1])
    assert 0.95 * samples < rows < samples
    assert found["rms_percent"] < 0.2


def test_a_delay_is_found_in_every_so_many_th_sample_too(monkeypatch):
    rng = np.random.default_rng(0)
    made = plain_records.loops(plain_records.plant(12), plain_records.THREE_LOOPS, samples=400)
    late = np.interp(made.time - 0.03, made.time, made.displacement)
    record = dehyst.Record(made.time, made.voltage, late + 1e-9 * rng.normal(size=len(made)), "late")
    fine = dehyst.identify(record, elements=12).options["delay_s"]
    monkeypatch.setattr(sys.modules["dehyst.identification.run"], "_SEARCH_CYCLE", 200)
    coarse = dehyst.identify(record, elements=12).options["delay_s"]
    assert fine == pytest.approx(0.03, abs=0.1 / 200)
    assert coarse == pytest.approx(0.03, abs=0.3 / 200)
    assert coarse != fine


@pytest.mark.parametrize(
    ("cycle", "most", "step"), [(10**9, 10**9, 1), (100, 10**9, 4), (10**9, 1000, 1), (100, 100, 4)]
)
def test_coarser_records_are_every_so_many_th_sample_of_a_beginning(cycle, most, step):
    prepared = prepare(plain_records.loops(plain_records.plant(12), (0, *[1, 0] * 6), samples=200))
    few, third = prepared.coarser(cycle, most), prepared.record.cycles()[2].stop
    stop = min(len(prepared.record), max(most * step, third))
    np.testing.assert_array_equal(few.record.voltage, prepared.record.voltage[:stop:step])
    assert [len(piece) for piece in few.pieces] == [len(few.record)]
