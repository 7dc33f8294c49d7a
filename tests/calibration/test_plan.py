"""Times of files."""

import numpy as np
import pytest

from dehyst import FileFormatError
from dehyst.calibration.plan import even_rate


@pytest.mark.parametrize(
    "time", [[0, 0, 0, 0], [0, 1, 1, 2], [3, 2, 1, 0], [0, 1, 2, 4], [0]], ids=["zero", "twice", "back", "gap", "one"]
)
def test_times_that_do_not_rise_evenly_are_refused(time):
    with pytest.raises(FileFormatError, match=r"wave\.csv"):
        even_rate("wave.csv", np.array(time, dtype=float))


def test_the_rate_is_that_of_the_times():
    assert even_rate("wave.csv", np.arange(5) / 100) == pytest.approx(100.0)
