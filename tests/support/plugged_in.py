"""Distributions that are installed for a test only: a module and its entry points in a folder of `sys.path`."""

import contextlib
import sys
import tomllib
from unittest.mock import patch

from dehyst.baselines import BASELINES
from dehyst.exports import TARGETS
from dehyst.instruments import SCHEMES
from dehyst.records import LOADERS
from dehyst.records.formats import reader_process


def write_distribution(folder, name, groups, code="", version="1.0"):
    """Write a distribution with one module into a folder; `groups`: group -> lines of entry points."""
    module = name.replace("-", "_")
    info = folder / f"{module}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [f"[dehyst.{group}]\n{text}\n" for group, text in groups.items()]
    (info / "entry_points.txt").write_text("\n".join(lines))
    (folder / f"{module}.py").write_text(code)


def describe(project, folder):
    """Write what an installation writes of a project with a pyproject.toml into a folder; its `src` is imported."""
    about = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    groups = {
        name.removeprefix("dehyst."): "\n".join(f"{key} = {value}" for key, value in points.items())
        for name, points in about["entry-points"].items()
    }
    write_distribution(folder, about["name"], groups, version=about["version"])
    # Only what describes it: the module itself is in the project.
    next(folder.glob("*.py")).unlink()


@contextlib.contextmanager
def plugged_in(*folders):
    """Install the distributions of folders: plug-ins are searched anew within, and after."""
    with patch.object(sys, "path", [*map(str, folders), *sys.path]):
        _forget()
        try:
            yield
        finally:
            _forget()


def _forget():
    reader_process.close()
    for registry in (LOADERS, SCHEMES, BASELINES, TARGETS):
        vars(registry).pop("plugins", None)
        registry._added.clear()
