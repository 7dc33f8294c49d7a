"""What every target of exports must do: a suite of tests for authors, which dehyst's own targets pass too."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.cli import main
from dehyst.control import Compensator
from dehyst.exports import TARGETS
from dehyst.model import (
    Actuator,
    Creep,
    DisplacementCreep,
    Dynamics,
    GradedSlip,
    MaxwellSlip,
    SmoothSlip,
    Spring,
    Thermal,
    Transformer,
)

_PERIOD = 1e-3
_PLAIN = Actuator(
    MaxwellSlip(1e-6 * np.array([0.5, 1.0, 2.0, 3.5]), 1e6 * np.array([3.0, 2.0, 1.5, 1.0])),
    Spring(1e-5 * np.linspace(0, 1, 6), 60 * np.linspace(0, 1, 6) ** 1.3),
    limits=(0.0, 80.0),
    name="plain",
)
# Fields of an actuator that every target has, or that have no effect on the voltages of a compensator.
_COMMON = ("slip", "spring", "state", "limits", "delay", "name", "provenance", "identification", "recorded_slew_rate")
# The other fields, with a part for each; a field without one makes this an error, so that no part goes untested.
_PARTS: dict[str, Any] = {
    "transformer": Transformer([0, 30, 80], [0, 35, 80]),
    "creep": Creep([0.01, 1.0], [4e6, 5e6]),
    "dynamics": Dynamics(2 * np.pi * 50, 0.1, series=1e6),
    "lag": 2e-3,
    "load_stiffness": 1e7,
    "smooth": SmoothSlip([2e-6], [0.8], [2e6]),
    "displacement_creep": DisplacementCreep([0.01, 1.0], [0.02, 0.03]),
    "thermal": Thermal(1e-3, 1e-8),
}


def _with(**parts: Any) -> Actuator:
    """Return the plain actuator with other parts, in its own state."""
    return replace(_PLAIN, **{"state": None, **parts})


_MODELS = {
    "plain": _PLAIN,
    "a spring alone": Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 80]), limits=(0.0, 80.0)),
    "graded": _with(slip=GradedSlip([1e-6, 2e-6], [0, 5e-6, 1e-5], [[3e6, 1e6], [1e6, 2e6]])),
    "foreign name": replace(_PLAIN, name="*/ #\"'<&>\n(* µm *)"),
    **{one.name: _with(**{one.name: _PARTS[one.name]}) for one in fields(Actuator) if one.name not in _COMMON},
}
# Further arguments of a compensator that an export must keep to.
_BEGINNINGS: dict[str, dict[str, Any]] = {
    "slew rate": {"slew_rate": 5e3},
    "state": {"state": _PLAIN.simulate([0.0, 70.0, 20.0, 45.0]).state},
    "preview": {"actuator": _MODELS["dynamics"], "preview": True},
    "both": {"slew_rate": 5e3, "state": _PLAIN.simulate([80.0, 10.0, 30.0]).state},
}
_OPTIONS = {"number": "double", "name": None, "measure": False, "force": False, "fmu": "3.0", "kind": None}


class TargetCandidate(NamedTuple):
    """A target under test.

    `suffix`: of its files; empty for a folder. `voltages`: function that runs the export at a path on wanted
    displacements (n,) [m], sample by sample from the start, and returns voltages (n,) [V]; without it, nothing is known
    of what the export does. `tolerance`: how far these may be from the compensator's, as a fraction of the range.
    `temperature`: whether the export takes a temperature; without it, models that depend on one must be refused.
    """

    suffix: str
    voltages: Callable[[Path, Array], Array] | None = None
    tolerance: float = 1e-9
    temperature: bool = False


def _export(folder: Path, actuator: Actuator, name: str, *options: str) -> tuple[int, Any, Path]:
    """Export by the command; return the exit status, its JSON and the path."""
    model, path = folder / "model.json", folder / name
    folder.mkdir(exist_ok=True)
    actuator.save(model)
    quick = ["--no-measure"] if "measure" in TARGETS[path.suffix].options else []
    words = ["export", str(model), str(path), "--period", str(_PERIOD), "--json", *quick, *options]
    done = CliRunner().invoke(main, words)
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, json.loads(done.stdout), path


def _content(path: Path) -> dict[str, bytes]:
    """Return the bytes of a file, or of all files in a folder."""
    found = sorted(path.rglob("*")) if path.is_dir() else [path]
    return {one.name: one.read_bytes() for one in found if one.is_file()}


@pytest.mark.filterwarnings("ignore::dehyst.ClampWarning")
class TargetContract:
    """The tests of a target: what is written and kept, which models are refused, and the voltages of the export.

    A subclass whose name begins with ``Test`` has a fixture `candidate` that returns a `TargetCandidate`::

        class TestMyTarget(TargetContract):
            @pytest.fixture
            def candidate(self):
                return TargetCandidate(".st", run_in_an_interpreter, tolerance=1e-3)
    """

    def test_the_suffix_is_registered(self, candidate: TargetCandidate) -> None:
        assert TARGETS[candidate.suffix].words

    def test_what_is_written_is_declared(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        status, values, path = _export(tmp_path / "a", _PLAIN, f"stage{candidate.suffix}")
        assert status == 0, values
        assert str(path) in map(str, values.values())
        files = TARGETS[candidate.suffix].files
        made = {one for one in path.parent.iterdir() if one.name != "model.json"}
        assert made == ({path} if files is None else set(files(path)))

    def test_the_same_model_gives_the_same_files(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        paths = [_export(tmp_path / folder, _PLAIN, f"stage{candidate.suffix}")[-1] for folder in ("a", "b")]
        assert _content(paths[0]) == _content(paths[1]) != {}

    def test_an_export_leaves_the_compensator_alone(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        compensator, twin = (Compensator(_PLAIN, period=_PERIOD) for _ in range(2))
        TARGETS[candidate.suffix].write(compensator, tmp_path / f"stage{candidate.suffix}", _OPTIONS)
        assert [compensator.step(y) for y in (1e-6, 5e-6, 2e-6)] == [twin.step(y) for y in (1e-6, 5e-6, 2e-6)]

    def test_the_file_of_somebody_else_is_kept(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        mine = tmp_path / f"stage{candidate.suffix}"
        if not candidate.suffix:
            mine.mkdir()
        (mine if candidate.suffix else mine / "notes.txt").write_text("mine")
        before = _content(mine)
        assert _export(tmp_path, _PLAIN, mine.name)[0] == 2
        assert _content(mine) == before

    def test_an_export_replaces_the_one_before(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        first, second = (_export(tmp_path, _PLAIN, f"stage{candidate.suffix}", "--force") for _ in range(2))
        assert (first[0], second[0]) == (0, 0), second[1]

    @pytest.mark.parametrize("kind", _MODELS)
    def test_a_model_is_exported_or_refused(self, candidate: TargetCandidate, kind: str, tmp_path: Path) -> None:
        """Nothing is left of an export that is refused; one that is written has the compensator's voltages."""
        actuator = _MODELS[kind]
        status, values, path = _export(tmp_path, actuator, f"stage{candidate.suffix}")
        if status:
            assert kind != "plain", values
            assert (status, path.exists()) == (2, False), values
            assert values["error"]["message"]
        else:
            assert candidate.temperature or actuator.thermal is None, "written without an input for the temperature"
            # The command begins at rest at the top, which is not every actuator's own state.
            compensator, again = Compensator(actuator, period=_PERIOD), tmp_path / "again" / path.name
            again.parent.mkdir()
            TARGETS[candidate.suffix].write(compensator, again, _OPTIONS)
            _compare(candidate, again, compensator)

    @pytest.mark.parametrize("kind", _BEGINNINGS)
    def test_what_a_compensator_begins_with_is_kept_or_refused(
        self, candidate: TargetCandidate, kind: str, tmp_path: Path
    ) -> None:
        options: dict[str, Any] = {"actuator": _PLAIN, "period": _PERIOD, **_BEGINNINGS[kind]}
        compensator, path = Compensator(**options), tmp_path / f"stage{candidate.suffix}"
        try:
            TARGETS[candidate.suffix].write(compensator, path, _OPTIONS)
        except ModelError:
            assert not path.exists()
        else:
            _compare(candidate, path, compensator)

    def test_narrower_limits_hold(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        status, values, path = _export(tmp_path, _PLAIN, f"stage{candidate.suffix}", "--limits", "10", "50")
        assert status == 0, values
        if candidate.voltages is None:
            pytest.skip("its candidate has no `voltages`: no test of this class compares a voltage of the export")
        got = candidate.voltages(path, _wanted(Compensator(_PLAIN, (10, 50), period=_PERIOD)))
        assert got.min() >= 10
        assert got.max() <= 50


def _compare(candidate: TargetCandidate, path: Path, compensator: Compensator) -> None:
    """Assert that an export, if it can be run, has the voltages of the compensator."""
    if candidate.voltages is not None:
        wanted = _wanted(compensator)
        got = candidate.voltages(path, wanted)
        expected = np.array([compensator.step(y) for y in wanted.tolist()])
        assert np.abs(got - expected).max() <= candidate.tolerance * np.ptp(expected)


def _wanted(compensator: Compensator) -> Array:
    """Return displacements (n,) [m]: growing turns around the start, then over all of the reach and beyond."""
    actuator, start, dice = compensator.actuator, compensator.state.displacement, np.random.default_rng(5)
    low, high = (float(actuator.simulate([0.0, v], time=[0.0, 1.0]).displacement[-1]) for v in (0.0, 80.0))
    share = dice.uniform(-0.1, 1.1, 400) * np.repeat([1.0, 0.5, 0.2, 0.9], 100)
    near = start + (high - low) * np.linspace(0, 0.1, 100) * dice.uniform(-1, 1, 100)
    return np.concatenate([near, low + (high - low) * share])
