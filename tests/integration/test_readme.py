"""The README keeps its word: its figures are the benchmarks', its code runs, its files exist."""

import re
from pathlib import Path
from types import SimpleNamespace

import pages
import places
import pytest
from summaries import PARTS, anatomy
from virtual_loops import record_loops

import dehyst
from dehyst.records import write_record

ROOT = places.ROOT


@pytest.mark.parametrize("page", pages.BLOCKS)
def test_figures_are_those_of_the_benchmarks(page):
    assert (ROOT / page).read_text() == pages.filled(page), "run benchmarks/pages.py"


def its_code():
    return "\n".join(re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL))


def test_the_code_of_the_readme_runs(tmp_path, monkeypatch, capsys):
    code = its_code()
    write_record(tmp_path / "loops.csv", record_loops()[0])
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(code, names)
    verdict, *_ = capsys.readouterr().out.splitlines()
    assert verdict == str(names["fit"])
    assert names["plan"].voltage.size > names["wanted"].size == 2000
    assert not names["plan"].clamped.any()
    assert names["plan"].error.largest < 1e-8
    assert names["compensator"].clamps == (0, 0)


@pytest.mark.parametrize("kind", PARTS)
def test_the_code_of_the_readme_runs_with_every_kind_of_model(kind, monkeypatch, capsys):
    fit = SimpleNamespace(actuator=anatomy(kind), outcome=dehyst.model.Outcome.IDENTIFIED, errors=())
    monkeypatch.setattr(dehyst, "read", lambda path: None)
    monkeypatch.setattr(dehyst, "identify", lambda record: fit)
    names = {}
    exec(its_code(), names)
    assert not names["plan"].clamped.any()
    assert names["compensator"].clamps == (0, 0)
    assert capsys.readouterr().out.splitlines()[-1].startswith("Clamps(limited=0, slewed=0)")


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "docs/explanation/where_to_add.md"])
def test_the_files_named_on_a_page_exist(page):
    text = (ROOT / page).read_text()
    links = [link for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link]
    modules = re.findall(r"`((?:[a-z_]+/)*[a-z_]+\.(?:py|h|c|cpp))`", text)
    folders = ("", "src/dehyst", "tests", "core", Path(page).parent)
    missing = [name for name in (*links, *modules) if not any((ROOT / place / name).exists() for place in folders)]
    assert missing == []
    assert links or modules
