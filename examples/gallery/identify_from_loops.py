"""
Identify from loops
===================

Fit a model to recorded loops, and test it on held-out loops.
"""

from textwrap import fill

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

# %%
# Two large loops and then smaller and smaller ones determine all stiffnesses. The held-out loops have other heights. In
# place of these lines read your files: ``record = dehyst.read("loops.csv")``.
stage = PlayActuator()
sampling = Sampling(sample_rate=4)
tops = descending_tops(200, drive=sampling)
others = raised_cosine([150, 90], cycles=2, drive=sampling)
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
held_out = dehyst.Record(others.time, others.voltage, stage.play(others.voltage), name="other loops")

# %%
# The first line of the summary is the verdict.
fit = dehyst.identify(record, validate=held_out)
print(fill(fit.summary().splitlines()[0], 85))

# %%
# With a good fit, measured and simulated loops coincide. Without the straight line (left), hysteresis and errors are
# larger in the picture.
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
fit.plot("hysteresis", ax=left)
fit.plot("residuals", ax=right)
plt.show()

# %%
# ``fit.actuator.save("model.json")`` writes the model as JSON, and ``dehyst.Actuator.load`` reads it.
print(fit.actuator)
