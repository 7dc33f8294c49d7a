"""
In a control loop, step by step
===============================

A loop sends one voltage per period. A displacement out of reach is clamped and counted, and the memory stays true.
"""

import warnings

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
actuator = dehyst.identify(record).actuator

# %%
# A motion up and down brings stage and model to the same state.
homing = np.concatenate([np.linspace(0, 200, 400), np.linspace(200, 0, 400)])
stage.play(homing)
homed = actuator.simulate(homing).state

# %%
# The sines grow beyond the reach of 150 V. ``step`` returns the voltage to send now.
compensator = dehyst.Compensator(actuator, limits=(0, 150), period=1e-3, state=homed)
time = 1e-3 * np.arange(2000)
wanted = 6e-6 + np.linspace(2e-6, 8e-6, time.size) * np.sin(2 * np.pi * 3 * time)
with warnings.catch_warnings():
    warnings.simplefilter("ignore", dehyst.ClampWarning)  # it is shown below
    sent = np.array([compensator.step(displacement) for displacement in wanted])
print(compensator.clamps)

# %%
# The displacement follows where it can be reached, also just after a clamped sample.
reached = stage.play(sent, measured=False)
clamped = (sent <= 0) | (sent >= 150)
figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
above.plot(time, 1e6 * wanted, color="black", label="wanted")
above.plot(time, 1e6 * reached, "--", label="reached")
above.set_ylabel("displacement (µm)")
above.legend(ncols=2)
below.plot(time, sent)
below.fill_between(time, 0, 150, where=clamped, alpha=0.2, color="tab:red", label="clamped")
below.set(xlabel="time (s)", ylabel="voltage (V)")
below.legend()
plt.show()
print(f"largest error where nothing is clamped: {1e9 * abs(reached - wanted)[~clamped].max():.1f} nm")
