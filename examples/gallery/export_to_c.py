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
from dehyst.exports import sizes
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
models = {n: dehyst.identify(record, structure="maxwell_slip", elements=n).actuator for n in (5, 10, 20, 40)}

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
# Flash and RAM grow with the number of elements; a step takes bounded time.
if shutil.which("gcc"):
    taken = {}
    for n, actuator in models.items():
        target = folder.parent / f"firmware_{n}"
        dehyst.export(dehyst.Compensator(actuator, (0, 200), period=1e-4), target, "float", measure=False)
        taken[n] = sizes(target, "gcc", ["-Os"])
    figure, axes = plt.subplots()
    axes.plot(taken.keys(), [one.flash for one in taken.values()], "o-", label="flash")
    axes.plot(taken.keys(), [one.ram for one in taken.values()], "o-", label="RAM")
    axes.set(xlabel="slip elements", ylabel="bytes on this computer", ylim=(0, None))
    axes.legend()
    plt.show()
