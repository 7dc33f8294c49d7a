"""What a step of the exported C costs: instructions."""

import re

import compiled_exports
import numpy as np
import pytest
from compiled_exports import KINDS, need, written

from dehyst.exports import export
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
    folder = export(compensator, tmp_path / "c", "float")
    longest = int(re.search(r"(\d+) instructions", compiled_exports.must_run(["make", "-s", "worst"], folder))[1])
    clamped, sent = compiled_exports.instructions(folder, adversary(compensator))
    usual, _ = compiled_exports.instructions(folder, compiled_exports.wishes(compensator, 2000))
    assert np.all((sent >= compensator.limits[0]) & (sent <= compensator.limits[1]))
    for side in (0, 1):
        assert np.ptp(clamped[100 + side :: 2]) <= 0.1 * clamped.max()
    assert 100 < np.median(usual) < usual.max() <= 1.01 * longest < 20_000
    assert clamped.max() <= 1.01 * longest


def test_feedback_takes_a_few_instructions(tmp_path):
    need("arm-none-eabi-gcc", "qemu-system-arm")
    compensator = KINDS["plain"]()
    folder = written(tmp_path / "c", compensator, "float")
    low, high = compensator.reach
    path = np.tile(np.concatenate([np.linspace(low, high, 200), np.linspace(high, low, 200)]), 3)
    alone, _ = compiled_exports.instructions(folder, path)
    fed, sent = compiled_exports.instructions(folder, path, feeds=True)
    assert np.median(fed - alone) <= 142
    assert not np.array_equal(sent[:400], sent[-400:])
