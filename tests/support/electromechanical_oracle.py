"""A piezoelectric stack as an electric circuit, integrated by SciPy: an independent reference for the actuator.

It shares neither code nor coordinates with the package. The equations are those of Goldfarb and Celanovic, in charges
and volts:

    v = sum_i u_i + g(q / T) / T + (q - T y) / C,        u_i = (q - b_i) k_i / T^2
    km y = T (q - T y) / C + F

Coulomb friction keeps the charge b_i of element i where it is while |u_i| < f_i / T. It is regularised: beyond the
break voltage a resistor R lets b_i follow, R b_i' = u_i -+ f_i / T, and the friction is dry in the limit of no R.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True, eq=False)
class Stack:
    """The paper's numbers: T [N/V], km, ke [N/m], k_i [N/m], f_i [N], and g [N] at places x [m], linear between."""

    ratio: float
    km: float
    ke: float
    stiffness: np.ndarray
    friction: np.ndarray
    x: np.ndarray
    g: np.ndarray

    @property
    def capacitance(self):
        return self.ratio**2 / self.ke

    @property
    def volts_per_charge(self):
        """Voltage per charge of each element."""
        return self.stiffness / self.ratio**2

    @property
    def break_volts(self):
        return self.friction / self.ratio

    def displacement(self, charge, load=0.0):
        """At rest: km y = T (q - T y) / C + F."""
        return (self.ratio * charge / self.capacitance + load) / (self.km + self.ke)

    def circuit_voltage(self, charge, displacement):
        """Voltage of the nonlinear capacitor plus that of the linear one."""
        curved = line(charge / self.ratio, self.x, self.g) / self.ratio
        return curved + (charge - self.ratio * displacement) / self.capacitance

    def charge_of(self, voltage, slope, knots_voltage):
        """Solve voltage = slope q + V(q) for q; V is linear between the knots of g."""
        charges = self.ratio * self.x
        return line(voltage, slope * charges + knots_voltage, charges)


def line(at, places, values):
    """A curve that is linear between the places, and continues linearly beyond the first and the last place."""
    at = np.asarray(at, float)
    k = np.clip(np.searchsorted(places, at) - 1, 0, len(places) - 2)
    slope = (values[k + 1] - values[k]) / (places[k + 1] - places[k])
    return values[k] + slope * (at - places[k])


def branches(turns, samples):
    """Half cosines from each turn to the next, one second each: times, and the voltage as a function of time."""
    turns = np.asarray(turns, float)

    def voltage(t):
        k = np.clip(np.asarray(t, float).astype(int), 0, turns.size - 2)
        return turns[k] + (turns[k + 1] - turns[k]) * (0.5 - 0.5 * np.cos(np.pi * (t - k)))

    return np.arange((turns.size - 1) * samples + 1) / samples, voltage


def quasi_static(stack, time, voltage, resistance, *, carts=None, load=lambda t: 0.0):
    """Charges and displacements (n,) of a stack without mass under a voltage and a load, functions of time.

    It starts with the charges `carts` (N,) of its elements; default: relaxed.
    """
    e, c = stack.volts_per_charge, stack.capacitance
    charges = stack.ratio * stack.x

    def charge(t, b):
        # y is eliminated: the part of y due to the load does not depend on the charge.
        alone = stack.circuit_voltage(charges, stack.displacement(charges))
        return stack.charge_of(voltage(t) + e @ b + stack.ratio / c * stack.displacement(0.0, load(t)), e.sum(), alone)

    def rates(t, b):
        return _slip(stack, charge(t, b) - b, resistance)

    start = np.zeros(e.size) if carts is None else carts
    b = _integrated(rates, time, start, 1e-12 * np.ptp(charges))
    q = np.array([charge(*at) for at in zip(time, b.T, strict=True)])
    return q, stack.displacement(q, np.array([load(t) for t in time]))


def _slip(stack, elongation, resistance):
    u = stack.volts_per_charge * elongation
    return (u - np.clip(u, -stack.break_volts, stack.break_volts)) / resistance


def _integrated(rates, time, start, atol):
    # No step is longer than a twentieth of a branch: near a turn all derivatives are small.
    found = solve_ivp(
        rates, (time[0], time[-1]), start, method="LSODA", t_eval=time, rtol=1e-8, atol=atol, max_step=0.05
    )
    assert found.success, found.message
    return found.y
