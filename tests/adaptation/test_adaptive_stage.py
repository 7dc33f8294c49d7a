"""Coupled axes that learn: each from what its own actuator has moved."""

from dataclasses import replace

import numpy as np
import pytest
from ageing_plant import PERIOD, PLANT, STROKE, TURNS, aged, cycle

from dehyst import ModelError, Stage, StageCompensator, Thermal
from dehyst.adaptation import AdaptiveStageCompensator

COUPLING = np.array([[1.0, 0.08], [-0.05, 1.0]])
STAGE = Stage((PLANT, PLANT), COUPLING, ("x", "y"))
# Wide enough for the aged plant.
LIMITS = (-60.0, 300.0)
START = PLANT.turned(STROKE * TURNS[-1], rising=False)


def lived(loop, cycles, ages, sensor=lambda y, k: y):
    """Play cycles of both actuators; return the largest error of each cycle and axis, as a part of the stroke."""
    states, y, errors, coupling = [START, START], None, [], loop.stage.coupling
    for k in range(cycles):
        error = []
        for wanted in np.column_stack([cycle(k), cycle(k + 100)]) @ coupling.T:
            seen = () if isinstance(loop, StageCompensator) else (None if y is None else sensor(y, k),)
            moved = []
            for j, voltage in enumerate(loop.step(wanted, *seen).tolist()):
                motion = aged(ages[j] * min(1.0, k / 6)).simulate([voltage], state=states[j])
                states[j] = motion.state
                moved.append(float(motion.displacement[0]))
            y = coupling @ moved
            error.append(np.abs(y - wanted) / STROKE)
        errors.append(np.max(error, axis=0))
    return np.array(errors)


def loop_of(kind, stage=STAGE, **options):
    return kind(stage, **options, period=PERIOD, limits=[LIMITS, LIMITS], states=[START, START])


def test_each_axis_learns_its_own_ageing():
    frozen, loop = (
        lived(loop_of(StageCompensator), 16, (1.0, 0.0)),
        loop_of(AdaptiveStageCompensator, memory=3.0, zero_drifts=False),
    )
    errors = lived(loop, 16, (1.0, 0.0))
    assert np.all(errors[-5:].mean(axis=0) < 0.25 * frozen[-5:].mean(axis=0))
    alone = loop_of(
        AdaptiveStageCompensator, Stage((PLANT, PLANT), np.eye(2), ("x", "y")), memory=3.0, zero_drifts=False
    )
    lived(alone, 16, (1.0, 0.0))
    for one, other in zip(loop.axes, alone.axes, strict=True):
        learnt = [[axis.log[-1].slope, axis.log[-1].friction] for axis in (one, other)]
        assert learnt[0] == pytest.approx(learnt[1], rel=1e-6)
    stage = loop.stage
    assert np.array_equal(stage.coupling, COUPLING)
    assert stage.actuators[0].slip.stiffness.sum() > 1.2 * PLANT.slip.stiffness.sum()


def test_a_sensor_that_fails_stops_the_learning_of_all_axes():
    loop = loop_of(AdaptiveStageCompensator)
    frozen = lived(loop_of(StageCompensator), 8, (1.0, 1.0))
    assert np.array_equal(lived(loop, 8, (1.0, 1.0), lambda y, k: [y[0], np.nan]), frozen)
    assert not any(one.used for axis in loop.axes for one in axis.log)


def test_its_memory_is_kept_and_a_wrong_one_refused():
    loop, again = (loop_of(AdaptiveStageCompensator) for _ in range(2))
    lived(loop, 12, (1.0, 0.5))
    again.restore(loop.snapshot())
    path = [COUPLING @ np.array([one, one]) for one in cycle(7)[:20]]
    assert [again.step(y, y).tolist() for y in path] == [loop.step(y, y).tolist() for y in path]
    with pytest.raises(ModelError, match="one an axis"):
        again.restore(loop.snapshot()[:1])
    with pytest.raises(ModelError, match="one an axis"):
        again.step([1e-6, 1e-6], [1e-6])


def test_what_is_no_displacement_of_each_axis_is_refused():
    """A mask is not dropped, nor a shape; the memory is that of before."""
    loop, wanted = loop_of(AdaptiveStageCompensator), [0.4 * STROKE, 0.4 * STROKE]
    loop.step(wanted, wanted)
    before = [one.as_dict() for one in loop.snapshot()]
    for measured in (np.ma.array(wanted, mask=[True, False]), ["1", "2"], [True, False], [wanted], 1e-6):
        with pytest.raises(ModelError) as caught:
            loop.step(wanted, measured)
        assert caught.value.argument == "measured"
    assert [one.as_dict() for one in loop.snapshot()] == before


def test_axes_learn_what_their_actuators_move_at_the_reference_temperature():
    """The same ageing as at the reference, though each axis moves less and its sensor shifts."""
    thermals, degrees = (Thermal(-4e-3, 2e-8, 20.0), Thermal(-2e-3, 0.0, 22.0)), np.array([35.0, 30.0])
    warm = replace(STAGE, actuators=tuple(replace(PLANT, thermal=one) for one in thermals))
    scales = [one.scale(float(now), 1) for one, now in zip(thermals, degrees, strict=True)]
    gains, offsets = (np.array([float(scale[part][0]) for scale in scales]) for part in (0, 1))
    options = {"memory": 3.0, "zero_drifts": False}
    loops = [loop_of(AdaptiveStageCompensator, one, **options) for one in (STAGE, warm)]
    states, y = [START, START], np.full(2, np.nan)
    for k in range(12):
        for wanted in np.column_stack([cycle(k), cycle(k + 100)]):
            cold = loops[0].step(COUPLING @ wanted, COUPLING @ y)
            hot = loops[1].step(COUPLING @ (offsets + gains * wanted), COUPLING @ (offsets + gains * y), degrees)
            np.testing.assert_allclose(hot, cold, rtol=0, atol=1e-6)
            for j, voltage in enumerate(cold.tolist()):
                motion = aged(min(1.0, k / 6)).simulate([voltage], state=states[j])
                states[j], y[j] = motion.state, motion.displacement[0]
    for one, other in zip(*(loop.axes for loop in loops), strict=True):
        assert any(exchange.used for exchange in one.log)
        assert [exchange.used for exchange in one.log] == [exchange.used for exchange in other.log]
    assert [axis.actuator.thermal for axis in loops[1].axes] == list(thermals)
