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
def test_who_runs_the_targets_names_those_that_exist(path):
    called = set(re.findall(r"^(?:.*run: |    )?make ([a-z]+)", path.read_text(), re.M))
    assert called
    assert called <= TARGETS


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_runs_no_other_checks_than_a_contributor(path):
    """What builds or tests is a target; else CI and a contributor drift apart."""
    text = path.read_text()
    assert re.findall(r"\b(?:pytest|ruff|mypy|lint-imports|cmake|gcc) ", text) == []
    assert "not been run" in text


def test_the_hooks_before_a_commit_are_those_of_the_check():
    recipe = re.search(r"^check:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)[1]
    checks = {line.removeprefix("\t$(BIN)/").removesuffix(" .") for line in recipe.splitlines() if "$(BIN)/" in line}
    hooks = re.findall(r"entry: \.venv/bin/(.*)", (ROOT / ".pre-commit-config.yaml").read_text())
    assert {hook.split()[0] for hook in hooks} == {check.split()[0] for check in checks}
    assert {"ruff check", "ruff format --check"} <= set(hooks)


def test_the_conda_recipe_requires_what_the_package_requires():
    listed = set(re.findall(r"^    - ([\w-]+ >=[\d.]+)$", (ROOT / "recipe" / "recipe.yaml").read_text(), re.M))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    needed = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    python = "python " + project["project"]["requires-python"]
    assert listed - {"cmake >=3.18"} == {python, *(one.replace(">=", " >=") for one in needed)}
