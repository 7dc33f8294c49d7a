"""The commands of the Makefile."""

import re
from collections import Counter

import places

ROOT = places.ROOT


def test_every_benchmark_runs_once():
    recipe = re.search(r"^bench:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.M)[1]
    runs = Counter(re.findall(r"benchmarks/(\w+)\.py", recipe))
    programs = {path.stem for path in (ROOT / "benchmarks").glob("*.py") if "__main__" in path.read_text()}
    assert programs >= {"speed", "accuracy", "faults"}
    assert runs == dict.fromkeys(programs, 1)
