"""Voltages to play, from files."""

import numpy as np
import pytest

from dehyst import FileFormatError
from dehyst.calibration.plan import read_voltage


def written(path, time):
    table = np.column_stack([time, np.linspace(0.0, 10.0, len(time))])
    np.savetxt(path, table, delimiter=",", header="time_s,voltage_V", comments="")
    return path


def test_a_voltage_is_read_with_its_rate(tmp_path):
    voltage = read_voltage(written(tmp_path / "wave.csv", np.arange(5) / 100))
    assert voltage.sample_rate == pytest.approx(100.0)


@pytest.mark.parametrize(
    "time", [[0, 0, 0, 0], [0, 1, 1, 2], [3, 2, 1, 0], [0, 1, 2, 4], [0]], ids=["zero", "twice", "back", "gap", "one"]
)
def test_times_that_do_not_rise_evenly_are_refused(tmp_path, time):
    with pytest.raises(FileFormatError, match=r"wave\.csv"):
        read_voltage(written(tmp_path / "wave.csv", time))
