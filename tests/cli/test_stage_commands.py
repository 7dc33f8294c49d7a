"""Commands with several axes: records with axes in --columns, and models of several axes."""

import json
from dataclasses import replace

import coupled_stage
import numpy as np
import pytest
from command_line import refused, result
from command_line import run as run_command

from dehyst.model import Stage
from dehyst.records import read, read_table, write_columns, write_record

AXES = "x=vx_V:x_um, y=vy_V:y_um"


def run(*words):
    """Return what a command prints that succeeds."""
    status, out, err = run_command(*words)
    assert status == 0, err
    return out


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("stage")
    write_record(path / "stage.csv", coupled_stage.excited()[0])
    run("identify", path / "stage.csv", "--columns", AXES, "-o", path / "stage.json", "--report", path / "stage.html")
    return path


def test_identify_writes_stage_and_report(folder):
    stage = json.loads((folder / "stage.json").read_text())
    assert stage["format"] == "dehyst-stage"
    assert stage["axes"] == ["x", "y"]
    assert abs(stage["coupling"][0][1] - 0.04) < 0.002
    page = (folder / "stage.html").read_text()
    assert "Coupled axes" in page
    assert "Axis x" in page and "Axis y" in page and page.count("data-chart=") >= 4


def test_columns_without_units_are_found_by_their_names(folder):
    words = ["compensate", folder / "stage.json", folder / "bare-path.csv"]
    path = {"x_um": np.linspace(4.0, 8.0, 50), "y_um": np.linspace(9.0, 6.0, 50)}
    write_columns(folder / "bare-path.csv", path | {"b_um": path["y_um"]})
    run(*words, "-o", folder / "bare.csv")
    for number, axes in enumerate(["y=y_um, x=x_um", "y=b_um, x=x_um"]):
        run(*words, "-o", folder / f"bare{number}.csv", "--columns", axes)
        assert (folder / f"bare{number}.csv").read_bytes() == (folder / "bare.csv").read_bytes()
    assert refused(*words, "-o", folder / "n.csv", "--columns", "x=x_um")["argument"] == "axes"
    run("simulate", folder / "stage.json", folder / "bare.csv", "-o", folder / "s.csv")
    run("simulate", folder / "stage.json", folder / "bare.csv", "-o", folder / "t.csv", "--columns", "y=vy_V, x=vx_V")
    assert (folder / "s.csv").read_bytes() == (folder / "t.csv").read_bytes()


OWN_RIG = """
from fake_rig import FakeRig
from dehyst.instruments import AbstractRig
from dehyst.instruments.output import bounds_of_axes


class Pair(FakeRig):
    def __init__(self, limits, slew_rate):
        bounds = bounds_of_axes(limits, slew_rate, 2)
        rigs = [FakeRig((0, 100), axis=axis, limits=a, slew_rate=b) for axis, (a, b) in zip("xy", bounds)]
        AbstractRig.__init__(self, "pair", rigs)

    def _close(self):
        pass


def make(limits, slew_rate):
    return Pair(limits, slew_rate)
"""


def test_axes_of_a_user_defined_rig_are_named(tmp_path):
    (tmp_path / "pair.py").write_text(OWN_RIG)
    words = ["calibrate", tmp_path / "pair.py:make", "--dry-run", "-o", tmp_path / "kept", "--limits", "0", "80"]
    assert "--axes x,y" in refused(*words)["message"]
    assert "x, y" in refused(*words, "--axes", "x,z")["message"]
    planned = result(*words, "--axes", "x,y", "--limits", "y=10", "50")[1]
    assert planned["limits_V"] == [[0, 80], [10, 50]]
    assert not (tmp_path / "kept").exists()


@pytest.mark.parametrize(("given", "used"), [(None, 2000), ("none", 2000), ("1e9", 1e9), ("10", 10)])
def test_a_rig_has_a_slew_rate_even_if_none_is_given(given, used):
    option = ("--slew-rate", given) if given else ()
    _, out, err = run_command("calibrate", "sim://", "--dry-run", "--json", *option)
    assert (json.loads(out)["slew_rate_V_per_s"], err) == ([used], "")


def test_an_interrupted_identification_of_axes_writes_nothing(folder, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("dehyst.operations.identify.identify_one", interrupted)
    words = ["identify", folder / "stage.csv", "--columns", AXES, "-o", folder / "never.json"]
    assert run_command(*words)[0] == 130
    assert not (folder / "never.json").exists()


def test_show_check_and_insight_accept_a_stage(folder):
    assert "condition" in run("show", folder / "stage.json")
    assert "Coupling: as in the model" in run("check", folder / "stage.json", folder / "stage.csv")
    words = run("insight", folder / "stage.json", folder / "stage.csv")
    assert "half the interval" in words
    assert "never moved alone" not in words


def test_a_record_of_axes_is_shown_and_written(folder):
    output = run("show", folder / "stage.csv", "--columns", AXES, "-o", folder / "shown.npz")
    assert output.count("\nAxis ") == 2 and "Axis y" in output
    again = read(folder / "shown.npz", "x=vx_V:x_m, y=vy_V:y_m")
    assert np.array_equal(again.voltage, read(folder / "stage.csv", AXES).voltage)


def test_a_check_of_a_stage_adds_a_row_per_axis_to_the_log(folder):
    found = result("check", folder / "stage.json", folder / "stage.csv", "--log", folder / "log.csv")[1]
    assert set(found["axes"]) == {"x", "y"}
    header, *rows = (folder / "log.csv").read_text().splitlines()
    axis = header.split(",").index("axis")
    assert [row.split(",")[axis] for row in rows] == ["x", "y"]


@pytest.fixture(scope="module")
def scaled(folder):
    """Return a record with scaled columns, the columns as text, and the model with these among its own."""
    found, record = (
        {column.name: column.data for column in read_table(folder / "stage.csv").columns},
        folder / "other.csv",
    )
    own = {"Mx": found["vx_V"] / 15, "vy_V": found["vy_V"] / 2, "y_um": -found["y_um"]}
    write_columns(record, {name: values for name, values in (found | own).items() if name != "vx_V"})
    axes = "x=Mx:V*15:x_um, y=vy_V*2:y_um*-1um/um"
    recorded = ("x=Mx:V*15:x_um", "y=vy_V*2:y_um*-1 um/um")
    replace(Stage.load(folder / "stage.json"), recorded_columns=recorded).save(folder / "scaled.json")
    return record, axes


def test_a_record_with_scales_is_checked_with_and_without_columns(folder, scaled):
    record, axes = scaled
    plain, own, given = (
        result("check", *words)[1]
        for words in (
            (folder / "stage.json", folder / "stage.csv"),
            (folder / "scaled.json", record),
            (folder / "stage.json", record, "--columns", axes),
        )
    )
    assert own == given
    assert np.allclose(own["coupling"], plain["coupling"], rtol=1e-9, atol=1e-12)


def test_scales_of_records_do_not_apply_to_paths_and_voltages(folder, scaled):
    write_columns(folder / "plain.csv", {"x_um": np.linspace(4.0, 8.0, 50), "y_um": np.linspace(9.0, 6.0, 50)})
    for name in ("stage", "scaled"):
        run("compensate", folder / f"{name}.json", folder / "plain.csv", "-o", folder / f"{name}-v.csv")
        run("simulate", folder / f"{name}.json", folder / "stage-v.csv", "-o", folder / f"{name}-y.csv")
    assert (folder / "stage-v.csv").read_bytes() == (folder / "scaled-v.csv").read_bytes()
    assert (folder / "stage-y.csv").read_bytes() == (folder / "scaled-y.csv").read_bytes()
