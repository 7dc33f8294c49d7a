"""
Correct a picture already taken
===============================

A scan with a straight gain distorts its picture: forward and backward lines show an object at two places. From the
voltages of the scan, `simulate` computes where each pixel was; then each line is resampled at even positions.
"""

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, recommended

# %%
# A scanner, and a model of it from one record.

scanner = PlayActuator()
played = recommended(scanner.highest, drive=Sampling(0.1, sample_rate=40))
record = dehyst.Record(played.time, played.voltage, scanner.play(played.voltage))
actuator = dehyst.identify(record, structure="maxwell_slip").actuator

# %%
# The picture: forward and backward lines over a grating of 1 um, taken with a triangular voltage.

pixels, lines = 400, 12
line = np.linspace(20, 180, pixels)
voltage = np.tile(np.concatenate([line, line[::-1]]), lines)
place = scanner.play(np.concatenate([played.voltage, voltage]), measured=False)[-voltage.size :]
picture = (np.sin(2 * np.pi * place / 1e-6) > 0).reshape(2 * lines, pixels)

# %%
# The model gives the position of each pixel; then each line is interpolated at even positions.

found = actuator.simulate(np.concatenate([played.voltage, voltage])).displacement[-voltage.size :]
found = found.reshape(2 * lines, pixels)
even = np.linspace(found.min(axis=1).max(), found.max(axis=1).min(), pixels)
corrected = np.empty(picture.shape)
for k, (x, brightness) in enumerate(zip(found, picture, strict=True)):
    order = np.argsort(x)
    corrected[k] = np.interp(even, x[order], brightness[order])
raw = np.array([row[:: (-1) ** k] for k, row in enumerate(picture)])

# %%
# Forward and backward lines agree now.

for name, image in (("raw", raw), ("corrected", corrected)):
    apart = np.abs(image[2::2].astype(float) - image[3::2]).mean()
    print(f"{name}: forward and backward lines differ in {100 * apart:.1f} % of the pixels")

figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
left.imshow(raw, aspect="auto", cmap="gray")
left.set(title="as taken", xlabel="pixel", ylabel="line")
ends = (1e6 * even[0], 1e6 * even[-1], 2 * lines, 0)
right.imshow(corrected, aspect="auto", cmap="gray", extent=ends)
right.set(title="corrected", xlabel="position (um)")
plt.show()
