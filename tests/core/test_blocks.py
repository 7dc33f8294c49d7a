"""The core by itself: models and snapshots as blocks of bytes, missing samples, and what it refuses."""

import re
import subprocess

import compiled_exports
import golden_core
import numpy as np
import places
import pytest
from packaging.version import Version

import dehyst
from dehyst import Actuator, MaxwellSlip, ModelError, Spring
from dehyst._native import EMPTY, Core, CoreState, StepCoefficients, slip_elongations
from dehyst.model import evaluator_of, turned


def test_a_release_has_the_version_of_its_core():
    header = (places.CORE / "include" / "dehyst.h").read_text()
    core, package = Version(re.search(r'#define DEHYST_VERSION "(.*)"', header)[1]), Version(dehyst.__version__)
    assert core == package or (package.is_devrelease and core.release <= package.release)


def test_c_replays_the_results_of_python(tmp_path):
    """The bits of this machine in C; the file in the repository was written on one whose BLAS may round otherwise."""
    fresh = golden_core.text()
    (tmp_path / "golden.h").write_text(fresh)
    (tmp_path / "golden.c").write_text((places.CORE / "tests" / "golden.c").read_text())
    sources = [*sorted((places.CORE / "src").glob("*.c")), tmp_path / "golden.c"]
    options = ["-std=c99", "-O1", "-ffp-contract=off", "-I", tmp_path, "-I", places.CORE / "include"]
    subprocess.run(list(map(str, ["gcc", *options, *sources, "-lm", "-o", tmp_path / "golden"])), check=True)
    subprocess.run([tmp_path / "golden"], check=True, timeout=60)
    kept = golden_core.TARGET.read_text()
    for name in ("wanted", "sent"):
        np.testing.assert_allclose(golden_core.numbers(name, kept), golden_core.numbers(name, fresh), rtol=1e-9)


@pytest.mark.parametrize("kind", ["slewing", "moving"])
@pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
def test_a_snapshot_continues_and_a_damaged_one_changes_nothing(kind):
    loop = compiled_exports.KINDS[kind]()
    low, high = loop.reach
    path = np.random.default_rng(3).uniform(low, high, 80)
    loop.run(path[:40])
    kept, other = loop.snapshot(), loop._clone()
    expected = loop.run(path[40:])
    for place in range(8 * len(kept)):
        broken = bytearray(kept)
        broken[place // 8] ^= 1 << place % 8
        with pytest.raises(ModelError):
            other.restore(bytes(broken))
    for block in (kept[:-1], kept + b"0", b"", loop._axes[0].block(), compiled_exports.KINDS["creep"]().snapshot()):
        with pytest.raises(ModelError):
            other.restore(block)
    assert other.snapshot() == loop._clone().snapshot()
    other.restore(kept)
    np.testing.assert_array_equal(other.run(path[40:]), expected)


def test_the_id_of_a_model_does_not_depend_on_its_start():
    loop = compiled_exports.plain()
    block, numbers = loop._axes[0].block(), loop._axes[0].ids()
    loop.reset(turned(loop.actuator, 0.5 * sum(loop.reach), rising=False))
    assert loop._axes[0].block() != block
    assert loop._axes[0].ids() == numbers != compiled_exports.KINDS["creep"]()._axes[0].ids()


SLIP, SPRING = MaxwellSlip([1e-6, 2e-6], [1e6, 2e6]), Spring([0, 4e-6, 1e-5], [0, 30, 100])
CORE = evaluator_of(Actuator(SLIP, SPRING)).core
KNOTS, VOLTS = SPRING.displacement, SPRING.voltage
ZERO, TWO = np.zeros(1), np.zeros(2)
STEPS = StepCoefficients(np.array([0, 1]), *[np.zeros((1, 0))] * 3)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Core(SLIP.breakaway, ZERO, KNOTS, VOLTS),
        lambda: Core(SLIP.breakaway, -SLIP.stiffness, KNOTS, VOLTS),
        lambda: Core(SLIP.breakaway[::-1], SLIP.stiffness, KNOTS, VOLTS),
        lambda: Core(SLIP.breakaway, np.nan * SLIP.stiffness, KNOTS, VOLTS),
        lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS, VOLTS[::-1]),
        lambda: Core(SLIP.breakaway, SLIP.stiffness, KNOTS[:1], VOLTS[:1]),
        lambda: CORE.compensate(ZERO, STEPS, CoreState(0.0, ZERO, EMPTY, EMPTY)),
        lambda: CORE.simulate(ZERO, STEPS, CoreState(0.0, TWO + 1, EMPTY, EMPTY)),
        lambda: CORE.voltage(CoreState(np.nan, TWO, EMPTY, EMPTY)),
        lambda: CORE.depth(ZERO, 0.0, TWO + 1),
        lambda: CORE.depth(ZERO, 0.0, np.array([1e-6, -2e-6])),
        lambda: slip_elongations(SLIP.breakaway, ZERO, ZERO),
    ],
)
def test_the_core_refuses_numbers_that_python_passes(make):
    with pytest.raises(ModelError):
        make()
