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
def test_fuzz_tests_of_the_sanitized_package_find_no_fault(tmp_path):
    if missing := sanitized.missing():
        pytest.skip(f"{missing} is not installed: the package cannot be built under sanitizers")
    environment = sanitized.environment(sanitized.build(tmp_path))
    assert attacked(FUZZ / "compensators.py", "--seed", 5, "--count", 10_000, env=environment)["cases"] == 10_000


@pytest.mark.fuzz
def test_no_voltage_jumps_in_ten_thousand_random_sequences_of_calls():
    assert attacked(FUZZ / "compensators.py", "--seed", 5, "--count", 10_000)["cases"] == 10_000
