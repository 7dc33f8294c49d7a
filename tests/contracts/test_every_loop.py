"""What every loop keeps, one actuator's, a stage's and a bank's: whatever is refused or only offered moves nothing."""

import math
import warnings
from dataclasses import replace

import numpy as np
import plain_records
import pytest
import structured_records as wide

from dehyst import Bank, ClampWarning, Compensator, DisplacementCreep, Dynamics, ModelError, Stage
from dehyst.model import turned

PLANT = plain_records.plant(10, seed=4)
CREEP = DisplacementCreep([0.05, 5.0], [0.03, 0.03])
ALL = wide.plant(wide.STRUCTURES["all"], seed=3).actuator
KINDS = {
    "plain": PLANT,
    "all": ALL,
    "all that moves": replace(PLANT, dynamics=Dynamics(30, 0.03, 2e6), lag=3e-3, displacement_creep=CREEP),
    "stage": Stage((PLANT, ALL), [[1.0, 0.04], [0.03, 1.0]]),
    "bank": [PLANT, ALL],
}


def loop_of(kind):
    """A loop after a step to the middle, and displacements of a step and far beyond the reach of its first axis."""
    model, options = KINDS[kind], {"slew_rate": 1e5, "period": 1e-3}
    axes = list(getattr(model, "actuators", model if kind == "bank" else [model]))
    start = [turned(actuator, 0.2 * plain_records.STROKE) for actuator in axes]
    if kind == "bank":
        loop = Bank(model, (0.0, 200.0), states=start, **options)
    else:
        loop = Compensator(model, limits=(0.0, 200.0), state=start if kind == "stage" else start[0], **options)
    near, far = (np.full(len(axes), share * plain_records.STROKE) for share in (0.2, 0.2))
    far[0] = 1.5 * plain_records.STROKE
    return (loop, near, far) if len(axes) > 1 else (loop, float(near[0]), float(far[0]))


def memory(loop):
    return [axis.snapshot() for axis in loop._axes]


def calls_of(loop, near):
    """Each way to want a displacement; the second sample of a path."""
    offers = {} if isinstance(loop, Bank) else {"offer": loop.offer}
    return {"step": loop.step, "run": lambda wanted: loop.run([near, wanted]), **offers}


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e308, "1", None, [1e-6], 1j])
@pytest.mark.parametrize("kind", KINDS)
def test_an_input_that_is_no_number_changes_nothing(kind, bad):
    # The voltage is finite, and is clamped.
    if (kind, bad) == ("plain", 1e308):
        return
    loop, near, _ = loop_of(kind)
    before = memory(loop)
    wrong = bad if isinstance(near, float) else [*near[:-1].tolist(), bad]
    for call in calls_of(loop, near).values():
        with pytest.raises(ModelError, match="displacement"):
            call(wrong)
    if not isinstance(loop, Bank):
        with pytest.raises(ModelError, match="voltage"):
            loop.commit(wrong)
    assert memory(loop) == before


@pytest.mark.parametrize("kind", ["stage", "bank"])
def test_a_wrong_number_of_displacements_changes_nothing(kind):
    loop, near, _ = loop_of(kind)
    before = memory(loop)
    for values in (np.tile(near, (4, 2)), near, np.tile(near, (4, 1)) * 1j):
        with pytest.raises(ModelError):
            loop.run(values)
    with pytest.raises(ModelError):
        loop.step(near[:1])
    assert memory(loop) == before


@pytest.mark.parametrize("kind", KINDS)
def test_a_clamp_warning_as_an_error_changes_nothing(kind):
    loop, near, far = loop_of(kind)
    before = memory(loop)
    for call in calls_of(loop, near).values():
        with pytest.raises(ClampWarning), warnings.catch_warnings():
            warnings.simplefilter("error", ClampWarning)
            call(far)
        assert memory(loop) == before and np.sum(loop.clamps) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert np.any(loop.step(far) != loop.step(near))


@pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "bank"])
def test_an_offer_that_is_not_committed_or_is_refused_changes_nothing(kind):
    (loop, near, far), (other, *_) = loop_of(kind), loop_of(kind)
    for wanted in (near, far, 0.5 * near, near, far, far, far):
        loop.offer(far)
        assert np.array_equal(loop.step(wanted), other.step(wanted))
    assert loop.clamps == other.clamps
    loop.offer(far)
    with pytest.raises(ModelError):
        loop.offer(math.nan * near)
    loop.hold()
    assert loop.clamps == other.clamps
