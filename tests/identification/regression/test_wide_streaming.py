"""Wider structures in blocks: what is moved beside carts, and the optimum of rows that never exist all at once."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import places
import pytest
import structured_records as wide

from dehyst.identification.preprocessing import regressors
from dehyst.identification.preprocessing.regressors import RowSource, internal_states
from dehyst.identification.solvers.program import NORMS
from examples import at_night

ORDER = {"l1": 1, "l2": 2}


@pytest.mark.parametrize("size", [1, 7, 1000])
@pytest.mark.parametrize("name", ["plain", "creep", "smooth", "all"])
@pytest.mark.parametrize("cut", [0, 200])
def test_what_moves_beside_carts_is_the_same_in_blocks(monkeypatch, name, size, cut):
    plant = wide.plant(wide.STRUCTURES[name], path=wide.wandering(6, hold=8))
    record = plant.record()
    # Uneven steps of time, too.
    time = record.time + np.where(np.arange(len(record)) % 50 > 40, 1e-3, 0.0)
    record = replace(record, time=time)
    lead, piece = (record.slice(0, cut), record.slice(cut, len(record))) if cut else (None, record)
    whole = wide.moved_along(plant.grid, piece, lead)
    blocks = list(internal_states(plant.grid, piece, lead, size))
    assert blocks[0].shape[1] == whole.shape[1]
    assert {len(block) for block in blocks[:-1]} <= {size}
    np.testing.assert_allclose(np.vstack(blocks), whole, rtol=1e-9, atol=1e-15)


def streams(name, most, strained=()):
    """All rows of two noisy records of one actuator, `most` of them in memory."""
    plant = wide.plant(wide.STRUCTURES[name], path=wide.wandering(24))
    records = [plant.record(noise=2e-9, seed=seed) for seed in (0, 1)]
    pieces = [(q, one, np.zeros(len(one))) for q, one in enumerate(records)]
    source = RowSource.of(pieces, plant.grid, [0.0, 0.0])
    whole = wide.regression(plant.grid, records, strained=strained)
    return plant, replace(whole, rows=source.thinned(most), source=source)


@pytest.mark.parametrize("norm", NORMS)
@pytest.mark.parametrize("name", ["creep", "graded", "all"])
def test_a_stream_has_the_optimum_of_the_rows_in_memory(monkeypatch, name, norm):
    strained = (1,) if name == "creep" else ()
    _, memory = streams(name, 10**9, strained)
    assert memory.whole
    monkeypatch.setattr(regressors, "_BLOCK", 211)
    _, streamed = streams(name, 400, strained)
    assert not streamed.whole
    one, other = memory.fit_weighted(norm), streamed.fit_weighted(norm)
    assert other.solution.optimal
    assert abs(other.solution.gap) < 1e-6
    assert other.offsets.keys() == one.offsets.keys()
    weights = 1 / memory.slope(memory.fit("l2"))

    def cost(found):
        return np.linalg.norm(memory.residual(found) * weights, ORDER[norm])

    assert cost(other) == pytest.approx(cost(one), rel=1e-5)


def test_starts_that_some_blocks_have_forgotten_are_columns_of_all(monkeypatch):
    """A start fades: were its column to end where a block finds it small, rows would not belong to one program."""
    monkeypatch.setattr(regressors, "_BLOCK", 50)
    _, streamed = streams("creep", 300, (0, 1))
    _, memory = streams("creep", 10**9, (0, 1))
    one, other = memory.fit_weighted("l2"), streamed.fit_weighted("l2")
    for q in (0, 1):
        np.testing.assert_allclose(other.starts[q], one.starts[q], rtol=1e-4, atol=1e-6 * np.ptp(memory.grid.knots))


def test_an_epoch_of_which_no_row_is_in_memory_has_its_constant():
    _, memory = streams("transformer", 10**9)
    _, streamed = streams("transformer", 3)
    assert len(streamed.rows) < streamed.source.count + 4
    assert streamed.fit_weighted("l2").offsets.keys() == memory.fit_weighted("l2").offsets.keys()


@pytest.mark.slow
@pytest.mark.parametrize(("samples", "most"), [at_night(250_000, 256), at_night(1_000_000, 512)])
def test_a_million_samples_of_a_wider_structure_take_half_a_gigabyte_at_most(samples, most):
    """A quarter of them takes half of it: blocks are as large."""
    script = places.BENCHMARKS / "size.py"
    command = [sys.executable, script, str(samples), "l1", "wide"]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    assert found["peak_MiB"] < most
    assert abs(found["gap"]) < 1e-6
    assert found["rms_percent"] < 0.2
