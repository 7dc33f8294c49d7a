"""The profile of Hypothesis: without time limits, and with the same examples at each push."""

import os

from hypothesis import HealthCheck, settings

# Shared machines stall: with a time limit for each example, correct tests would fail. A push tries the same examples
# each time, so that it does not fail by chance; `make nightly` tries new ones.
settings.register_profile(
    "dehyst", deadline=None, max_examples=20, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("nightly", settings.get_profile("dehyst"), max_examples=80, derandomize=False)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "dehyst"))
