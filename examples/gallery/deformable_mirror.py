"""
A deformable mirror
===================

A thousand actuators, each with its own hysteresis, run at a kilohertz with one call per sample.
"""

import time

import matplotlib.pyplot as plt
import numpy as np

import dehyst

# %%
# The 1000 actuators differ by a few percent, like identified ones. Each has 10 Maxwell-slip elements.
random = np.random.default_rng(0)
knots = np.linspace(0, 1.2e-6, 9)


def actuator():
    breakaway = 0.05e-6 * np.arange(1, 11) * random.uniform(0.9, 1.1)
    spring = dehyst.Spring(knots, 70e6 * knots * random.uniform(0.95, 1.05) * (1 + 1e5 * knots))
    return dehyst.Actuator(dehyst.MaxwellSlip(breakaway, random.uniform(0, 4e6, 10)), spring, limits=(-10, 120))


actuators = [actuator() for _ in range(1000)]
bank = dehyst.Bank(actuators, slew_rate=1e5, period=1e-3)
print(bank)

# %%
# The wanted shape: a wave that runs over the mirror, 0.2 s of it.
angle = np.arange(1000) * 0.01
wanted = 0.5e-6 + 0.3e-6 * np.sin(2 * np.pi * 20 * np.arange(200)[:, None] / 1000 + angle)
seconds = []
for row in wanted:
    start = time.perf_counter()
    bank.step(row)
    seconds.append(time.perf_counter() - start)
print(f"{1e6 * np.median(seconds):.0f} µs a step, of 1000 µs")

# %%
# The motion of the mirror with the voltages of the bank, and with those of a constant gain.
gain = np.array([np.ptp(plant.spring.voltage) / np.ptp(plant.spring.displacement) for plant in actuators])
errors = {}
for name in ("constant gain", "compensated"):
    voltage = wanted * gain if name == "constant gain" else dehyst.Bank(actuators).run(wanted)
    moved = [plant.simulate(volts).displacement for plant, volts in zip(actuators, voltage.T, strict=True)]
    errors[name] = 1e9 * (np.transpose(moved) - wanted)
    print(f"{name}: {np.sqrt(np.mean(errors[name] ** 2)):.2g} nm RMS")

# %%
# These actuators are the models themselves: the compensated error is zero except for rounding. For measured actuators
# it is the error of the models.
figure, axes = plt.subplots()
for (name, error), colour in zip(errors.items(), ("C1", "black"), strict=True):
    lines = axes.plot(np.arange(200), error[:, ::75], color=colour, linewidth=0.8)
    lines[0].set_label(name)
axes.set(xlabel="time (ms)", ylabel="error of every 75th actuator (nm)")
axes.legend()
plt.show()
