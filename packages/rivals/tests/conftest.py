"""What the tests of the package share with those of dehyst; `make test` installs the package and runs both."""

import profiles  # noqa: F401 - loads the profile of Hypothesis
import pytest

from dehyst._threads import one_thread

pytest.importorskip("dehyst_rivals", reason="dehyst-rivals is not installed: pip install ./packages/rivals")


@pytest.fixture(scope="session", autouse=True)
def blas_on_one_thread():
    """Oracles solve too, and spinning BLAS threads take the processors from what is being tested."""
    with one_thread():
        yield
