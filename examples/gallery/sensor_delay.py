"""
A sensor that is late
=====================

A delay between voltage and displacement widens loops. It is estimated, and not taken for hysteresis.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

# %%
# Loops at 1 Hz, 500 samples a second, and a sensor that is 4 ms late.
delay = 4e-3
stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(frequency=1, sample_rate=500))
moved = stage.play(tops.voltage, measured=False)
noise = np.random.default_rng(1).normal(0, 2e-9, moved.size)
measured = np.interp(tops.time - delay, tops.time, moved) + noise
record = dehyst.Record(tops.time, tops.voltage, measured, name="late")

# %%
# The delay is searched for beside the model. ``delay=0`` forbids it.
fit = dehyst.identify(record, structure="paper")
without = dehyst.identify(record, structure="paper", delay=0)
print(f"delay: {1e3 * fit.actuator.delay:.2f} ms, error {fit.errors[0].rms_percent:.3f} % RMS")
print(f"no delay: error {without.errors[0].rms_percent:.3f} % RMS")

# %%
# Breakaway voltages of the elements. Without a delay the loop's extra width is given to small elements: such a model is
# wrong at any other speed.
figure, axes = plt.subplots()
for label, actuator in ("with the delay", fit.actuator), ("delay=0", without.actuator):
    slip = actuator.slip
    axes.plot(1e6 * slip.breakaway, slip.stiffness * slip.breakaway, "o-", label=label)
axes.set(xlabel="breakaway elongation (um)", ylabel="breakaway voltage (V)")
axes.legend()
plt.show()
