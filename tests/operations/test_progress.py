"""The progress of steps on a rig."""

from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dehyst.instruments import Samples
from dehyst.operations.bench import Steps


@pytest.mark.parametrize("fails", [False, True])
@given(steps=st.lists(st.lists(st.integers(1, 50), max_size=3), min_size=1, max_size=4))
def test_a_note_begins_and_ends_each_step_and_an_error_ends_the_last_one(fails, steps):
    notes, shown = [], [""]
    run = SimpleNamespace(note=lambda sentence: notes.append((sentence, shown[-1])), progress=shown.append)
    with suppress(KeyboardInterrupt), Steps(run) as listener:
        for k, blocks in enumerate(steps):
            listener.step(f"step {k}")
            for size in blocks:
                listener.samples(Samples(*np.zeros((3, size))))
                assert "samples" in shown[-1]
        if fails:
            raise KeyboardInterrupt
    sentences, beside = zip(*notes, strict=True)
    for k, (blocks, begin, end) in enumerate(zip(steps, sentences[::2], sentences[1::2], strict=True)):
        assert (begin, ("failed" in end)) == (f"step {k}: begins", fails and k == len(steps) - 1)
        assert (f"{sum(blocks)} samples" in end) is bool(blocks)
    # No note is on the line of the progress.
    assert set(beside) == {""}
