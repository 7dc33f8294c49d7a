"""Path files with a temperature: what is remarked of a column that is not used, and of the reach."""

import json
from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import run

import dehyst
from dehyst.records import read_table, write_columns

COLD = replace(plain_records.plant(6), limits=(0.0, 200.0))
THERMAL = dehyst.Thermal(-2.5e-3, 4e-9, 30.0)
TIME = np.arange(300) * 0.01
PATH = 6 - 3 * np.cos(2 * np.pi * 0.5 * TIME)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    target = tmp_path_factory.mktemp("temperature")
    replace(COLD, thermal=THERMAL).save(target / "model.json")
    COLD.save(target / "cold.json")
    columns = {"time_s": TIME, "displacement_um": PATH}
    write_columns(target / "path.csv", columns)
    write_columns(target / "warm.csv", columns | {"temperature_K": np.linspace(293.15, 313.15, TIME.size)})
    return target


def follow(folder, *words, status=0):
    found, out, _ = run("compensate", *words, "-o", "out.csv", "--start", "bottom", "--json", "--force", cwd=folder)
    assert status in (None, found), out
    return json.loads(out), read_table(folder / "out.csv")


def test_the_reach_of_a_path_is_that_at_its_temperature(folder):
    """The reach at 60 degC ends lower than at the reference."""
    low, high = (1e6 * float(end) for end in THERMAL.warmed(np.array(COLD.reach), 60.0))
    assert high + 0.2 < 1e6 * COLD.reach[1]
    top = high + 0.1
    columns = {"time_s": TIME, "displacement_um": top - 2 + 2 * np.cos(np.pi * TIME)}
    write_columns(folder / "high.csv", columns)
    write_columns(folder / "high_hot.csv", columns | {"temperature_C": np.full(TIME.size, 60.0)})
    start = ("-o", "out.csv", "--start", "top", "--json", "--force")
    said = {}
    for path in ("high.csv", "high_hot.csv"):
        found = json.loads(run("compensate", "model.json", path, *start, cwd=folder)[1])
        said[path] = [warning for warning in found["warnings"] if "the path covers" in warning]
        missed = found["missed_um"]
    cold, column = said.values()
    assert cold == [] and len(column) == 1
    assert f"{low:.4g} to {high:.4g} um" in column[0] and f"to {top:.6g} um" in column[0]
    assert missed == pytest.approx(0.1, rel=1e-3)


def test_a_model_without_the_part_ignores_the_column_and_says_so(folder):
    (warned, warm), (known, plain) = (follow(folder, "cold.json", path) for path in ("warm.csv", "path.csv"))
    np.testing.assert_array_equal(warm.column("voltage"), plain.column("voltage"))
    (more,) = set(warned["warnings"]) - set(known["warnings"])
    assert "temperature_K" in more
