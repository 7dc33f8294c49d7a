"""Huge, tiny and damaged numbers: a clear error or a finite answer, never a crash; voltages stay in their limits."""

import json
import subprocess
import sys
import threading
from dataclasses import replace

import numpy as np
import pytest
import strategies

from dehyst import Actuator, Compensator, DisplacementCreep, Dynamics, MaxwellSlip, ModelError, Spring
from dehyst._validation import FARTHEST, MOST

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")

UNIFORM = MaxwellSlip([3e-7, 6e-7, 9e-7], [1.7e6, 2.9e6, 3.2e6])
SPRING = Spring([-1e-6, 0.0, 4e-7, 6e-7], [-10.0, -4.3, -1.9, 0.3])
PLAIN = Actuator(UNIFORM, SPRING, limits=(-10.0, 0.3))
# A curve that began at -4.8e143 m made the place of a cell in its table negative.
BROKEN_SPRING = {"displacement_m": [-4.8e143, -5e-9, 4e-7, 6e-7], "voltage_V": [-10.0, -4.3, -1.9, 0.3]}


def survives(program, *arguments):
    """Run Python in a process of its own, which must not crash."""
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, f"status {done.returncode}: {done.stderr[-800:]}"
    return done.stdout.strip()


def test_a_model_whose_spring_reaches_across_all_exponents_is_refused(tmp_path):
    data = {**PLAIN.as_dict(), "spring": BROKEN_SPRING}
    path = tmp_path / "model.json"
    path.write_text(json.dumps(data))
    program = """
import sys, numpy, dehyst
try:
    actuator = dehyst.Actuator.load(sys.argv[1])
except dehyst.ModelError as error:
    print(error)
else:
    actuator.simulate(numpy.linspace(-10, 0.3, 200))
"""
    assert "spring displacement: got 4.8e+143, which cannot be computed with" in survives(program, str(path))


@pytest.mark.parametrize("stack", [True, False])
def test_huge_voltages_end_in_a_clear_error_and_no_crash(stack):
    program = f"""
import sys, numpy, dehyst
sys.path.insert(0, {str(strategies.__file__.rsplit("/", 1)[0])!r})
import strategies
for seed in range(60):
    rng = numpy.random.default_rng(seed)
    actuator = strategies.make_actuator(seed, int(rng.integers(1, 12)), int(rng.integers(2, 8)), True)
    size = 10 ** (rng.uniform(0, 290, 60) * (rng.random(60) < 0.5))
    voltage = strategies.volts_of(actuator) * rng.uniform(-1, 1, 60) * size
    try:
        assert numpy.isfinite(actuator.simulate(voltage, stack={stack}, extrapolate=True).displacement).all()
    except dehyst.ModelError as error:
        assert "displacement: value" in str(error), error
print("ok")
"""
    assert survives(program) == "ok"


def test_a_voltage_of_1e281_is_refused():
    with pytest.raises(ModelError, match="displacement: value 1 would"):
        PLAIN.simulate([0.0, 1e281, 0.0], extrapolate=True)


def test_a_displacement_of_which_no_finite_voltage_comes_is_refused():
    with pytest.raises(ModelError, match="voltage: value 1 would be"):
        PLAIN.compensate([0.0, 1e305], extrapolate=True)


@pytest.mark.parametrize(("limits", "delay"), [((-1e308, 1e308), 0.0), (None, 1.7e308)])
def test_limits_and_delays_whose_difference_overflows_are_refused(limits, delay):
    with pytest.raises(ModelError, match="computed"):
        Actuator(UNIFORM, SPRING, limits=limits, delay=delay)


def test_steps_of_time_without_end_are_refused():
    creeping = replace(PLAIN, displacement_creep=DisplacementCreep([1.0], [0.01]))
    with pytest.raises(ModelError, match=r"time: steps \[s\]"):
        creeping.simulate([0.0, -1.0], time=[-1.7e308, 1.7e308])
    swinging = replace(PLAIN, dynamics=Dynamics(1.6e3, 0.1))
    with pytest.raises(ModelError, match=r"step of 1e\+20"):
        swinging.simulate([0.0, -1.0], time=[0.0, 1e20])
    with pytest.raises(ModelError, match="damping of 1e"):
        replace(PLAIN, dynamics=Dynamics(1.6e3, 1e25)).simulate([0.0, -1.0], time=[0.0, 1e-3])


def test_a_load_too_large_is_refused():
    loaded = replace(PLAIN, load_stiffness=1e-20)
    with pytest.raises(ModelError, match="over load_stiffness"):
        loaded.simulate([0.0, -1.0], load=[0.0, 1e300])


def test_a_state_whose_voltage_is_no_number_begins_no_loop():
    far = PLAIN.relaxed().shifted(1e305)
    with pytest.raises(ModelError, match="voltage of the state"):
        PLAIN.voltage(far)
    with pytest.raises(ModelError):
        Compensator(PLAIN, state=far)


def test_a_loop_is_not_begun_anew_while_it_runs():
    """That freed the memory that the run worked in."""
    compensator = Compensator(PLAIN, (-10.0, 0.3))
    compensator.step(-1e-6)
    snapshot = compensator.snapshot()
    run = threading.Thread(target=compensator._loop.run, args=(np.full(5_000_000, -1e-6),))
    refusals = 0
    run.start()
    while run.is_alive():
        try:
            compensator.restore(snapshot)
        except RuntimeError as error:
            assert "another thread" in str(error)
            refusals += 1
    run.join()
    assert refusals > 0


def test_the_farthest_place_leaves_room():
    """A model that is refused nowhere computes finite voltages at the farthest place."""
    actuator = Actuator(UNIFORM, Spring([0.0, 1.0], [0.0, MOST]))
    assert np.isfinite(actuator.compensate([0.5 * FARTHEST, -0.5 * FARTHEST], extrapolate=True).voltage).all()
