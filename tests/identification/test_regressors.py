"""Which samples count: the rule of the running range, on actuators whose carts stand anywhere at the start."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst import Record
from dehyst.identification.regressors import RowSource, epochs, internal_states
from dehyst.identification.structure import Grid

RANDOM_RECORDS = 300


def random_record(seed):
    """A random actuator on a random path, its carts wherever they can be."""
    rng = np.random.default_rng(seed)
    actuator = plain_records.plant(int(rng.integers(1, 25)), seed=seed)
    y = plain_records.path(rng.uniform(0, 1, int(rng.integers(5, 30))), int(rng.integers(20, 60)))
    return actuator, plain_records.record(actuator, y, state=plain_records.any_state(actuator, float(y[0]), seed))


def collect(pieces, breakaway, noise, step=1):
    """Every row of pieces, or each of a step, for elements of these thresholds, and their epochs."""
    empty = np.zeros(0)
    source = RowSource.of(pieces, Grid(breakaway, empty, empty, empty), noise)
    return source.thinned(max(1, len(source) // step)), source.epochs


def rows_of(actuator, record, noise=0.0):
    rows, (found,) = collect([(0, record)], actuator.slip.breakaway, [noise])
    return rows, found


def rest(actuator, rows):
    """Voltage less what the model says of each row, which an epoch's constant has to make up for."""
    return rows.voltage - rows.elongation @ actuator.slip.stiffness - actuator.spring(rows.displacement)


def growth(record, epoch):
    """By how much [m] an epoch leaves the range seen before it; the tolerance on the voltage allows a little."""
    before, during = record.displacement[: epoch.start], record.displacement[epoch.start : epoch.stop]
    return max(before.min() - during.min(), 0.0) + max(during.max() - before.max(), 0.0)


def test_one_constant_per_epoch_is_exact_for_any_cart_positions():
    strict = 0
    for seed in range(RANDOM_RECORDS):
        actuator, record = random_record(seed)
        rows, found = rows_of(actuator, record)
        for number, epoch in enumerate(found):
            constants = rest(actuator, rows)[rows.epoch == number]
            # Growth below 0.2 % of the voltage range counts as noise; it drags a standing cart by no more than itself.
            grown = growth(record, epoch)
            strict += grown == 0
            dragged = grown * float(actuator.slip.stiffness.sum())
            assert np.ptp(constants) <= 1e-9 * np.ptp(record.voltage) + dragged, f"seed {seed}, epoch {number}"
            assert grown <= 0.01 * np.ptp(record.displacement), f"seed {seed}, epoch {number}"
    assert strict > 3 * RANDOM_RECORDS


def test_thinned_rows_are_every_third_of_all():
    pieces, breakaway = [(k, random_record(k)[1]) for k in range(4)], 1e-6 * np.arange(1, 9)
    (every, spans), (third, _) = (collect(pieces, breakaway, [0.0] * 4, step) for step in (1, 3))
    assert {(epoch.stop - epoch.start) % 3 for own in spans for epoch in own} == {0, 1, 2}
    for name, column in vars(every).items():
        np.testing.assert_array_equal(getattr(third, name), column[::3])


def test_a_record_whose_range_always_grows_has_no_row():
    actuator = plain_records.plant(5)
    record = plain_records.loops(actuator, (0.0, 1.0), state=actuator.relaxed())
    rows, found = rows_of(actuator, record)
    assert (len(rows), found) == (0, [])
    assert rows.elongation.shape == (0, 5)


def test_carts_that_do_not_move_add_the_displacement_from_the_middle():
    actuator = plain_records.plant(10)
    record = plain_records.loops(
        actuator, (0.3, 0.6, 0.3, 0.6, 0.3), state=plain_records.any_state(actuator, 0.3 * plain_records.STROKE, 2)
    )
    rows, found = rows_of(actuator, record)
    for number, epoch in enumerate(found):
        mine = rows.epoch == number
        unknown = 2 * actuator.slip.breakaway > epoch.reach
        assert unknown.any()
        expected = np.repeat(rows.displacement[mine, None] - epoch.middle, unknown.sum(), axis=1)
        np.testing.assert_allclose(rows.elongation[mine][:, unknown], expected, atol=1e-20)
        assert rows.stuck[mine][:, unknown].all()


@pytest.mark.parametrize("level", [1e-5, 1e-4, 1e-3])
def test_noise_on_the_voltage_makes_no_epochs(level):
    actuator = plain_records.plant(10)
    clean = plain_records.loops(actuator, plain_records.MAJOR * 8)
    noise = level * np.ptp(clean.voltage) * np.random.default_rng(0).normal(size=len(clean))
    noisy = Record(clean.time, clean.voltage + noise, clean.displacement, "noisy voltage")
    assert [len(epochs(clean)), len(epochs(noisy))] == [1, 1]
    assert epochs(noisy)[0].stop == len(noisy)
    assert epochs(noisy)[0].start <= epochs(clean)[0].start + 100


def test_drift_of_the_displacement_makes_no_epochs():
    actuator = plain_records.plant(10)
    clean = plain_records.loops(actuator, plain_records.MAJOR * 8)
    creeping = clean.displacement + 0.05 * plain_records.STROKE * np.log10(1 + clean.time)
    assert len(epochs(Record(clean.time, clean.voltage, creeping, "creeping"))) == 1


def test_noise_of_the_sensor_reduces_the_reach():
    record = plain_records.loops(plain_records.plant(10), plain_records.MAJOR)
    (clean,), (cut,) = epochs(record), epochs(record, 1e-8)
    assert clean.reach == pytest.approx(plain_records.STROKE, rel=1e-12)
    assert cut.reach == pytest.approx(plain_records.STROKE - 4e-8, rel=1e-12)
    assert clean.middle == pytest.approx(0.5 * plain_records.STROKE, rel=1e-12)


@pytest.mark.parametrize("name", ["plain", "smooth", "all"])
@pytest.mark.parametrize("cut", [0, 200])
def test_internal_states_agree_with_those_of_the_model(name, cut):
    plant = wide.plant(wide.STRUCTURES[name], path=wide.wandering(6, hold=8))
    record = plant.record()
    # Uneven steps of time, too.
    time = record.time + np.where(np.arange(len(record)) % 50 > 40, 1e-3, 0.0)
    record = replace(record, time=time)
    lead, piece = (record[:cut], record[cut:]) if cut else (None, record)
    whole, found = wide.moved_along(plant.grid, piece, lead), internal_states(plant.grid, piece, lead)
    assert found.shape == whole.shape
    np.testing.assert_allclose(found, whole, rtol=1e-9, atol=1e-15)
