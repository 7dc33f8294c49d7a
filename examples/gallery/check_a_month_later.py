"""
Check a model a month later
===========================

Record a few loops and check: is the model still true, and if not, what has changed?
"""

from textwrap import fill

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

sampling = Sampling(sample_rate=4)
tops = descending_tops(200, drive=sampling)
loops = raised_cosine([200.0], cycles=4, drive=sampling)

stage = PlayActuator()
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="January")
actuator = dehyst.identify(record).actuator

# %%
# Three stages: the same as before, one with 2 % more gain, and one with a wider loop.
later = {
    "the same": PlayActuator(seed=1),
    "gain + 2 %": PlayActuator(seed=2, stroke=1.02 * stage.stroke),
    "a wider loop": PlayActuator(seed=3, width=1.15 * stage.width),
}
for name, today in later.items():
    new = dehyst.Record(loops.time, loops.voltage, today.play(loops.voltage), name=name)
    recheck = dehyst.check(actuator, new, goal=1.0)
    for sentence in (f"{name}: {recheck.sentence}", *recheck.change_sentences()):
        print(fill(sentence, 85, subsequent_indent="    "))

# %%
# The difference of measured and simulated displacement of each stage: a slope shows a change of gain, a loop one of
# width.
figure, axes = plt.subplots(1, len(later), figsize=(11, 4), sharey=True)
for panel, (name, today) in zip(axes, later.items(), strict=True):
    measured = today.play(loops.voltage)
    simulated = actuator.simulate(loops.voltage, time=loops.time).displacement
    last = loops.time > loops.time[-1] / 2
    difference = (measured - simulated)[last]
    panel.plot(loops.voltage[last], 1e9 * (difference - difference[-1]))
    panel.set(title=name, xlabel="voltage (V)")
axes[0].set_ylabel("measured - simulated (nm)")
plt.show()
