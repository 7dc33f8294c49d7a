"""Paths with a temperature: what is remarked of the reach, and of a column that is not used."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import result

import dehyst
from dehyst.records import write_columns

COLD = replace(plain_records.plant(6), limits=(0.0, 200.0))
THERMAL = dehyst.Thermal(-2.5e-3, 4e-9, 30.0)
TIME = np.arange(300) * 0.01


def test_the_reach_depends_on_the_temperature_of_the_path(tmp_path):
    """The reach at 60 degC ends lower than at the reference, at 30 degC."""
    replace(COLD, thermal=THERMAL).save(tmp_path / "model.json")
    low, high = (1e6 * THERMAL.warmed(np.array(COLD.reach), 60.0)).tolist()
    path = {"time_s": TIME, "displacement_um": high - 1.9 + 2 * np.cos(np.pi * TIME)}
    said = []
    for degrees in (30, 60):
        write_columns(tmp_path / "path.csv", path | {"temperature_C": np.full(TIME.size, float(degrees))})
        told = result("compensate", "model.json", "path.csv", "-o", "out.csv", "--start", "top", cwd=tmp_path)[1]
        said.append([warning for warning in told["warnings"] if "the path covers" in warning])
    assert said[0] == [] and told["missed_um"] == pytest.approx(0.1, rel=1e-3)
    assert f"{low:.4g} to {high:.4g} um" in said[1][0] and f"to {high + 0.1:.6g} um" in said[1][0]


def test_a_model_without_temperature_ignores_the_column_and_says_so(tmp_path):
    COLD.save(tmp_path / "cold.json")
    columns = {"time_s": TIME, "displacement_um": 6 - 3 * np.cos(np.pi * TIME)}
    write_columns(tmp_path / "path.csv", columns)
    write_columns(tmp_path / "warm.csv", columns | {"temperature_K": np.linspace(293.15, 313.15, TIME.size)})
    words, said, written = ("-o", "out.csv", "--start", "bottom"), [], []
    for path in ("path.csv", "warm.csv"):
        said.append({*result("compensate", "cold.json", path, *words, cwd=tmp_path)[1]["warnings"]})
        written.append((tmp_path / "out.csv").read_bytes())
    (more,) = said[1] - said[0]
    assert "temperature_K" in more and written[0] == written[1]
