"""What a step of the exported C costs: instructions, bytes in flash and RAM and on the stack."""

import compiled_exports
import numpy as np
import pytest
from compiled_exports import KINDS, need, written

from dehyst import FileFormatError
from dehyst.exports import sizes
from dehyst.exports.footprint import CORTEX_M4, CORTEX_M4F, CORTEX_M4F_SMALL
from examples import at_night

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")


def adversary(compensator, steps=200):
    """Every step reverses and asks for more than there is: all elements break away, all knots are passed."""
    low, high = compensator.reach
    far = 10 * (high - low)
    return np.where(np.arange(steps) % 2, low - far, high + far)


@pytest.mark.parametrize("kind", ["plain", at_night("graded"), at_night("creep")])
def test_a_step_takes_bounded_time(tmp_path, kind):
    """No step gets longer by those before it, and clamped steps over the whole range are among the longest."""
    need("arm-none-eabi-gcc", "qemu-system-arm")
    compensator = KINDS[kind]()
    folder = written(tmp_path / "c", compensator, "float")
    clamped, sent = compiled_exports.instructions(folder, adversary(compensator))
    usual, _ = compiled_exports.instructions(folder, compiled_exports.wishes(compensator, 2000))
    assert np.all((sent >= compensator.limits[0]) & (sent <= compensator.limits[1]))
    for side in (0, 1):
        assert np.ptp(clamped[100 + side :: 2]) <= 0.1 * clamped.max()
    assert 100 < np.median(usual) < usual.max() <= 2 * clamped.max() < 20_000


def test_following_a_sensor_takes_a_few_instructions(tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    compensator = KINDS["plain"]()
    folder = written(tmp_path / "c", compensator, "float")
    low, high = compensator.reach
    path = np.tile(np.concatenate([np.linspace(low, high, 200), np.linspace(high, low, 200)]), 3)
    alone, _ = compiled_exports.instructions(folder, path)
    followed, sent = compiled_exports.instructions(folder, path, follows=True)
    assert np.median(followed - alone) <= 80
    assert not np.array_equal(sent[:400], sent[-400:])


@pytest.mark.nightly
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
