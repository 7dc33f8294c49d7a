"""Folders of the repository, and its measured data."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS, CORE, DOCS, EXAMPLES = (ROOT / name for name in ("benchmarks", "core", "docs", "examples"))
# Headers and sources of the core.
_CORE = sorted(path for name in ("include", "src") for path in (CORE / name).rglob("*.[ch]"))
# A bank is for Python only, and is compiled twice: `core/tests/strict_build.sh` builds it with the same warnings.
CORE_FILES = tuple(path for path in _CORE if "bank" not in (path.parent.name, path.stem.removeprefix("dehyst_")))
SOURCES = ROOT / "src" / "dehyst"
RIVALS = ROOT / "packages" / "rivals" / "src" / "dehyst_rivals"
TESTS = ROOT / "tests"
FUZZ, SUPPORT = TESTS / "fuzz", TESTS / "support"
DATA = EXAMPLES / "measured" / "p885"
