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


def smooth_step(length, closing, q, step):
    """Elongations of smooth elements after a step: all motion onward is motion along one curve r(u).

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


class Smooth:
    """A plain actuator with smooth elements, stepped one sample at a time and inverted by bisection."""

    def __init__(self, actuator, state):
        self.slip, self.curve, self.smooth = actuator.slip, actuator.spring, actuator.smooth
        self.y, self.elongation, self.q = state.deformation, state.deformation - state.carts, state.smooth

    def _reached(self, target):
        step = target - self.y
        elongation = np.clip(self.elongation + step, -self.slip.breakaway, self.slip.breakaway)
        q = smooth_step(self.smooth.length, self.smooth.closing, self.q, step)
        held = float(self.slip.stiffness @ elongation) + float(self.smooth.stiffness @ q)
        return held + spring(target, self.curve.displacement, self.curve.voltage), elongation, q

    def _move(self, target):
        voltage, self.elongation, self.q = self._reached(target)
        self.y = target
        return voltage

    def compensate(self, path):
        """Voltages along displacements."""
        return np.array([self._move(target) for target in path])

    def simulate(self, voltages):
        """Displacements along voltages."""
        path, reach = [], np.ptp(self.curve.displacement)
        for voltage in voltages:
            low, high = self.y - reach, self.y + reach
            while self._reached(low)[0] > voltage:
                low -= reach
            while self._reached(high)[0] < voltage:
                high += reach
            while (middle := 0.5 * (low + high)) not in (low, high):
                low, high = (middle, high) if self._reached(middle)[0] < voltage else (low, middle)
            self._move(high)
            path.append(high)
        return np.array(path)


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


def line(x, knots, values):
    """Any piecewise-linear curve, continued linearly, at one place."""
    j = min(max(int(np.searchsorted(knots, x)) - 1, 0), len(knots) - 2)
    return values[j] + (x - knots[j]) * (values[j + 1] - values[j]) / (knots[j + 1] - knots[j])


class Wide:
    """Graded elements, transformer and creep, one sample at a time; a plain element is one that has one grade.

    Creep is told by its low-passes z_k of y, the displacement before creep, which is found by bisection.
    """

    def __init__(self, actuator, state):
        slip = actuator.slip
        self.rho, self.spring, self.tau = slip.breakaway, actuator.spring, actuator.transformer
        self.knots = getattr(slip, "knots", np.array([0.0, 1.0]))
        self.grades = slip.stiffness.reshape(len(slip), self.knots.size - 1)
        creep = actuator.displacement_creep
        self.times, self.gains = (creep.time_constants, creep.gains) if creep else (np.zeros(0), np.zeros(0))
        self.y, self.carts = state.deformation, np.array(state.carts)
        self.z = self.y - (state.displacement_creep if state.displacement_creep.size else np.zeros(self.gains.size))

    def psi(self, i, z):
        rises = self.grades[i] * np.diff(self.knots)
        return line(z, self.knots, np.concatenate([[0.0], np.cumsum(rises)]))

    def low_passes(self, y, dt):
        """Each z' = (y - z) / tau, y rising evenly from the present one within dt."""
        if dt == 0:
            return self.z
        part = -np.expm1(-dt / self.times)
        return self.z + (self.y - self.z) * part + (y - self.y) / dt * (dt - self.times * part)

    def crept(self, y, dt):
        """The displacement with creep after a step."""
        return y + float(self.gains @ self.low_passes(y, dt))

    def without_creep(self, u, dt):
        """The y of which `crept` is u; it is linear in y."""
        still = self.crept(self.y, dt)
        follows = 1 - self.times / dt * -np.expm1(-dt / self.times) if dt else np.zeros(self.gains.size)
        return self.y + (u - still) / (1 + float(self.gains @ follows))

    def drive(self, y):
        held = line(y, self.spring.displacement, self.spring.voltage)
        for i, cart in enumerate(np.clip(self.carts, y - self.rho, y + self.rho)):
            held += self.psi(i, y) - self.psi(i, cart)
        return held

    def commit(self, y, dt):
        self.z = self.low_passes(y, dt)
        self.carts, self.y = np.clip(self.carts, y - self.rho, y + self.rho), y

    def compensate(self, path, time):
        voltages = []
        for u, dt in zip(path, np.diff(time, prepend=time[:1]), strict=True):
            y = self.without_creep(u, dt)
            drive = self.drive(y)
            voltages.append(drive if self.tau is None else line(drive, self.tau.drive, self.tau.voltage))
            self.commit(y, dt)
        return np.array(voltages)

    def simulate(self, voltages, time):
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
