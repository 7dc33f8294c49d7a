"""
Compared with a straight gain
=============================

Drive a stage with a constant ratio of voltage to displacement, and with the compensator.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
sampling = Sampling(sample_rate=4)
tops = descending_tops(stage.highest, drive=sampling)
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
fit = dehyst.identify(record)

# %%
# The path begins at the bottom of the range, and has reversals at different heights.
corners = np.array([0.0, 0.9, 0.3, 0.7, 0.4, 0.6, 0.1, 0.8, 0.2])
place = np.linspace(0, corners.size - 1, 2000)
wanted = stage.stroke * (0.02 + 0.95 * np.interp(place, np.arange(corners.size), corners))

# %%
# Both begin after the same homing, up to the top and down to 0 V, after which the state is known.
homing = np.concatenate([np.linspace(0, 200, 400), np.linspace(200, 0, 400)])
homed = fit.actuator.simulate(homing).state
zero = fit.actuator.displacement(homed)
voltage = dehyst.plan_path(fit.actuator, zero + wanted, limits=(0, 200), start=homed).voltage

stage.play(homing)
compensated = stage.play(voltage, measured=False)
stage.play(homing)
linear = stage.play(wanted * stage.highest / stage.stroke, measured=False)

# %%
# Errors in percent of the stroke.
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
above.plot(1e6 * wanted, color="black", label="wanted")
above.plot(1e6 * (linear - zero), label="by a constant ratio")
above.plot(1e6 * (compensated - zero), "--", label="compensated")
above.set_ylabel("displacement (µm)")
above.legend(ncols=3)
for label, reached in ("by a constant ratio", linear), ("compensated", compensated):
    error = 100 * (reached - zero - wanted) / stage.stroke
    below.plot(error, label=label)
    print(f"{label}: {np.abs(error).max():.2f} % at most, {np.sqrt(np.mean(error**2)):.3f} % RMS")
below.set(xlabel="sample", ylabel="error (% of the stroke)")
below.legend()
plt.show()
