"""
Export to C
===========

Write a compensator for a microcontroller. Its folder has a check that compares it with Python.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

import dehyst
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

stage = PlayActuator()
tops = descending_tops(200, drive=Sampling(sample_rate=4))
record = dehyst.Record(tops.time, tops.voltage, stage.play(tops.voltage), name="loops")
models = {n: dehyst.identify(record, structure=dehyst.Structure(elements=n)).actuator for n in (5, 10, 20, 40)}

# %%
# A folder with the core, the numbers of the model, and a check.
compensator = dehyst.Compensator(models[10], (0, 200), period=1e-4)
folder = Path(tempfile.mkdtemp()) / "firmware"
dehyst.export(compensator, folder, "float")
print(*sorted(path.name for path in folder.iterdir()))

# %%
# ``make check`` compiles the C and plays a trace that Python computed.
if shutil.which("make") and shutil.which("cc"):
    done = subprocess.run(["make", "-s", "check"], cwd=folder, capture_output=True, text=True, check=True)
    print(done.stdout)

# %%
# Flash grows with the number of elements (for a microcontroller: ``arm-none-eabi-size``); the time of a step is
# bounded.
if shutil.which("gcc") and shutil.which("size"):
    taken = {}
    for n, actuator in models.items():
        target = folder.parent / f"firmware_{n}"
        dehyst.export(dehyst.Compensator(actuator, (0, 200), period=1e-4), target, "float")
        command = ["gcc", "-std=c99", "-Os", "-ffp-contract=off", "-c", "piezo.c", "dehyst.c"]
        subprocess.run(command, cwd=target, check=True)
        told = subprocess.run(["size", "piezo.o", "dehyst.o"], cwd=target, capture_output=True, text=True, check=True)
        taken[n] = sum(int(line.split()[0]) for line in told.stdout.splitlines()[1:])
    figure, axes = plt.subplots()
    axes.plot(taken.keys(), taken.values(), "o-")
    axes.set(xlabel="slip elements", ylabel="bytes of code and numbers on this computer", ylim=(0, None))
    plt.show()
