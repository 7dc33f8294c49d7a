"""
Compare with other models
=========================

Fit published models to the same records, and test all of them on the same loops, which were held out.
"""

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

stage = PlayActuator()
sampling = Sampling(sample_rate=1)
tops = descending_tops(200, drive=sampling)
others = raised_cosine([150, 90], cycles=2, drive=sampling)
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
held_out = dehyst.Record(others.time, others.voltage, stage.play(others.voltage), name="other loops")

# %%
# Each model is fitted in the way that its authors published. A model that these records cannot determine has a reason
# in place of a score. On the command line: ``dehyst compare loops.csv --validate other-loops.csv``.
compared = dehyst.compare(record, validate=held_out)
scores = {score.name: score.worst("validation") for score in compared.rows if not score.failure}
for name, score in sorted(scores.items(), key=lambda item: item[1].rms):
    print(f"{name:34} {score.rms:6.3f} % RMS, {score.largest:6.2f} % at most")

# %%
# The scale is logarithmic. The stage is made of play operators, of which the modified and the generalised
# Prandtl-Ishlinskii models are near relatives.
names = sorted(scores, key=lambda name: -scores[name].rms)
figure, axes = plt.subplots(figsize=(8, 5))
axes.barh(names, [scores[name].rms for name in names])
axes.set(xscale="log", xlabel="error on loops that were held out, RMS (% of the stroke)")
plt.show()
