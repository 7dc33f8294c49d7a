"""Wave tables: the cycle repeats itself, the model follows the path when homing, start-up and cycles are played."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plain_records
import pytest

from dehyst import DisplacementCreep, Dynamics, RecordError
from dehyst.control import wave_table
from dehyst.model import GradedSlip, SmoothSlip, Transformer, needs_time, standing, turned, voltages_of
from dehyst.waveforms import Triangle

UM = 1e-6
PLAIN = replace(plain_records.plant(10), limits=(-50.0, 250.0))
CREEP = DisplacementCreep([0.05, 0.4], [0.02, 0.03])
SMOOTH = SmoothSlip([1e-6, 4e-6, 9e-6], [1.0, 0.5, 0.75], [2e6, 1e6, 5e5])
GRADED = GradedSlip(PLAIN.slip.breakaway, [0, 8e-6, 16e-6], np.outer(PLAIN.slip.stiffness, [1, 0.9]))
ACTUATORS = {
    "plain": PLAIN,
    "graded": replace(PLAIN, slip=GRADED),
    "transformer": replace(PLAIN, transformer=Transformer([-50, 100, 250], [-50, 110, 250])),
    "creep": replace(PLAIN, displacement_creep=CREEP),
    "smooth": replace(PLAIN, smooth=SMOOTH),
    "creep and smooth": replace(PLAIN, displacement_creep=CREEP, smooth=SMOOTH),
}
TRIANGLE = Triangle(2 * UM, 12 * UM, 10, turns=0.2)
SCANS = {"triangle": TRIANGLE, "sine": Triangle(2 * UM, 12 * UM, 5, turns=1.0)}


def played(table, cycles):
    """The plan but for its last sample, and then more cycles; `steady`: rows of the cycle."""
    plan, cycle, more = table.plan, table.cycle, cycles - 1
    names = ("voltage", "displacement", "expected")
    rows = {name: np.append(getattr(plan, name)[:-1], np.tile(getattr(cycle, name), more)) for name in names}
    time = np.append(plan.time[:-1], plan.time[-1] + np.arange(more * len(cycle)) / table.sample_rate)
    steady = np.arange(time.size) >= time.size - cycles * len(cycle)
    phase = np.append(plan.phase[:-1], np.full(more * len(cycle), 2))
    return SimpleNamespace(time=time, phase=phase, steady=steady, **rows)


def simulated(actuator, rows, state=None):
    """What the actuator does with all that is played, by default after slow loops."""
    start = standing(actuator, float(rows.voltage[0]), voltages_of(actuator)) if state is None else state
    return actuator.simulate(rows.voltage, time=rows.time, state=start).displacement


def unknown(table):
    return 0.0 if table.plan.homing is None else table.plan.homing.spread


def strokes(scan, axis="x"):
    low, high = scan.path(axis).range
    return high - low


@pytest.mark.parametrize("homed", [True, False])
@pytest.mark.parametrize("scan", SCANS)
@pytest.mark.parametrize("name", ACTUATORS)
def test_a_repeated_table_follows_the_path(name, scan, homed):
    actuator, state = ACTUATORS[name], None if homed else ACTUATORS[name].relaxed(20.0)
    table = wave_table(actuator, SCANS[scan].path(), start=state)
    stroke = strokes(SCANS[scan])
    assert (table.plan.homing is not None) == homed
    assert not table.plan.clamped.any() and table.error <= 1e-4 * stroke
    rows = played(table, 80 if needs_time(actuator) or actuator.smooth else 3)
    made = simulated(actuator, rows, state)
    miss = np.abs(made - rows.displacement)
    assert miss[rows.steady].max() <= 1.05 * table.error + unknown(table) + 1e-9 * stroke
    if not homed:
        assert miss[~rows.steady].max() <= 1e-9 * stroke


@pytest.mark.parametrize("scan", SCANS)
def test_with_dynamics_a_table_follows_the_path_to_the_discretisation(scan):
    actuator = replace(PLAIN, dynamics=Dynamics(1000, 0.1, 2e6))
    errors = []
    for times in (1, 4):
        finer = replace(SCANS[scan], sample_rate=times * SCANS[scan].rate)
        table = wave_table(actuator, finer.path(), start=actuator.relaxed(20.0))
        rows = played(table, 4)
        made = simulated(actuator, rows, actuator.relaxed(20.0))
        size = len(table.cycle)
        errors.append(np.abs(made - rows.displacement)[-size:].max() / strokes(finer))
        assert np.abs(made - rows.expected)[-size:].max() <= 1e-7 * strokes(finer)
    assert errors[0] <= 2e-4
    # The error falls with the distance of samples squared; with the distance where an acceleration jumps.
    assert errors[1] <= errors[0] / (3 if scan == "triangle" else 8)


def test_a_table_that_is_not_settled_states_a_sufficient_start_up():
    slow = replace(PLAIN, displacement_creep=DisplacementCreep([5.0], [0.2]))
    table = wave_table(slow, TRIANGLE.path(), start=slow.relaxed(20.0), cycles=2)
    assert table.cycles == 2 and not table.settled
    assert "after 2 cycles" in table.warnings[-1]
    needed = int(table.warnings[-1].split("give a start-up of ")[1].split()[0])
    enough = wave_table(slow, TRIANGLE.path(), start=slow.relaxed(20.0), cycles=needed)
    assert enough.error <= 1.01e-4 * strokes(TRIANGLE)
    found = wave_table(slow, TRIANGLE.path(), start=slow.relaxed(20.0))
    assert found.settled and enough.tolerance == pytest.approx(1e-4 * strokes(TRIANGLE))
    assert 0.8 * needed < found.cycles <= needed


def test_a_scan_from_the_present_displacement_needs_no_way():
    table = wave_table(PLAIN, TRIANGLE.path(), start=turned(PLAIN, 2 * UM, rising=False))
    assert table.plan.voltage.size == (table.cycles + 1) * TRIANGLE.samples + 1 and not table.plan.first


@pytest.mark.parametrize("name", ["plain", "creep"])
@pytest.mark.parametrize("limits, slew", [((0.0, 120.0), None), ((-50.0, 250.0), 2500.0)])
def test_an_unreachable_scan_is_clamped_with_a_warning(name, limits, slew):
    actuator = ACTUATORS[name]
    table = wave_table(
        actuator, TRIANGLE.path(), limits=limits, slew_rate=slew, start=actuator.relaxed(20.0), cycles=12
    )
    assert table.plan.clamped.any() and table.plan.failure and table.cycles == 12
    rows = played(table, 5)
    assert limits[0] <= rows.voltage.min() and rows.voltage.max() <= limits[1]
    steps = np.abs(np.diff(rows.voltage)) * table.sample_rate
    assert slew is None or steps.max() <= slew * (1 + 1e-6)
    made, size = simulated(actuator, rows, actuator.relaxed(20.0)), len(table.cycle)
    off = np.abs(made - rows.expected)
    assert off[: -5 * size].max() <= 0.1 * table.tolerance
    assert off[-5 * size : -4 * size].max() <= 1.0001 * table.error + 1e-12 * strokes(TRIANGLE)
    assert off.max() <= 4 * table.error + 1e-12 * strokes(TRIANGLE)


def test_a_long_homing_has_a_lower_sample_rate():
    slow = replace(PLAIN, displacement_creep=DisplacementCreep([5.0, 64.0], [0.02, 0.02]))
    table = wave_table(slow, TRIANGLE.path())
    homing = table.plan.homing.played
    assert homing.duration * table.sample_rate > 8e5
    rows = played(table, 2)
    assert (rows.phase == 0).sum() < 5e4
    assert np.diff(rows.time).min() > 0.99 / table.sample_rate
    whole = np.interp(homing.time, rows.time, rows.voltage)
    assert np.abs(whole - homing.voltage)[:-1].max() <= 1e-9
    made = simulated(slow, rows)
    assert np.abs(made - rows.expected)[rows.phase == 0].max() <= 1e-5 * strokes(TRIANGLE)
    assert np.abs(made - rows.displacement)[-800:].max() <= table.error + unknown(table) + 1e-4 * strokes(TRIANGLE)


@pytest.mark.parametrize(
    ("name", "bad", "most"),
    [("cycles", -1, "12500"), ("cycles", 10**7, "12500"), ("tolerance", 0.0, "1e-12"), ("present", 900.0, "250 V")],
)
def test_impossible_tables_are_refused(name, bad, most):
    start = None if name == "present" else PLAIN.relaxed(20.0)
    with pytest.raises(RecordError, match=most) as caught:
        wave_table(PLAIN, TRIANGLE.path(), **{"start": start, name: bad})
    assert caught.value.argument == name


def test_start_up_lasts_until_creep_settles_or_the_file_is_full():
    slow = replace(PLAIN, displacement_creep=DisplacementCreep([500.0], [0.02]))
    table = wave_table(slow, TRIANGLE.path(), start=slow.relaxed(20.0))
    assert (table.settled, table.plan.clamped.any()) == (False, False)
    assert table.warnings[-1].endswith("no start-up is long enough")
    slow = replace(PLAIN, displacement_creep=DisplacementCreep([50.0], [0.02]))
    table = wave_table(slow, TRIANGLE.path(), start=slow.relaxed(20.0))
    assert 1000 < table.cycles < 3000 and table.settled
