"""
Compare with other models
=========================

Fit dehyst's model and a straight scale factor to the same record, and compare their errors on a held-out part.
"""

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, raised_cosine

stage = PlayActuator()
loops = raised_cosine([200, 200, 150, 90, 130, 60], cycles=1, drive=Sampling(sample_rate=1))
record = dehyst.Record(loops.time, loops.voltage, stage.play(loops.voltage), name="loops")

# %%
# The last quarter of the record is held out; each model is fitted to the rest. On the command line this is ``dehyst
# compare loops.csv``; ``--validate other-loops.csv`` gives held-out records instead.
compared = dehyst.compare(record)
print(compared.best)
scores = {score.name: score.worst("validation") for score in compared.rows if not score.failure}
for name, score in sorted(scores.items(), key=lambda item: item[1].rms):
    print(f"{name:34} {score.rms:6.3f} % RMS, {score.largest:6.2f} % at most")

# %%
# The table of a model has one rising and one falling branch of the major loop; the scale is logarithmic. With ``pip
# install dehyst-rivals`` (from a clone: ``pip install ./packages/rivals``) the comparison has nine published models
# more.
names = sorted(scores, key=lambda name: -scores[name].rms)
figure, axes = plt.subplots(figsize=(8, 3))
axes.barh(names, [scores[name].rms for name in names])
axes.set(xscale="log", xlabel="error on loops that were held out, RMS (% of the stroke)")
plt.show()
