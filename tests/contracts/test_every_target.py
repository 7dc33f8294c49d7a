"""What every target of exports must do: what is written and kept, which models are refused, and the voltages."""

import json
import shutil
from dataclasses import fields, replace

import compiled_exports
import node_programs
import numpy as np
import pytest
from command_line import run

from dehyst.control import Compensator
from dehyst.exports.targets import TARGETS, export
from dehyst.model import (
    Actuator,
    DisplacementCreep,
    Dynamics,
    GradedSlip,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    Thermal,
    Transformer,
)

pytestmark = pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
STEPS = """
const compensator = new Compensator(module), degrees = read("degrees");
const warm = (celsius) => {
    try { return compensator.setTemperature(celsius), true; } catch (error) { return !(error instanceof RangeError); }
};
let taken = 0;
const answers = [...read("wanted")].map((wanted, k) => {
    taken += warm(degrees[k]);
    return [compensator.step(wanted), compensator.displacement];
});
write("answers", answers.flat());
console.log(taken, warm(1000));
"""
PERIOD = 1e-3
PLAIN = Actuator(
    MaxwellSlip(1e-6 * np.array([0.5, 1.0, 2.0, 3.5]), 1e6 * np.array([3.0, 2.0, 1.5, 1.0])),
    Spring(1e-5 * np.linspace(0, 1, 6), 60 * np.linspace(0, 1, 6) ** 1.3),
    limits=(0.0, 80.0),
    name="plain",
)
# Fields of an actuator that every target has, or that have no effect on the voltages of a compensator.
COMMON = ("slip", "spring", "state", "limits", "delay", "name", "provenance", "identification")
# The other fields, with a part for each; a field without one makes this an error, so that no part goes untested.
PARTS = {
    "transformer": Transformer([0, 30, 80], [0, 35, 80]),
    "dynamics": Dynamics(50, 0.1, series=1e6),
    "lag": 2e-3,
    "load_stiffness": 1e7,
    "smooth": SmoothSlip([2e-6], [0.8], [2e6]),
    "displacement_creep": DisplacementCreep([0.01, 1.0], [0.02, 0.03]),
    # 1000 degC would reverse the motion.
    "thermal": Thermal(-0.0037, 3.3e-9, 24.7),
}


def with_parts(**parts):
    """Return the plain actuator with other parts, in its own state."""
    return replace(PLAIN, **{"state": None, **parts})


MODELS = {
    "plain": PLAIN,
    "a spring alone": Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 80]), limits=(0.0, 80.0)),
    "graded": with_parts(slip=GradedSlip([1e-6, 2e-6], [0, 5e-6, 1e-5], [[3e6, 1e6], [1e6, 2e6]])),
    "foreign name": replace(PLAIN, name="*/ #\"'<&>\n(* µm *)"),
    **{part.name: with_parts(**{part.name: PARTS[part.name]}) for part in fields(Actuator) if part.name not in COMMON},
}
# Further arguments of a compensator that an export must keep to.
BEGINNINGS = {
    "slew rate": {"slew_rate": 5e3},
    "limits": {"limits": (10, 50)},
    "state": {"state": PLAIN.simulate([0.0, 70.0, 20.0, 45.0]).state},
    "preview": {"model": MODELS["dynamics"], "preview": True},
    "both": {"slew_rate": 5e3, "state": PLAIN.simulate([80.0, 10.0, 30.0]).state},
}


def by_c(folder, wanted, degrees):
    compiled_exports.need("gcc")
    degrees = None if degrees is None else degrees[:, None]
    return compiled_exports.played(folder, wanted, degrees, options=["-O1"])[:, :2]


def by_node(path, wanted, degrees):
    given = np.zeros(wanted.size) if degrees is None else degrees
    taken = node_programs.node(path.parent, STEPS, wanted=wanted, degrees=given)
    assert taken == f"{0 if degrees is None else wanted.size} false"
    return node_programs.column(path.parent, "answers").view(float).reshape(-1, 2)


