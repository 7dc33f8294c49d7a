"""A share of the seeded attacks of `tests/fuzz`; the rest runs with -m fuzz, or by their command lines."""

import json
import subprocess
import sys

import places
import pytest
import sanitized

FUZZ = places.FUZZ


def attacked(*command, env=None):
    """The summary of a fuzzer, which must have found nothing."""
    words = [sys.executable, *map(str, command)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, env=env)
    assert done.stdout, done.stderr[-2000:]
    summary = json.loads(done.stdout)
    assert not summary["findings"], summary["findings"][:5]
    assert done.returncode == 0
    return summary


@pytest.mark.fuzz
def test_all_attacks_on_the_sanitized_package_find_nothing(tmp_path):
    if missing := sanitized.missing():
        pytest.skip(f"{missing} is not installed: the package cannot be built under sanitizers")
    environment = sanitized.environment(sanitized.build(tmp_path))
    assert attacked(FUZZ / "compensators.py", "--seed", 5, "--count", 10_000, env=environment)["cases"] == 10_000


@pytest.mark.fuzz
def test_no_voltage_jumps_in_ten_thousand_lives():
    assert attacked(FUZZ / "compensators.py", "--seed", 5, "--count", 10_000)["cases"] == 10_000


def test_a_crash_and_a_hang_are_findings(tmp_path):
    """The runner itself: what ends its process is found, and the other cases are played."""
    program = tmp_path / "fuzzer.py"
    program.write_text(f"""
import os, signal, sys
sys.path.insert(0, {str(FUZZ)!r})
import batches
batches.HANG = 1
def play(seed, case, note):
    note("played")
    if case == 3:
        os.kill(os.getpid(), signal.SIGSEGV)
    if case == 5:
        raise KeyError("x")
    while case == 7:
        pass
    return ["wrong"] if case == 8 else []
batches.main("test", play)
""")
    done = subprocess.run([sys.executable, program, "--count", "10"], capture_output=True, text=True, check=False)
    summary = json.loads(done.stdout)
    assert (done.returncode, summary["cases"]) == (1, 10)
    assert [found["case"] for found in summary["findings"]] == [3, 5, 7, 8]
    for found, words in zip(summary["findings"], ("signal 11", "KeyError", "hang", "wrong"), strict=True):
        assert words in found["what"]
