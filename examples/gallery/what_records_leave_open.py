"""
What the records leave open
===========================

A fit can be perfect and the model still be undetermined. Ask which motions the records do not decide.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops, raised_cosine

sampling = Sampling(sample_rate=2)


def recorded(name, excitation):
    """Play an excitation on a new stage, whose loops are of symmetric width."""
    stage = PlayActuator(asymmetry=0.0, bend=0.0)
    displacement = stage.play(excitation.voltage)
    return dehyst.Record(excitation.time, excitation.voltage, displacement, name=name)


# %%
# Four major loops, and descending tops. The errors on the records themselves are about the same.
path = 8e-6 + 5e-6 * np.cos(np.linspace(0, 6 * np.pi, 600)) * np.linspace(1, 0.3, 600)
answers = {}
for name, excitation in (
    ("major loops only", raised_cosine([200.0], cycles=4, drive=sampling)),
    ("descending tops", descending_tops(200, drive=sampling)),
):
    record = recorded(name, excitation)
    fit = dehyst.identify(record, structure="maxwell_slip", elements=10)
    answers[name] = dehyst.insight(fit.actuator, record, trajectory=path, repeats=20)
    print(f"{name}: {fit.outcome.name}, {fit.errors[0].rms_percent:.3f} % RMS")

# %%
# The band that should hold the error on a path with inner loops: wide where the records leave it open.
figure, axes = plt.subplots(2, 1, figsize=(9, 7), sharex=True, sharey=True)
for panel, answer in zip(axes, answers.values(), strict=True):
    answer.plot("band", ax=panel)
plt.show()

# %%
# What to record next, if only the major loop is there. The best comes first, with the command that writes its voltage.
for suggestion in answers["major loops only"].advice[:3]:
    print(f"{suggestion.determined} of {suggestion.of} directions:", suggestion.words)
    print("   ", suggestion.command)
