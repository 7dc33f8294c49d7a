"""The core by itself: a sample that is not a number moves nothing, and it refuses what Python did not."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
import strategies as our

from dehyst import Actuator, Dynamics, MaxwellSlip, ModelError, Spring
from dehyst._native import EMPTY, Core, CoreState, StepCoefficients, slip_elongations
from dehyst.model import SmoothSlip, evaluator_of


def bench(kind, seed):
    """An actuator with the parts that the kind names, its state and pace, and a path long enough to reach the stack."""
    plain = our.make_actuator(seed, 9, 9, uniform=seed % 2 == 0)
    parts = {part: part in kind for part in ("graded", "transformer")}
    actuator = our.make_wider(plain, seed, **parts, creep=False)
    slope, stroke = actuator.spring.slopes.min(), np.ptp(actuator.spring.displacement)
    if "smooth" in kind:
        # Both closings, lengths in proportion to the stroke.
        smooth = SmoothSlip(stroke * np.array([0.03, 0.1, 0.4]), [1.0, 0.5, 0.8], slope * np.array([0.5, 0.3, 0.2]))
        actuator = replace(actuator, smooth=smooth)
    if "mass" in kind:
        actuator = replace(actuator, dynamics=Dynamics(4.8, 0.3, slope))
    model = evaluator_of(actuator)
    state = model.complete_state(our.make_state(plain, seed, "arbitrary"))
    kinds = ("break points", "decay", "jumps", "noisy ramp", "walk")
    path = np.concatenate([our.make_path(plain, state.deformation, seed, k, 200) for k in kinds])
    time = np.arange(path.size) * 0.01
    pace = model._steps(time, path.size)
    # One pace for all, as a harness has it.
    steps = StepCoefficients(np.array([0, path.size]), *(table[-1:] for table in pace[1:]))
    return model, model.core_state(state), steps, path


KINDS = [
    "plain",
    "transformer",
    "graded",
    "graded transformer",
    "smooth",
    "smooth graded transformer",
    "mass",
    "transformer mass",
    "graded mass",
    "smooth graded transformer mass",
]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("stack", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_sample_that_is_not_a_number_moves_nothing(kind, stack, bad):
    model, held, pace, path = bench(kind, 3)
    voltage, _ = model.core.compensate(path[:300], pace._replace(bounds=np.array([0, 300])), held, stack=stack)
    hole = voltage.copy()
    hole[[0, 70, 71, 200]] = bad
    path = path[:300].copy()
    path[[0, 70, 71, 200]] = bad
    pace = pace._replace(bounds=np.array([0, 300]))
    sent, reached = model.core.compensate(path, pace, held, stack=stack)
    came, moved = model.core.simulate(hole, pace, held, stack=stack)
    assert np.isfinite(sent).all()
    assert np.isfinite(came).all()
    for state in (reached, moved):
        assert all(np.isfinite(part).all() for part in state)
    if "mass" not in kind:
        assert came[0] == held.w
        assert came[71] == came[70] == came[69]
        there = np.isfinite(path)
        shorter = pace._replace(bounds=np.array([0, np.count_nonzero(there)]))
        good, end = model.core.compensate(path[there], shorter, held, stack=stack)
        plain_records.assert_close(sent[there], good, 1e-12 * np.ptp(good))
        for first, second in zip(reached, end, strict=True):
            plain_records.assert_close(first, second, 1e-12 * np.ptp(path[there]))


SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
CORE = evaluator_of(Actuator(SLIP, SPRING)).core
KNOTS, VOLTS = SPRING.displacement, SPRING.voltage
ZERO, TWO = np.zeros(1), np.zeros(2)
STEPS = StepCoefficients(np.array([0, 1]), *[np.zeros((1, 0))] * 3)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Core(SLIP.breakaway, ZERO, KNOTS, VOLTS), "different lengths"),
        (lambda: Core(SLIP.breakaway, -SLIP.stiffness, KNOTS, VOLTS), "must be >= 0"),
        (lambda: Core(SLIP.breakaway[::-1], SLIP.stiffness, KNOTS, VOLTS), "strictly increase"),
        (lambda: Core(SLIP.breakaway, np.nan * SLIP.stiffness, KNOTS, VOLTS), "not finite"),
        (lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS, VOLTS[::-1]), "strictly increase"),
        (lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS[:1], VOLTS[:1]), "fewer than two knots"),
        (
            lambda: CORE.compensate(ZERO, STEPS, CoreState(0.0, ZERO, EMPTY, EMPTY)),
            "different lengths",
        ),
        (
            lambda: CORE.simulate(ZERO, STEPS, CoreState(0.0, TWO + 1, EMPTY, EMPTY)),
            "farther from the disp",
        ),
        (lambda: CORE.voltage(CoreState(np.nan, TWO, EMPTY, EMPTY)), "not finite"),
        (lambda: CORE.depth(ZERO, 0.0, TWO + 1), "farther from the displacement"),
        (lambda: CORE.depth(ZERO, 0.0, np.array([1e-6, -2e-6])), "no history from rest"),
        (lambda: slip_elongations(SLIP.breakaway, ZERO, ZERO), "different lengths"),
    ],
)
def test_the_core_itself_refuses_what_python_did_not(make, message):
    with pytest.raises(ModelError, match=message):
        make()
