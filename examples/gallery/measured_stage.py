"""
A stage that others measured
============================

Aye and Ang (2018) recorded a PICMA P-885.91 stack in a flexure micromanipulator, with noise, drift, a start-up
transient and a lag of sensor or amplifier. A model is identified from the first part and predicts the rest.
"""

from dataclasses import replace
from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np

import dehyst

# %%
# The files are in the repository, in ``examples/measured/p885``, with their source and licence. ``major`` has 40 cycles
# of one height, ``ramps`` has cycles that shrink and grow again. The growing cycles are held out.
data = "../measured/p885"
major, ramps = (dehyst.read(f"{data}/{name}.csv", "voltage=drive_V") for name in ("major", "ramps"))
known, rest = replace(ramps[:4500], name="shrinking"), replace(ramps[4500:], name="growing")
fit = dehyst.identify([major, known], validate=rest)
print(fill(str(fit), 85))

# %%
# The prediction of the held-out part, beside the best straight line through the same samples. The peaks of the sensor's
# noise are 0.5 % of the stroke: the model causes only a small part of the remaining error.
unseen = fit.traces[-1]
straight = np.polyval(np.polyfit(unseen.voltage, unseen.measured, 1), unseen.voltage)
figure, (loops, errors) = plt.subplots(1, 2, figsize=(11, 4))
loops.plot(unseen.voltage, 1e6 * unseen.measured, ".", markersize=1, label="measured")
loops.plot(unseen.voltage, 1e6 * unseen.simulated, linewidth=0.6, label="predicted")
loops.set(xlabel="command before the amplifier (V)", ylabel="displacement (um)")
for name, predicted in ("straight line", straight), ("model", unseen.simulated):
    error = 100 * (unseen.measured - predicted) / major.stroke
    errors.plot(unseen.time - unseen.time[0], error, linewidth=0.6, label=name)
    print(f"{name}: {abs(error).max():.2f} % of the stroke at most, {np.sqrt(np.mean(error**2)):.2f} % RMS")
errors.set(xlabel="time (s)", ylabel="error (% of the stroke)")
for panel in loops, errors:
    panel.legend()
plt.show()
