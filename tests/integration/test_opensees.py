"""An oracle by others: OpenSees' `Parallel` of `ElasticPP` and `Elastic` *is* a Maxwell-slip bank with a linear spring.

It runs in a process of its own: it prints a banner when it ends, and a library it lacks may abort the interpreter.
"""

import json
import subprocess
import sys

import numpy as np
import pytest

from dehyst import Actuator, MaxwellSlip, Spring

MICRO = 1e6
DRIVER = r"""
import json, sys
try:
    import openseespy.opensees as ops
except (ImportError, OSError, RuntimeError) as error:
    print(json.dumps({"missing": f"{type(error).__name__}: {error}"}))
    sys.exit()
case = json.load(sys.stdin)
elements = list(zip(case["stiffness"], case["breakaway"]))
ops.wipe()
ops.model("basic", "-ndm", 1, "-ndf", 1)
ops.uniaxialMaterial("Elastic", 1, case["spring"])
for tag, (stiffness, breakaway) in enumerate(elements, 2):
    ops.uniaxialMaterial("ElasticPP", tag, stiffness, breakaway)
bank = len(elements) + 2
ops.uniaxialMaterial("Parallel", bank, *range(1, bank))
ops.testUniaxialMaterial(bank)
stress = []
for strain in case["path"]:
    ops.setStrain(strain)
    stress.append(ops.getStress())
print(json.dumps({"stress": stress, "version": ops.version()}))
"""


def opensees(**case):
    """Drive the bank through OpenSees; skip where it is not installed or does not load."""
    command = [sys.executable, "-c", DRIVER]
    done = subprocess.run(command, input=json.dumps(case), capture_output=True, text=True, check=False, timeout=60)
    lines = [line for line in done.stdout.splitlines() if line.startswith("{")]
    answer = json.loads(lines[-1]) if lines else {"missing": f"status {done.returncode}: {done.stderr.strip()}"}
    if "missing" in answer:
        pytest.skip(f"openseespy does not load here ({answer['missing']})")
    return np.array(answer["stress"])


def paths():
    rng = np.random.default_rng(2006)
    turns = np.arange(400)
    return {
        "major loop": 15 * np.sin(np.linspace(0, 6 * np.pi, 600)),
        "decay": 15 * (1 - turns / 400) * np.where(turns % 2, -1, 1),
        "walk": np.cumsum(rng.normal(scale=2, size=1000)),
        "small steps": np.cumsum(rng.normal(scale=0.05, size=1000)),
    }


@pytest.mark.parametrize("kind", list(paths()))
@pytest.mark.parametrize("uniform", [True, False])
def test_voltages_are_those_of_opensees(uniform, kind):
    """In micrometres there, because `ElasticPP` compares its stress with an absolute DBL_EPSILON E."""
    rng = np.random.default_rng(10)
    rho = np.arange(1, 13) if uniform else np.cumsum(rng.lognormal(size=12))
    kappa, slope, path = rng.exponential(size=12), 3.0, paths()[kind]
    expected = opensees(stiffness=kappa.tolist(), breakaway=rho.tolist(), spring=slope, path=path.tolist())
    actuator = Actuator(
        MaxwellSlip(rho / MICRO, kappa * MICRO), Spring(np.array([-1, 1]) / MICRO, [-slope, slope]), limits=None
    )
    for stack in (True, False):
        motion = actuator.compensate(
            path / MICRO, state=actuator.relaxed(extrapolate=True), stack=stack, extrapolate=True
        )
        assert np.abs(motion.voltage - expected).max() < 1e-11 * np.ptp(expected)
        back = actuator.simulate(expected, state=actuator.relaxed(extrapolate=True), stack=stack, extrapolate=True)
        assert np.abs(back.displacement * MICRO - path).max() < 1e-11 * np.ptp(path)
