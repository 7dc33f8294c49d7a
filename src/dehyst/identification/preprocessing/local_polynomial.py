"""Smoothing and derivatives by polynomials through neighbours (Savitzky and Golay 1964, Anal. Chem. 36, 1627).

SciPy has the same filter, in a module whose import takes longer than the identification of a plain actuator.
"""

from __future__ import annotations

from math import factorial

import numpy as np

from dehyst._types import Array


def local_polynomial(y: Array, window: int, order: int, derivative: int = 0, step: float = 1.0) -> Array:
    """Return the value or a derivative at each sample of the polynomial that fits its neighbours best.

    Parameters
    ----------
    y : (n,) array
        Evenly sampled, n >= window.
    window, order : int
        Samples of a polynomial, an odd number, and its order; the first and last half window have one polynomial each.
    derivative : int, optional
        0: the value.
    step : float, optional
        Sample time [s].

    Returns
    -------
    (n,) array
    """
    half = window // 2
    places = np.arange(-half, half + 1.0)
    powers = np.vander(places, order + 1, increasing=True)
    inverse = np.linalg.pinv(powers)
    scale = factorial(derivative) / step**derivative
    result = np.empty(y.size)
    result[half : y.size - half] = np.convolve(y, inverse[derivative, ::-1] * scale, mode="valid")
    for ends, samples in ((slice(0, half), y[:window]), (slice(y.size - half, None), y[-window:])):
        polynomial = np.polynomial.Polynomial(inverse @ samples).deriv(derivative)
        own = places[:half] if ends.start == 0 else places[half + 1 :]
        result[ends] = polynomial(own) / step**derivative
    return result
