"""The second opinion on the core: the model written down as slowly and plainly as possible, in NumPy alone.

Nothing here is shared with the package. Elements are stop operators stepped one sample at a time; the spring is
`numpy.interp` with linear ends; a voltage is inverted by bisection on the strictly increasing force balance.
"""

import numpy as np


def spring(y, knots, values):
    """Voltage of the parallel spring: piecewise linear, continued linearly beyond its knots."""
    if y < knots[0]:
        return values[0] + (y - knots[0]) * (values[1] - values[0]) / (knots[1] - knots[0])
    if y > knots[-1]:
        return values[-1] + (y - knots[-1]) * (values[-1] - values[-2]) / (knots[-1] - knots[-2])
    return float(np.interp(y, knots, values))


def compensate(rho, kappa, knots, values, start, carts, path):
    """Stop operators s <- clip(s + dy, -rho, rho), one sample at a time. Returns voltages, last y, carts."""
    elongation, y, voltages = start - np.asarray(carts, float), start, []
    for target in path:
        elongation = np.clip(elongation + (target - y), -rho, rho)
        y = target
        voltages.append(float(kappa @ elongation) + spring(y, knots, values))
    return np.array(voltages), y, y - elongation


def simulate(rho, kappa, knots, values, start, carts, voltages):
    """Bisection for y in the force balance from the last state. Returns displacements, last y, carts."""
    elongation, y, path = start - np.asarray(carts, float), start, []

    def balance(target):
        return float(kappa @ np.clip(elongation + (target - y), -rho, rho)) + spring(target, knots, values)

    reach = knots[-1] - knots[0]
    for voltage in voltages:
        low, high = y - reach, y + reach
        while balance(low) > voltage:
            low -= reach
        while balance(high) < voltage:
            high += reach
        while True:
            middle = 0.5 * (low + high)
            if middle in (low, high):
                break
            low, high = (middle, high) if balance(middle) < voltage else (low, middle)
        elongation = np.clip(elongation + (high - y), -rho, rho)
        y = high
        path.append(y)
    return np.array(path), y, y - elongation
