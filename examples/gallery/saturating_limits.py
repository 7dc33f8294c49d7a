"""
Limits that saturate
====================

A path needs more voltage than is allowed. After that, the error is small only if the memory follows the voltage that
was really sent.
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
homing = np.concatenate([np.linspace(0, 200, 400), np.linspace(200, 0, 400)])
homed = actuator.simulate(homing).state

# %%
# The path rises to 11 um; the allowed 100 V reach about 7 um.
corners = np.array([0.5, 11, 3, 5.5, 2, 5]) * 1e-6
wanted = np.interp(np.linspace(0, corners.size - 1, 1200), np.arange(corners.size), corners)

# %%
# A loop with limits knows the voltage that is sent. A loop without limits does not know that its voltage is clipped
# later.
with warnings.catch_warnings():
    warnings.simplefilter("ignore", dehyst.ClampWarning)
    aware = dehyst.Compensator(actuator, (0, 100), state=homed).run(wanted)
clipped = np.clip(dehyst.Compensator(actuator, (0, 200), state=homed).run(wanted), 0, 100)

figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), sharex=True)
above.plot(1e6 * wanted, color="black", label="wanted")
after = slice(480, None)
for label, voltage in ("limits in the loop", aware), ("clipped afterwards", clipped):
    stage.play(homing)
    reached = stage.play(voltage, measured=False)
    above.plot(1e6 * reached, label=label)
    error = 100 * (reached - wanted) / stage.stroke
    below.plot(error, label=label)
    print(f"{label}: {np.abs(error[after]).max():.2f} % of the stroke at most, after the saturation")
above.set_ylabel("displacement (µm)")
above.legend(ncols=3)
below.set(xlabel="sample", ylabel="error (% of the stroke)", ylim=(-12, 4))
plt.show()
