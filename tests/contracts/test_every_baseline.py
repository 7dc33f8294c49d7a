"""What every baseline must do. The tests are those of `dehyst.testing`."""

from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
import pytest

from dehyst import State
from dehyst.baselines import BASELINES, AbstractBaseline
from dehyst.testing import BaselineCandidate, BaselineContract

DICE = np.random.default_rng()


class TestEveryBaseline(BaselineContract):
    @pytest.fixture(params=BASELINES.own)
    def candidate(self, request):
        return BaselineCandidate(request.param)


@dataclass(frozen=True)
class Line(AbstractBaseline):
    slope: float
    delay: float = 0.0
    state = State(0.0, [])

    def _run(self, drive, state, time, *, inverse):
        return (drive / self.slope if inverse else self.slope * drive), state


def line(factor, delay=0.0, spread=0.0):
    """Return a fit of a straight line whose slope is right if the factor is 1."""

    def fit(records):
        slope = np.polyfit(records[0].voltage, records[0].displacement, 1)[0]
        return Line(factor * DICE.uniform(1, 1 + spread) * slope, delay)

    return fit


FITS = {
    "right": line(1.0),
    "far": line(1e7),
    "inverted": line(-1.0),
    "no number": line(np.nan),
    "late": line(1.0, 1e3),
    "early": line(1.0, -0.1),
    "another each time": line(1.0, 0.0, 0.01),
    "nothing": lambda records: None,
    "mistake": lambda records: 1 / 0,
}


@pytest.mark.parametrize("kind", FITS)
def test_a_wrong_fit_is_noticed(monkeypatch, kind):
    known = {"linear ratio": BASELINES["linear ratio"], **FITS}
    monkeypatch.setattr("dehyst.testing.models.BASELINES", known)
    contract, candidate = BaselineContract(), BaselineCandidate(kind)

    with nullcontext() if kind == "right" else pytest.raises(AssertionError):
        contract.test_errors_are_not_far_beyond_those_of_a_straight_line(candidate)
        contract.test_the_delay_lies_within_the_records(candidate)
        contract.test_the_same_records_give_the_same_model(candidate)
