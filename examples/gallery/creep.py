"""
Creep
=====

Identify creep from loops at two speeds and holds, and hold a displacement for a minute.
"""

from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, staircase

stage = PlayActuator(creep=0.01)  # 1 % of a step in each decade of time
rate = 4.0

# %%
# One run: descending tops, slow and then fast, and a staircase that holds on each step and turns back.
slow = descending_tops(200, steps=8, drive=Sampling(frequency=0.02, sample_rate=rate))
fast = descending_tops(200, steps=8, drive=Sampling(frequency=0.2, sample_rate=rate))
stairs = staircase(200, steps=8, hold=10, back=True, drive=Sampling(frequency=0.2, sample_rate=rate))
voltage = np.concatenate([slow.voltage, fast.voltage, stairs.voltage])
time = np.arange(voltage.size) / rate
record = dehyst.Record(time, voltage, stage.play(voltage, time=time), name="run")
fit = dehyst.identify(record)
line = next(line for line in fit.summary().splitlines() if line.strip().startswith("Creep:"))
print(fill(line, 85))

# %%
# Home, step to 8 um and stay there. The past matters when an actuator creeps, so the state is that of the whole
# session: the run, then the homing.
homing = np.interp(np.arange(0, 40, 1 / rate), [0, 10, 20, 40], [0, 200, 0, 0])
session = np.concatenate([voltage, homing])
clock = np.arange(session.size) / rate
state = fit.actuator.simulate(session, time=clock).state
stay = np.full(240, 8e-6)
compensated = dehyst.Compensator(fit.actuator, (0, 200), period=1 / rate).trajectory(stay, state=state)
later = clock[-1] + (1 + np.arange(stay.size)) / rate

# %%
# The same step with the voltage held: it creeps.
held = np.full(stay.size, compensated.voltage[0])
reached = {}
for label, sent in ("voltage held", held), ("compensated", compensated.voltage):
    stage.relax()
    stage.play(session, time=clock)
    reached[label] = stage.play(sent, time=later, measured=False)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
for label, displacement in reached.items():
    left.plot(later - clock[-1], 1e9 * (displacement - stay), label=label)
left.set(xlabel="time (s)", ylabel="distance from 8 um (nm)")
left.legend()
right.plot(later - clock[-1], compensated.voltage)
right.set(xlabel="time (s)", ylabel="voltage sent (V)")
plt.show()
