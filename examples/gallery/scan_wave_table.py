"""
A scan and its wave table
=========================

This makes one period of a triangle with rounded turns, which a generator repeats.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, Triangle, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
actuator = dehyst.identify(record).actuator

# %%
# The triangle goes from 2 to 12 um at 10 Hz; the turns take a fifth of each branch.
scan = Triangle(2e-6, 12e-6, frequency=10, turns=0.2)
table = dehyst.wave_table(actuator, scan.path(), limits=(0, 200), slew_rate=20_000)
plan, cycle = table.plan, table.cycle
print(f"{table.cycles} cycle of start-up, then the table is steady to {1e9 * table.error:.2g} nm; {table.warnings=}")

# %%
# Play the plan, and then the cycle twice, on the stage: the lines are straight.
voltage = np.concatenate([plan.voltage[:-1], cycle.voltage, cycle.voltage])
wanted = np.concatenate([plan.displacement[:-1], cycle.displacement, cycle.displacement])
time = np.append(plan.time[:-1], plan.time[-1] + np.arange(2 * len(cycle)) / table.sample_rate)
reached = stage.play(voltage, measured=False)
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
steady = voltage.size - 3 * len(cycle)
for name, part in {
    "homing": slice(plan.first),
    "start-up": slice(plan.first, steady),
    "table": slice(steady, None),
}.items():
    above.plot(time[part], voltage[part], label=name)
    below.plot(time[part], 1e6 * reached[part])
above.set_ylabel("voltage (V)")
above.legend(ncols=3)
below.set(xlabel="time (s)", ylabel="displacement (µm)")
plt.show()

error = reached[steady:] - wanted[steady:]
print(f"largest error on the cycles: {1e9 * abs(error).max():.1f} nm of 10 um")
