"""An independent reference for the core: the model in the simplest form, in NumPy alone.

It shares nothing with the package. Elements are stop operators that step one sample at a time; a voltage is inverted by
bisection on the strictly increasing force balance.
"""

import numpy as np


def line(x, knots, values):
    """The value of a piecewise-linear curve, continued linearly, at a place."""
    j = min(max(int(np.searchsorted(knots, x)) - 1, 0), len(knots) - 2)
    return values[j] + (x - knots[j]) * (values[j + 1] - values[j]) / (knots[j + 1] - knots[j])


def smooth_step(length, closing, q, step):
    """Elongations of smooth elements after a step: motion in one direction follows one curve r(u).

    r(u) = length (1 - exp(-u / length)) for u > 0 and (1 - exp(-rate u)) / rate for u < 0, with
    rate = (2 closing - 1) / length.
    """
    rate = np.maximum((2 * closing - 1) / length, 1e-30 / length)
    sign = 1.0 if step > 0 else -1.0
    r = np.clip(sign * q, -length, length)
    with np.errstate(divide="ignore"):
        u = np.where(r > 0, -length * np.log1p(-np.maximum(r, 0) / length), -np.log1p(-rate * np.minimum(r, 0)) / rate)
    u = u + abs(step)
    loaded = -length * np.expm1(-np.maximum(u, 0) / length)
    return sign * np.where(u > 0, loaded, -np.expm1(-rate * np.minimum(u, 0)) / rate)


class Reference:
    """Slip elements, plain or graded, a transformer, smooth elements and creep, one sample at a time.

    Creep has low-pass states z_k of y, the displacement before creep, which bisection finds.
    """

    def __init__(self, actuator, state):
        self.slip, self.spring, self.tau, self.smooth = (
            actuator.slip,
            actuator.spring,
            actuator.transformer,
            actuator.smooth,
        )
        creep = actuator.displacement_creep
        self.times, self.gains = (creep.time_constants, creep.gains) if creep else (np.zeros(0), np.zeros(0))
        self.y, self.carts, self.q = state.deformation, np.array(state.carts), np.array(state.smooth)
        self.z = self.y - (state.displacement_creep if state.displacement_creep.size else np.zeros(self.gains.size))

    def dragged(self, y):
        return np.clip(self.carts, y - self.slip.breakaway, y + self.slip.breakaway)

    def elongated(self, y):
        return smooth_step(self.smooth.length, self.smooth.closing, self.q, y - self.y) if self.smooth else self.q

    def psi(self, i, z):
        rises = self.slip.stiffness[i] * np.diff(self.slip.knots)
        return line(z, self.slip.knots, np.concatenate([[0.0], np.cumsum(rises)]))

    def drive(self, y):
        """Voltage behind the transformer that holds the actuator at y."""
        carts, held = self.dragged(y), line(y, self.spring.displacement, self.spring.voltage)
        if self.smooth:
            held += float(self.smooth.stiffness @ self.elongated(y))
        if not hasattr(self.slip, "knots"):
            return held + float(self.slip.stiffness @ (y - carts))
        return held + sum(self.psi(i, y) - self.psi(i, cart) for i, cart in enumerate(carts))

    def low_passes(self, y, dt):
        """Each z' = (y - z) / tau, while y changes linearly from its present value within dt."""
        if dt == 0:
            return self.z
        part = -np.expm1(-dt / self.times)
        return self.z + (self.y - self.z) * part + (y - self.y) / dt * (dt - self.times * part)

    def crept(self, y, dt):
        """The displacement with creep after a step."""
        return y + float(self.gains @ self.low_passes(y, dt))

    def without_creep(self, u, dt):
        """The y for which `crept` is u; `crept` is linear in y."""
        still = self.crept(self.y, dt)
        follows = 1 - self.times / dt * -np.expm1(-dt / self.times) if dt else np.zeros(self.gains.size)
        return self.y + (u - still) / (1 + float(self.gains @ follows))

    def commit(self, y, dt):
        self.z, self.q, self.carts = self.low_passes(y, dt), self.elongated(y), self.dragged(y)
        self.y = y

    def compensate(self, path, time):
        """Voltages along displacements."""
        voltages = []
        for u, dt in zip(path, np.diff(time, prepend=time[:1]), strict=True):
            y = self.without_creep(u, dt)
            drive = self.drive(y)
            voltages.append(drive if self.tau is None else line(drive, self.tau.drive, self.tau.voltage))
            self.commit(y, dt)
        return np.array(voltages)

    def simulate(self, voltages, time):
        """Displacements along voltages, by bisection."""
        path, reach = [], float(np.ptp(self.spring.displacement))
        for v, dt in zip(voltages, np.diff(time, prepend=time[:1]), strict=True):
            drive = v if self.tau is None else line(v, self.tau.voltage, self.tau.drive)
            low, high = self.y - reach, self.y + reach
            while self.drive(low) > drive:
                low -= reach
            while self.drive(high) < drive:
                high += reach
            while low < (middle := 0.5 * (low + high)) < high:
                low, high = (middle, high) if self.drive(middle) < drive else (low, middle)
            path.append(self.crept(high, dt))
            self.commit(high, dt)
        return np.array(path)
