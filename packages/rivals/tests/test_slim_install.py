"""In an environment of dehyst without extras: the hint, `pip install ./packages/rivals`, and then the rows."""

import importlib.metadata
import json
import os
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import places
import plain_records
import pytest

import dehyst
from dehyst_rivals import RIVALS

BUILT_IN = ["dehyst", "two branches", "linear ratio"]
PACKAGE = places.ROOT / "packages" / "rivals"


def modules_of(distribution):
    """The top-level files and folders of an installed distribution, in its folder of packages."""
    found = importlib.metadata.distribution(distribution)
    parts = {path.parts[0] for path in found.files if path.parts[0] != ".." and "__pycache__" not in path.parts[0]}
    return [Path(found.locate_file(part)) for part in sorted(parts)]


@pytest.fixture(scope="module")
def slim(tmp_path_factory):
    """The Python of an environment with dehyst and what it requires, linked, and nothing else."""
    folder = tmp_path_factory.mktemp("slim")
    venv.create(folder, symlinks=True)
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    required = [line.split(";") for line in importlib.metadata.requires("dehyst") if "extra ==" not in line]
    names = [str.join("", (c if c.isalnum() or c in "-_" else " " for c in line[0])).split()[0] for line in required]
    for path in (path for name in names for path in modules_of(name)):
        (packages / path.name).symlink_to(path)
    (packages / "dehyst").symlink_to(Path(dehyst.__file__).parent)
    info = next(path for path in modules_of("dehyst") if path.suffix == ".dist-info")
    (packages / info.name).symlink_to(info)
    return folder / "bin" / "python"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that `make test` built, or a new one."""
    built = sorted((places.ROOT / "build" / f"rivals-{sys.implementation.cache_tag}").glob("*.whl"))
    if built:
        return built[0]
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, PACKAGE]
    subprocess.run(command, check=True, timeout=600)
    return next(folder.glob("*.whl"))


def compared(python, folder, *arguments):
    """What `dehyst compare --json` prints."""
    command = [python, "-c", "from dehyst.cli import main; main()", "compare", "loops.csv", *arguments, "--json"]
    free = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=folder, env=free, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_an_install_adds_rows_to_compare(slim, wheel, tmp_path):
    record = plain_records.loops(plain_records.plant(), plain_records.THREE_LOOPS, name="loops")
    dehyst.write_record(tmp_path / "loops.csv", record)
    before = compared(slim, tmp_path)
    assert [row["model"] for row in before["models"]] == BUILT_IN
    assert "pip install dehyst-rivals" in before["hint"]
    assert before["best"]["model"] == "dehyst"
    install = [sys.executable, "-m", "pip", "--python", slim, "install", "--quiet", "--no-index", wheel]
    subprocess.run(install, check=True, timeout=300)
    after = compared(slim, tmp_path)
    assert [row["model"] for row in after["models"]][: len(BUILT_IN)] == BUILT_IN
    assert sorted(row["model"] for row in after["models"]) == sorted([*BUILT_IN, *RIVALS])
    assert after["hint"] is None
    judged = {row["model"] for row in after["models"] if any(error["role"] == "validation" for error in row["errors"])}
    # A first rise of a relaxed actuator and first-order reversal curves need not be in the record.
    assert judged >= {*BUILT_IN, *RIVALS} - {"Goldfarb-Celanovic", "Preisach, reversal curves"}


def test_each_fit_is_an_entry_point():
    points = importlib.metadata.distribution("dehyst-rivals").entry_points
    assert {point.name: point.load() for point in points if point.group == "dehyst.baselines"} == RIVALS
