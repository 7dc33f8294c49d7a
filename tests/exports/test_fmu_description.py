"""FMUs as files: valid, whole, built from their own sources, made by the command line and by the documentation."""

import os
import re
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import places
import plain_records
import pytest
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu
from fmu_runner import (
    ALL,
    KINDS,
    MODELS,
    PATH,
    PERIOD,
    Slave,
    actuator_voltages,
    fmpy,
    voltages,
)

from dehyst import Compensator, FileFormatError, ModelError
from dehyst.exports import SourceOnlyWarning, export
from examples import spanning


@pytest.mark.parametrize(("model", "kind"), spanning(MODELS, KINDS))
def test_validation_finds_nothing(fmus, model, kind):
    path, _ = fmus(model, kind)
    assert validate_fmu(str(path)) == []


@pytest.mark.nightly
def test_built_from_its_own_sources_it_is_the_same(fmus, tmp_path, monkeypatch):
    """As an importer builds it: the files, language and definitions of its own description, no flags of ours."""
    cmake = shutil.which("cmake") or shutil.which("cmake", path=str(Path(sys.executable).parent))
    if cmake is None:
        pytest.skip("cmake is not installed")
    monkeypatch.setenv("PATH", f"{Path(cmake).parent}{os.pathsep}{os.environ['PATH']}")
    for kind in KINDS:
        folder = Path(fmpy.extract(fmus("mass", kind)[0], tmp_path / kind))
        shutil.rmtree(folder / "binaries")
        build_platform_binary(folder)
        given = PATH if kind == "compensator" else actuator_voltages("mass")
        with Slave(folder) as built, Slave(fmus("mass", kind)[1]) as shipped:
            np.testing.assert_array_equal(built.run(given), shipped.run(given))


def test_the_declarations_are_those_of_the_standard(fmus, tmp_path):
    """Its own headers say no other thing than the official ones, nothing is missing, and nothing else is seen."""
    _, folder = fmus("creep", "compensator")
    official = Path(fmpy.__file__).parent / "c-code"
    flags = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-strict-prototypes"]
    for options in ([], ["-DFMU_STANDARD_HEADERS", f"-I{official}"]):
        command = ["cc", *flags, *options, "-fPIC", "-shared", "all.c", "-o", str(tmp_path / "x.so")]
        subprocess.run(command, cwd=folder / "sources", check=True)
    listed = subprocess.run(["nm", "-D", "--defined-only", str(tmp_path / "x.so")], capture_output=True, check=True)
    seen = {line.split()[-1] for line in listed.stdout.decode().splitlines()}
    assert all(name.startswith("fmi2") for name in seen)


def test_no_memory_is_lost_or_overrun(fmus, tmp_path):
    """A life from instantiation to the end, under the sanitizers of the compiler."""
    _, folder = fmus("preview", "compensator")
    life = places.SUPPORT / "fmu_life.c"
    command = ["cc", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{folder / 'sources'}"]
    command += [f"-DMODEL_PERIOD={PERIOD!r}"]
    built = subprocess.run(
        [*command, str(life), "-o", str(tmp_path / "life")], capture_output=True, text=True, check=False
    )
    if "cannot find" in built.stderr:
        pytest.skip("the sanitizers' libraries are not installed")
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([str(tmp_path / "life")], capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout == "alike\n"


def test_without_a_compiler_it_holds_sources(tmp_path, monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setenv("PATH", str(tmp_path / "absent"))
    with pytest.warns(SourceOnlyWarning, match="compiler"):
        export(ALL["plain"], tmp_path / "a.fmu")
    monkeypatch.setenv("CC", str(tmp_path / "absent" / "cc"))
    with pytest.warns(SourceOnlyWarning, match="such file"):
        export(ALL["plain"], tmp_path / "b.fmu")
    names = zipfile.ZipFile(tmp_path / "a.fmu").namelist()
    assert "sources/all.c" in names and not [name for name in names if name.startswith("binaries")]
    assert validate_fmu(str(tmp_path / "a.fmu")) == []


@pytest.mark.nightly
def test_any_name_makes_an_fmu(tmp_path):
    odd = replace(plain_records.plant(3), name='Möbius "<&> 100 %\n\x00 7')
    export(Compensator(odd, (0, 100)), tmp_path / "x.fmu")
    assert validate_fmu(str(tmp_path / "x.fmu")) == []
    with Slave(fmpy.extract(tmp_path / "x.fmu", tmp_path / "x")) as slave:
        assert slave.step(5e-6) == voltages(Compensator(odd, (0, 100)), [5e-6])[0][0]


def test_refusals(tmp_path):
    for given in ({"name": "axis"}, {"number": "float"}, {"period": 1e-3}):
        with pytest.raises(ModelError, match=f"^{next(iter(given))}: "):
            export(ALL["plain"], tmp_path / "x.fmu", **given)
    with pytest.raises(FileFormatError, match=r"ends in \.zip"):
        export(ALL["plain"], tmp_path / "x.zip")
    with pytest.raises(ModelError, match="the period"):
        export(Compensator(ALL["creep"].actuator, (0, 1)), tmp_path / "x.fmu")
    with pytest.raises(ModelError, match="the period"):
        export(ALL["creep"].actuator, tmp_path / "x.fmu")
    with pytest.raises(FileFormatError, match="got 7"):
        export(ALL["plain"], 7)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.nightly
def test_the_example_of_the_documentation_runs(tmp_path, monkeypatch):
    """And what it shows: the actuator follows two steps late."""
    page = (places.DOCS / "how_to" / "simulink.md").read_text()
    names = {}
    ALL["creep"].actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    exec(re.search(r"```python\n(.*?)```", page, re.DOTALL)[1], names)
    missed = np.abs(names["moved"]["displacement"][2:] - names["wanted"].displacement[:-2])
    assert names["sent"]["limited"][-1] == 0
    assert missed.max() < 1e-12 * plain_records.STROKE
