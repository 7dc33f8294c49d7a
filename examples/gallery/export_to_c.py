"""
Export to C
===========

Write a compensator for a microcontroller. Its folder checks itself against Python.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import dehyst
from dehyst.exports import worst_case
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
models = {n: dehyst.identify(record, structure="paper", elements=n).actuator for n in (5, 10, 20, 40)}

# %%
# ``measure=False`` leaves out the sizes, which take seconds.
compensator = dehyst.Compensator(models[10], (0, 200), period=1e-4)
folder = Path(tempfile.mkdtemp()) / "firmware"
dehyst.export(compensator, folder, "float", measure=False)
print(*sorted(path.name for path in folder.iterdir()))

# %%
# ``make check`` compiles the C and plays a trace that Python computed.
if shutil.which("make") and shutil.which("cc"):
    done = subprocess.run(["make", "-s", "check"], cwd=folder, capture_output=True, text=True, check=True)
    print(done.stdout)

# %%
# A step takes bounded time. The bound is for a step that crosses the whole range and is clamped; others take far less.
counts = {n: worst_case(dehyst.Compensator(actuator, (0, 200), period=1e-4)) for n, actuator in models.items()}
print(counts[10])

figure, axes = plt.subplots()
axes.plot(counts.keys(), [count.arithmetic for count in counts.values()], "o-", label="additions and multiplications")
axes.plot(counts.keys(), [count.comparisons for count in counts.values()], "o-", label="comparisons")
axes.plot(counts.keys(), [count.divisions for count in counts.values()], "o-", label="divisions")
axes.set(xlabel="slip elements", ylabel="at most, in one step", yscale="log")
axes.legend()
plt.show()
