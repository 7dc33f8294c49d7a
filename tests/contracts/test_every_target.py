"""What every target of exports must do. The tests are those of `dehyst.testing`."""

import subprocess

import compiled_exports
import node_programs
import numpy as np
import pytest

from dehyst.exports.targets import TARGETS
from dehyst.testing import TargetCandidate, TargetContract

PROGRAM = r"""
#include <stdio.h>
#include "piezo.h"
int main(void)
{
    static piezo p;
    double wanted;
    if (piezo_begin(&p) != DEHYST_OK) return 1;
    while (scanf("%lf", &wanted) == 1) printf("%.17g\n", (double)piezo_step(&p, wanted));
    return 0;
}
"""

STEPS = """
const compensator = new Compensator(module);
write("voltage", read("wanted").map((one) => compensator.step(one)));
"""


def by_c(folder, wanted):
    compiled_exports.need("gcc")
    (folder / "run.c").write_text(PROGRAM)
    sources = [str(path) for path in folder.glob("*.c") if path.name != "check.c"]
    subprocess.run(["gcc", "-O1", "-ffp-contract=off", "-o", folder / "run", *sources, "-lm"], check=True)
    given = "\n".join(map(repr, wanted.tolist()))
    done = subprocess.run([folder / "run"], input=given, check=True, capture_output=True, text=True)
    return np.array(done.stdout.split(), dtype=float)


def by_node(path, wanted):
    node_programs.node(path.parent, STEPS, wanted=wanted)
    return node_programs.column(path.parent, "voltage").view(float)


# Voltages of an FMU are compared in tests/exports/test_fmu.py.
TARGETS_HERE = [
    TargetCandidate("", by_c, tolerance=0.0, temperature=True),
    TargetCandidate(".wasm", by_node, tolerance=0.0, temperature=True),
    TargetCandidate(".fmu"),
]


def test_every_target_is_here():
    assert {one.suffix for one in TARGETS_HERE} == set(TARGETS)


class TestEveryTarget(TargetContract):
    @pytest.fixture(params=TARGETS_HERE, ids=lambda candidate: candidate.suffix or "C")
    def candidate(self, request):
        return request.param


def test_a_candidate_without_voltages_says_by_a_skip_that_none_is_compared(tmp_path):
    with pytest.raises(pytest.skip.Exception):
        TargetContract().test_narrower_limits_hold(TargetCandidate(""), tmp_path)
