"""
Creep
=====

Identify creep from loops at two speeds and holds, predict a staircase, and hold a displacement for a minute.
"""

from textwrap import fill

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.identification import state_after
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
line = next(line for line in fit.summary(full=True).splitlines() if line.strip().startswith("Creep"))
print(fill(line, 85))

# %%
# Both models predict a staircase with other levels and longer holds from its voltages alone. The plain model has no
# creep.
plain = dehyst.identify(record, structure="maxwell_slip")
drive = Sampling(frequency=0.2, sample_rate=rate)
steps = staircase(160, steps=4, hold=30, drive=drive)
later = time[-1] + (1 + np.arange(len(steps))) / rate
measured = stage.play(steps.voltage, time=later)
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
left.plot(steps.time, 1e6 * measured)
left.set(xlabel="time (s)", ylabel="measured displacement (µm)")
for name, actuator in ("plain", plain.actuator), ("with creep", fit.actuator):
    state, _ = state_after(actuator, record)  # the staircase follows the record at once
    error = measured - actuator.simulate(steps.voltage, time=later, state=state).displacement
    right.plot(steps.time, 1e9 * (error - error[0]), label=name)
right.set(xlabel="time (s)", ylabel="measured - predicted (nm)")
right.legend()
plt.show()

# %%
# Rise to 8 um in five seconds, and stay there for a minute. A model with creep lowers the voltage in this minute. This
# stage is not an instance of the model: a part of its creep remains.
clock = np.arange(0, 65, 1 / rate)
wanted = 1e-6 + 7e-6 * (0.5 - 0.5 * np.cos(np.pi * np.minimum(clock / 5, 1)))
later = time[-1] + (1 + np.arange(clock.size)) / rate
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
for name, actuator in ("plain", plain.actuator), ("with creep", fit.actuator):
    state, _ = state_after(actuator, record)
    plan = dehyst.plan_path(actuator, wanted, time=clock, limits=(0, 200), start=state)
    sent = plan.voltage[plan.first :]
    stage.relax()
    stage.play(voltage, time=time)
    error = stage.play(sent, time=later, measured=False) - wanted
    left.plot(clock, 1e9 * error, label=name)
    right.plot(clock[20:], sent[20:], label=name)
    print(f"{name}: moves by {1e9 * (error[-1] - error[20]):.0f} nm in the minute")
left.set(xlabel="time (s)", ylabel="distance from the wanted displacement (nm)")
left.legend()
right.set(xlabel="time (s)", ylabel="voltage sent while it stays (V)")
plt.show()
