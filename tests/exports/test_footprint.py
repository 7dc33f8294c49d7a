"""What a step of the exported C costs: operations counted, bytes in flash and RAM and on the stack."""

import compiled_exports
import numpy as np
import plain_records
import pytest
from compiled_exports import KINDS, need, written

from dehyst import Actuator, Compensator, FileFormatError, MaxwellSlip
from dehyst.exports import sizes, worst_case
from dehyst.exports.footprint import CORTEX_M4, CORTEX_M4F, CORTEX_M4F_SMALL

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")


def adversary(compensator, steps=200):
    """Every step reverses and asks for more than there is: all elements break away, all knots are passed."""
    low, high = compensator.reach
    far = 10 * (high - low)
    return np.where(np.arange(steps) % 2, low - far, high + far)


@pytest.mark.parametrize("kind", KINDS)
def test_no_step_takes_more_operations_than_stated(tmp_path, kind):
    need("g++")
    compensator = KINDS[kind]()
    bound, folder = worst_case(compensator), written(tmp_path / "c", compensator)
    most = np.zeros(3)
    for given in (adversary(compensator), compiled_exports.wishes(compensator, 6000)):
        found, voltages = compiled_exports.counted(folder, given)
        np.testing.assert_array_equal(voltages, compensator.afresh().run(given))
        most = np.maximum(most, found)
    assert most[0] <= bound.arithmetic
    assert most[1] <= bound.divisions
    assert most[2] <= bound.comparisons
    if kind == "plain":
        stated = np.array([bound.arithmetic, bound.divisions, bound.comparisons])
        assert np.all(most >= stated / 3), most / stated


@pytest.mark.parametrize("elements", [0, 1, 3, 30])
def test_operations_grow_as_stated(tmp_path, elements):
    need("g++")
    actuator = plain_records.plant(max(elements, 1), seed=4)
    if not elements:
        actuator = Actuator(MaxwellSlip([], []), actuator.spring)
    compensator = Compensator(actuator, (-50, 250))
    found, _ = compiled_exports.counted(written(tmp_path / "c", compensator), adversary(compensator))
    bound = worst_case(compensator)
    stated = np.array([bound.arithmetic, bound.divisions, bound.comparisons])
    assert np.all(found <= stated)
    assert elements < 3 or np.all(found >= stated / 3), found / stated


def test_bytes_are_those_of_the_program(tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    folder = written(tmp_path / "c", KINDS["all"](), "float")
    stated = sizes(folder, "arm-none-eabi-gcc", CORTEX_M4F)
    touched, piezo = compiled_exports.painted(folder)
    assert stated.ram == piezo
    # The painter's own frame lies about where a step's does.
    assert 0.6 * stated.stack < touched <= stated.stack + 48
    assert 1000 < stated.flash < 30_000
    # What a plain model does not need goes when the whole program is compiled at once.
    plain = written(tmp_path / "plain", compiled_exports.plain(), "float")
    small = sizes(plain, "arm-none-eabi-gcc", CORTEX_M4F_SMALL)
    assert small.ram == sizes(plain, "arm-none-eabi-gcc", CORTEX_M4F).ram
    assert small.flash < 0.6 * stated.flash
    assert 100 < small.stack <= stated.stack
    soft = sizes(written(tmp_path / "double", KINDS["all"]()), "arm-none-eabi-gcc", CORTEX_M4)
    assert soft.flash > stated.flash
    assert soft.ram > stated.ram


def test_bytes_without_a_sound_compiler(tmp_path):
    need("gcc")
    folder = written(tmp_path / "c", compiled_exports.plain())
    (folder / "piezo.c").write_text("#error broken\n")
    with pytest.raises(FileFormatError, match="need a C99 compiler"):
        sizes(folder, "gcc")
