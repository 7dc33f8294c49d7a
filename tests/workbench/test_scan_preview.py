"""The path of a scan as the page draws it: that of the command line."""

import numpy as np
import pytest
from command_line import run

from dehyst._errors import DehystError
from dehyst.model import Actuator, MaxwellSlip, Spring
from dehyst.records import read_table
from dehyst.workbench.data import scan_columns, scan_words

SCANS = (
    {"kind": "triangle", "low": 2, "high": 8, "frequency": 5, "cycles": 3, "rising": 0.3},
    {"kind": "raster", "low": 2, "high": 8, "frequency": 10, "lines": 4, "axis": "y", "y_low": 3, "y_high": 6},
    {"kind": "steps", "levels": [2, 6, 4], "dwell": 0.1, "edge": 0.02},
)


@pytest.mark.parametrize("scan", SCANS, ids=[scan["kind"] for scan in SCANS])
def test_the_drawn_scan_is_the_compensated_scan(tmp_path, scan):
    model, output = tmp_path / "model.json", tmp_path / "v.csv"
    Actuator(MaxwellSlip([1e-6], [1e6]), Spring([0, 12e-6], [0, 100])).save(model)
    path = tmp_path / "path.csv"
    words, axis = scan_words(scan, sample_rate=1000, output=path)
    run(*words)
    columns = ["--columns", f"displacement={axis}_um"] if "axis" in scan else []
    run("compensate", model, path, "--start", "bottom", "--no-home", "--limits", 0, 100, *columns, "-o", output)
    table = read_table(output)
    time, wanted = scan_columns(scan, 1000)
    written = table.columns[table.names.index("displacement_um")].data
    assert time == pytest.approx(np.arange(written.size) / 1000)
    assert wanted == pytest.approx(written, abs=1e-8)


@pytest.mark.parametrize(
    ("scan", "rate", "argument"),
    [
        ({"kind": "circle"}, 1000, "kind"),
        ({"kind": "triangle", "low": 8, "high": 2, "frequency": 1}, 1000, "low, high"),
        ({"kind": "triangle", "low": 2, "high": 8, "frequency": 1}, "x", "rate"),
        ({"kind": "triangle", "low": 2, "high": 8, "frequency": 1, "cycles": 1000}, 1e5, "rate"),
        ({"kind": "raster", "low": 2, "high": 8, "frequency": 1, "lines": 3.5}, 1000, "lines"),
    ],
)
def test_an_impossible_scan_is_refused_with_its_field(scan, rate, argument):
    with pytest.raises(DehystError) as refused:
        scan_columns(scan, rate)
    assert refused.value.as_dict()["argument"] == argument
    assert argument != "low, high" or str(refused.value).startswith("low, high: ")