# Voltages of an FMU are compared in tests/exports/test_fmu.py.
RUNS = {"": by_c, ".wasm": by_node}


def exported(folder, actuator, name, *options):
    """Export by the command; return the exit status, its JSON and the path."""
    model, path = folder / "model.json", folder / name
    folder.mkdir(exist_ok=True)
    actuator.save(model)
    status, out, _ = run("export", model, path, "--period", PERIOD, "--json", *options)
    return status, json.loads(out), path


def content(path):
    """Return the bytes of a file, or of all files in a folder."""
    found = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {path.name: path.read_bytes() for path in found if path.is_file()}


def wanted_of(compensator):
    """Return displacements (n,) [m]: growing turns around the start, then over all of the reach and beyond."""
    actuator, start, dice = compensator.actuator, compensator.displacement, np.random.default_rng(5)
    low, high = (float(actuator.simulate([0.0, v], time=[0.0, 1.0]).displacement[-1]) for v in (0.0, 80.0))
    share = dice.uniform(-0.1, 1.1, 400) * np.repeat([1.0, 0.5, 0.2, 0.9], 100)
    near = start + (high - low) * np.linspace(0, 0.1, 100) * dice.uniform(-1, 1, 100)
    return np.concatenate([near, low + (high - low) * share])


def test_every_target_except_the_fmu_is_tested():
    assert {*RUNS, ".fmu"} == set(TARGETS)


@pytest.mark.parametrize("suffix", TARGETS)
def test_a_target_writes_the_declared_files_with_the_same_content_again(suffix, tmp_path):
    status, values, path = exported(tmp_path / "a", PLAIN, f"stage{suffix}")
    before = content(path)
    assert status == 0, values
    made = path.iterdir() if path.is_dir() else path.parent.iterdir()
    assert set(values["files"]) == {str(path) for path in made if path.name != "model.json"}
    # In another folder, over the same and beside a file of somebody else.
    shutil.copytree(path.parent, tmp_path / "b")
    notes = (tmp_path / "b" / path.name if path.is_dir() else tmp_path / "b") / "notes.txt"
    notes.write_text("mine")
    status, again, path = exported(tmp_path / "b", PLAIN, path.name, "--force")
    assert (status, len(again["files"]), notes.read_text()) == (0, len(values["files"]), "mine")
    assert {**content(path), "notes.txt": b""} == {**before, "notes.txt": b""} != {"notes.txt": b""}


@pytest.mark.parametrize("suffix", TARGETS)
def test_other_files_are_kept(suffix, tmp_path):
    mine = tmp_path / f"stage{suffix}"
    if not suffix:
        mine.mkdir()
    (mine if suffix else mine / "notes.txt").write_text("mine")
    before = content(mine)
    assert exported(tmp_path, PLAIN, mine.name)[0] == 2
    assert content(mine) == before


@pytest.mark.parametrize("kind", MODELS)
@pytest.mark.parametrize("suffix", RUNS)
def test_an_export_has_the_voltages_of_the_compensator_to_the_bit(suffix, kind, tmp_path):
    assert_same_voltages(suffix, tmp_path, model=MODELS[kind])


@pytest.mark.parametrize("kind", BEGINNINGS)
@pytest.mark.parametrize("suffix", RUNS)
def test_an_export_begins_in_the_state_of_the_compensator(suffix, kind, tmp_path):
    assert_same_voltages(suffix, tmp_path, **{"model": PLAIN, **BEGINNINGS[kind]})


def assert_same_voltages(suffix, folder, **options):
    """Assert that an export, which leaves its compensator alone, has its voltages and displacements."""
    compensator, path = Compensator(**options, period=PERIOD), folder / f"stage{suffix}"
    export(compensator, path)
    wanted = wanted_of(compensator)
    warm = compensator.actuator.thermal is not None
    degrees = np.random.default_rng(6).uniform(10, 60, wanted.size) if warm else None
    expected = compiled_exports.answers(compensator, wanted, degrees)[:, :2]
    assert RUNS[suffix](path, wanted, degrees).tobytes() == expected.tobytes()
