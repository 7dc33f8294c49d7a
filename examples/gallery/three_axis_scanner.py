"""
A three-axis scanner
====================

Each of three stacks moves all axes a little. One matrix and three actuators, identified from one record, describe the
scanner.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, stage_excitation

coupling = np.array([[1, 0.04, -0.02], [0.03, 1, 0.05], [-0.025, 0.06, 1]])
stacks = [PlayActuator(width=width, noise=0.0) for width in (0.4, 0.5, 0.6)]


def play(time, voltage):
    """Return the readings of sensors on the three axes."""
    moved = [stack.play(column) for stack, column in zip(stacks, voltage.T, strict=True)]
    noise = np.random.default_rng(0).normal(0, 2e-9, voltage.shape)
    return dehyst.Record(time, voltage, np.column_stack(moved) @ coupling.T + noise)


# %%
# The axes move one after the other, then all together with different periods. A first cycle is not recorded.
tops = stage_excitation([200, 200, 200], drive=Sampling(0.5, sample_rate=20), steps=6, cycles=6)
play(np.arange(41.0), 200 * np.sin(np.linspace(0, np.pi, 41))[:, None] ** 2 * np.ones(3))
record = play(tops.time, tops.voltage)

# %%
# Identify the matrix, and three Maxwell-slip actuators, whose fit is fast.
fit = dehyst.identify(record, structure="maxwell_slip")
print(np.round(fit.coupling, 4))
print(f"largest error of an entry: {np.abs(fit.coupling - coupling).max():.4f}; {fit.verdict}")

# %%
# The residual of x over the voltage of y, with a model of x alone, and with the model of the stage.
alone = dehyst.identify(record.axis(0), structure="maxwell_slip").traces[0]
whole = fit.fits[0].traces[0]
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), sharey=True)
for axes, trace, title in (left, alone, "x as a single axis"), (right, whole, "x in the stage"):
    at = np.searchsorted(record.time, trace.time - 1e-9)
    axes.plot(record.voltage[at, 1], trace.residual * 1e9, ".", ms=2)
    axes.set(title=title, xlabel="voltage of y (V)")
left.set_ylabel("residual of x (nm)")
plt.show()
