"""The commands of the Makefile, and who runs them: continuous integration and the hooks before a commit."""

import re
import tomllib
from collections import Counter

import places
import pytest

ROOT = places.ROOT


def test_every_benchmark_runs_once():
    recipe = re.search(r"^bench:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)[1]
    runs = Counter(re.findall(r"benchmarks/(\w+)\.py", recipe))
    programs = {path.stem for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text()}
    assert programs >= {"speed", "accuracy", "faults"}
    assert runs == dict.fromkeys(programs, 1)


TARGETS = {
    target for line in re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.M) for target in line.split()
}
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def test_the_targets_that_everybody_knows_are_there():
    assert {"demo", "test", "check", "bench", "clean", "wheel"} <= TARGETS


@pytest.mark.parametrize(
    "path", [*WORKFLOWS, ROOT / ".ci" / "run", ROOT / "CONTRIBUTING.md"], ids=lambda path: path.name
)
def test_only_targets_that_exist_are_run(path):
    called = set(re.findall(r"^(?:.*run: |    )?make ([a-z]+)", path.read_text(), re.M))
    assert called
    assert called <= TARGETS


def test_the_conda_recipe_requires_what_the_package_requires():
    listed = set(re.findall(r"^    - ([\w-]+ >=[\d.]+)$", (ROOT / "recipe" / "recipe.yaml").read_text(), re.M))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    python = "python " + project["project"]["requires-python"]
    assert listed - {"cmake >=3.18"} == {python, *(requirement.replace(">=", " >=") for requirement in needed)}
