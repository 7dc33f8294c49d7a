"""
A scan and its wave table
=========================

A triangle with rounded turns, as one period that a generator repeats.
"""

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, Triangle, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
actuator = dehyst.identify(record).actuator

# %%
# 2 to 12 um at 10 Hz; a fifth of each branch is for the turns.
scan = Triangle(2e-6, 12e-6, frequency=10, turns=0.2)
table = dehyst.wave_table(actuator, scan.path(), limits=(0, 200), slew_rate=20_000)
played = table.played(cycles=3)
print(f"{table.cycles} cycle of start-up, then the table is steady to {1e9 * table.error:.2g} nm; {table.warnings=}")

# %%
# Play homing, start-up and cycles on the stage: the lines come out straight.
reached = stage.play(played.voltage, measured=False)
colours = {0: "tab:gray", 1: "tab:orange", 2: "tab:blue"}
names = {0: "homing", 1: "start-up", 2: "table"}
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
for phase, colour in colours.items():
    part = played.phase == phase
    above.plot(played.time[part], played.voltage[part], color=colour, label=names[phase])
    below.plot(played.time[part], 1e6 * reached[part], color=colour)
above.set_ylabel("voltage (V)")
above.legend(ncols=3)
below.set(xlabel="time (s)", ylabel="displacement (µm)")
plt.show()

cycles = played.phase == 2
error = reached[cycles] - played.displacement[cycles]
print(f"largest error on the cycles: {1e9 * abs(error).max():.1f} nm of 10 um")
