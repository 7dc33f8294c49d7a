"""How many examples a slow property is tried on: a share in the test command, all in `make nightly`."""

import os

from hypothesis import settings

NIGHTLY = os.environ.get("HYPOTHESIS_PROFILE") == "nightly"


def examples(share, *, nightly):
    """Settings of Hypothesis with `share` examples, or those of `nightly` where that profile was chosen."""
    return settings(max_examples=nightly if NIGHTLY else share)
