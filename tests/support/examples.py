"""The part of a slow test that a push runs: a share of the examples and of a grid; `make nightly` runs all."""

import os
from itertools import product

import pytest
from hypothesis import settings

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"


def examples(share, *, nightly):
    """Settings of Hypothesis with `share` examples, or with those of the profile `nightly` if it was chosen."""
    return settings(max_examples=nightly if NIGHTLY else share)


def at_night(*values):
    """Values of `pytest.mark.parametrize` that only `make nightly` runs."""
    return pytest.param(*values, marks=pytest.mark.nightly)


def spanning(*columns):
    """All combinations of some columns of values; in a push, combinations in which each value occurs at least once."""
    longest = max(map(len, columns))
    pushed = {tuple(at % len(column) for column in columns) for at in range(longest)}
    return [
        (pytest.param if at in pushed else at_night)(*(column[i] for column, i in zip(columns, at, strict=True)))
        for at in product(*(range(len(column)) for column in columns))
    ]
