"""
Asymmetric loops
================

Loops that are wider at one end: plain Maxwell slip cannot describe them, a transformer can.
"""

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator(asymmetry=0.1)
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")

# %%
# ``structure="maxwell_slip"`` is the class of Yeh, Lu and Wu: its loops are equally wide at both ends. ``"auto"``, the
# default, adds the parts that predict cycles which were held out.
plain = dehyst.identify(record, structure="maxwell_slip")
wider = dehyst.identify(record)
for name, fit in ("plain", plain), ("auto", wider):
    print(f"{name}: largest error {fit.errors[0].largest_percent:.2f} % of the stroke")

# %%
# The residuals of the plain model depend on the direction and on the place: the sign of a class that does not fit.
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
plain.plot("residuals", ax=left)
left.set_title("plain Maxwell slip")
wider.plot("residuals", ax=right)
right.set_title("with a transformer")
plt.show()
