"""
Asymmetric loops
================

Plain Maxwell slip cannot describe loops that are wider at one end; a model with a transformer can.
"""

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator(asymmetry=0.1)
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")

# %%
# ``structure="maxwell_slip"`` is the model of Yeh, Lu and Wu: its loops are equally wide at both ends. ``"auto"``, the
# default, adds parts that improve the prediction of held-out cycles.
plain = dehyst.identify(record, structure="maxwell_slip")
wider = dehyst.identify(record)
for name, fit in ("plain", plain), ("auto", wider):
    print(f"{name}: largest error {fit.errors[0].largest_percent:.2f} % of the stroke")

# %%
# The residuals of the plain model depend on direction and displacement: a sign that the model does not describe the
# loops.
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
plain.plot("residuals", ax=left)
left.set_title("plain Maxwell slip")
wider.plot("residuals", ax=right)
right.set_title("with a transformer")
plt.show()
