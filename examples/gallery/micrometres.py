"""
Micrometres
===========

dehyst computes in metres. With ``units="um"`` you need not convert.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
sensor = 1e6 * stage.play(tops.voltage)  # your sensor reads micrometres

# %%
# If a file does not state the unit, use ``dehyst.read("loops.csv", "displacement=:um")``.
record = dehyst.Record.from_arrays(tops.time, tops.voltage, sensor, units="um")
fit = dehyst.identify(record)
print(record)

# %%
# A compensator with units takes and returns displacements in that unit.
compensator = dehyst.Compensator(fit.actuator, units="um", period=1e-3)
low, high = compensator.reach
print(f"from {low:.2f} to {high:.2f} um")
wanted = np.linspace(high, 0.5 * (low + high), 500)
plan = dehyst.plan_path(compensator, wanted, home=False)
print(plan.units, plan.displacement[-1], plan.missed)

# %%
# Plots are always in micrometres.
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
record.plot("loop", ax=left)
right.plot(plan.displacement, plan.voltage)
right.set(xlabel="wanted displacement (µm)", ylabel="voltage to send (V)")
plt.show()
