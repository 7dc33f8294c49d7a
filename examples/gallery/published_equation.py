"""
A published equation, and its record
====================================

Chandra and others (2023) found an equation of five terms for a piezoelectric actuator by sparse regression, and
published the record with it. Here their comparison is repeated, with a model of dehyst beside the equation.
"""

from dataclasses import replace
from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import dehyst

# %%
# The file is in the repository, in ``examples/measured/sine150``, with its source and licence, and is read as its
# authors published it. They took two cycles of a sine for training; the earlier time is held out for both models.
columns = "time=2:s, displacement=3:um, voltage=4:V"
record = dehyst.read("../measured/sine150/hysteresis_v_150_1hz.csv", columns)
training = replace(record[35_000:45_000], name="training")
before = replace(record[:35_000], name="not seen")
fit = dehyst.identify(training, validate=before)
print(fill(" ".join(fit.summary().splitlines()[:2]), 85))


# %%
# The equation contains the frequency and the phase of the sine. Its authors begin at -14.030457 um; for the held-out
# time it begins at the measured displacement.
def slope(time, displacement):
    phase = 6.28318530724 * time - 46.2178545458
    drive = 0.581 * 150 * np.sin(phase) + 0.119 * 942.477796086 * np.cos(phase)
    return drive - 0.176 - 2.388 * displacement - 0.076 * displacement * np.abs(displacement)


def equation(time, start):
    return solve_ivp(slope, (time[0], time[-1]), [start], t_eval=time, rtol=1e-8, atol=1e-8).y[0]


# %%
# Errors of both on the same samples, in % of the stroke. The noise of the sensor is 0.11 % RMS. The model has a smaller
# RMS error, and a slightly larger maximum just after the turning points. Neither is tested at another height or
# frequency.
figure, panels = plt.subplots(1, 2, figsize=(11, 4), sharey=True)
for panel, trace in zip(panels, fit.traces, strict=True):
    time, known = trace.time, trace.role == "training"
    measured = 1e6 * record.displacement[np.isin(record.time, time)]
    start = -14.030457 if known else measured[0]
    for who, found in ("equation", equation(time, start)), ("model", 1e6 * trace.simulated):
        error = 100 * (measured - found) / np.ptp(measured)
        panel.plot(time[25:-25], np.convolve(error, np.full(51, 1 / 51), "valid"), label=who)
        print(f"{trace.record}, {who}: {np.sqrt(np.mean(error**2)):.3f} % RMS, {abs(error).max():.2f} % at most")
    panel.set(title=trace.record, xlabel="time (s)")
panels[0].set(ylabel="error, means of 10 ms (% of the stroke)")
panels[0].legend()
plt.show()
