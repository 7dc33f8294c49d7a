"""
A sensor that is late
=====================

A delay between voltage and displacement widens the loops. dehyst estimates it, and does not take it for hysteresis.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

# %%
# The loops are at 1 Hz, with 500 samples a second; the sensor is 4 ms late.
delay = 4e-3
stage = PlayActuator(asymmetry=0.0, bend=0.0)
tops = descending_tops(200, drive=Sampling(frequency=1, sample_rate=500))
moved = stage.play(tops.voltage, measured=False)
noise = np.random.default_rng(1).normal(0, 2e-9, moved.size)
measured = np.interp(tops.time - delay, tops.time, moved) + noise
record = dehyst.Record(tops.time, tops.voltage, measured, name="late")

# %%
# The identification also searches for the delay. ``delay=0`` forbids a delay.
fit = dehyst.identify(record, structure="maxwell_slip")
without = dehyst.identify(record, structure="maxwell_slip", delay=0)
print(f"delay: {1e3 * fit.actuator.delay:.2f} ms")
for name, found in ("with it", fit), ("delay=0", without):
    print(f"{name}: {found.errors[0].rms_percent:.3f} % of the stroke RMS on the record")

# %%
# A model that takes the delay for hysteresis is wrong at other speeds: here on loops so slow that the delay has no
# effect.
slowly = Sampling(frequency=0.01, sample_rate=4)
slow = raised_cosine([200.0, 120.0], cycles=2, drive=slowly)
truth = stage.play(slow.voltage, measured=False)
known = slow.time > 100  # after the first loop the state is known
figure, axes = plt.subplots()
for name, actuator in ("with the delay", fit.actuator), ("delay=0", without.actuator):
    simulated = actuator.simulate(slow.voltage).displacement
    error = 100 * (truth - simulated)[known] / stage.stroke
    axes.plot(slow.time[known], error - error.mean(), label=name)
axes.set(xlabel="time (s)", ylabel="error (% of the stroke)")
axes.legend()
plt.show()
