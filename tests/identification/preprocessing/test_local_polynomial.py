"""Polynomials through neighbours, against SciPy's filter and a polynomial that they reproduce."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from dehyst.identification.preprocessing.denoising import local_polynomial


@pytest.mark.parametrize(
    ("window", "order", "derivative"),
    [(n, order, k) for n, order in ((5, 2), (9, 4), (13, 2), (3, 1)) for k in range(min(order, 2) + 1)],
)
@pytest.mark.parametrize("size", [13, 14, 200])
def test_it_is_the_filter_of_savitzky_and_golay(window, order, derivative, size):
    y = np.random.default_rng(size).normal(size=size)
    ours = local_polynomial(y, window, order, derivative, 0.01)
    theirs = savgol_filter(y, window, order, deriv=derivative, delta=0.01)
    assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-9 * np.abs(theirs).max())


def test_a_polynomial_keeps_its_derivative_up_to_the_ends():
    t = 0.1 * np.arange(50)
    assert local_polynomial(1 + t**3, 9, 4, 1, 0.1) == pytest.approx(3 * t**2, abs=1e-9)
