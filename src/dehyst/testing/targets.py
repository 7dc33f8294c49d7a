"""What every target of exports must do: a suite of tests for authors, which dehyst's own targets pass too."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from click.testing import CliRunner

from dehyst._types import Array
from dehyst.cli import main
from dehyst.control import Compensator
from dehyst.exports import TARGETS
from dehyst.model import Actuator, Creep, MaxwellSlip, Spring, Transformer

_PERIOD = 1e-3
_PLAIN = Actuator(
    MaxwellSlip(1e-6 * np.array([0.5, 1.0, 2.0, 3.5]), 1e6 * np.array([3.0, 2.0, 1.5, 1.0])),
    Spring(1e-5 * np.linspace(0, 1, 6), 60 * np.linspace(0, 1, 6) ** 1.3),
    limits=(0.0, 80.0),
    name="plain",
)
_MODELS = {
    "plain": _PLAIN,
    "a spring alone": Actuator(MaxwellSlip([], []), Spring([0, 1e-5], [0, 80]), limits=(0.0, 80.0)),
    "transformer": replace(_PLAIN, transformer=Transformer([0, 30, 80], [0, 35, 80])),
    "creep": replace(_PLAIN, creep=Creep([0.01, 1.0], [4e6, 5e6])),
    "foreign name": replace(_PLAIN, name="*/ #\"'<&>\n(* µm *)"),
}


class TargetCandidate(NamedTuple):
    """A target under test.

    `suffix`: of its files; empty for a folder. `voltages`: function that runs the export at a path on wanted
    displacements (n,) [m], sample by sample from the start, and returns voltages (n,) [V]; without it, nothing is known
    of what the export does. `tolerance`: how far these may be from the compensator's, as a fraction of the range.
    """

    suffix: str
    voltages: Callable[[Path, Array], Array] | None = None
    tolerance: float = 1e-9


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
        options = {"number": "double", "name": None, "measure": False, "force": False, "fmu": "3.0", "kind": None}
        TARGETS[candidate.suffix].write(compensator, tmp_path / f"stage{candidate.suffix}", options)
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
        elif candidate.voltages is not None:
            wanted = _wanted(actuator)
            got = candidate.voltages(path, wanted)
            compensator = Compensator(actuator, period=_PERIOD)
            expected = np.array([compensator.step(y) for y in wanted.tolist()])
            assert np.abs(got - expected).max() <= candidate.tolerance * np.ptp(expected)

    def test_narrower_limits_hold(self, candidate: TargetCandidate, tmp_path: Path) -> None:
        status, values, path = _export(tmp_path, _PLAIN, f"stage{candidate.suffix}", "--limits", "10", "50")
        assert status == 0, values
        if candidate.voltages is not None:
            got = candidate.voltages(path, _wanted(_PLAIN))
            assert got.min() >= 10
            assert got.max() <= 50


def _wanted(actuator: Actuator) -> Array:
    """Return displacements (n,) [m] over all of the reach and beyond, with large and small turns."""
    low, high = (float(actuator.simulate([0.0, v], time=[0.0, 1.0]).displacement[-1]) for v in (0.0, 80.0))
    share = np.random.default_rng(5).uniform(-0.1, 1.1, 400) * np.repeat([1.0, 0.5, 0.2, 0.9], 100)
    return np.asarray(low + (high - low) * share)
