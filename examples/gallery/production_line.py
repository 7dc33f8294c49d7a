"""
A production line
=================

Identify every record of a line at once, list the actuators that differ, and find those that age.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dehyst
from dehyst.fleet import drifts_of, findings_of, identify_fleet
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

# %%
# Eight actuators are measured in two sessions, one file each: ``SERIAL/SESSION.csv``. One record is noisy, one actuator
# does not move, and one loses 4 % of its stroke between the sessions.
folder = Path(tempfile.mkdtemp()) / "line"
loops = descending_tops(100, steps=5, drive=Sampling(sample_rate=1))
random = np.random.default_rng(1)
for serial, spread in enumerate(0.01 * random.standard_normal(8)):
    for session in range(2):
        aged = 0.04 * session if serial == 5 else 0
        noise = 60e-9 if (serial, session) == (3, 1) else 2e-9
        stage = PlayActuator(
            stroke=12e-6 * (1 + spread - aged), highest=100, plays=60, noise=noise, seed=2 * serial + session
        )
        y = stage.play(loops.voltage)
        if serial == 6:
            y = 2e-9 * random.standard_normal(y.size)
        (folder / f"S{serial}").mkdir(parents=True, exist_ok=True)
        record = dehyst.Record(loops.time, loops.voltage, y)
        dehyst.write_record(folder / f"S{serial}" / f"{session}.csv", record)

# %%
# One table comes out, a row a record; a record that cannot be identified is a row with its reason. On the command line:
# ``dehyst fleet identify FOLDER -o models.parquet --by serial,session``. For thousands of records, Parquet with a row
# group a record is faster, and ``--dask`` brings other machines.
fleet = identify_fleet(folder, folder.with_name("models.parquet"), by=("serial", "session"), jobs=1)
findings = findings_of(fleet)
print("\n".join(findings.lines()))

# %%
# The oldest model of each actuator and its later ones are played on the same path. In Python, ``fleet.actuators()``
# are all models, to simulate or to compensate with.
drifts = drifts_of(fleet, by="serial", over="session")
print("\n".join(drifts.lines()))

# %%
# Each record in the plane of stroke and width.
listed = set(findings.listed) | {f"{one.serial}/1" for one in drifts.recalibrate}
figure, axes = plt.subplots(figsize=(7, 4))
for row in fleet.rows:
    if row["outcome"] == "identified":
        far = fleet.name(row) in listed
        axes.plot(row["stroke_um"], row["width50_um"], "o", color="C1" if far else "C0")
        if far:
            axes.annotate(f" {fleet.name(row)}", (row["stroke_um"], row["width50_um"]))
axes.set(xlabel="stroke (µm)", ylabel="width of the loop at half the voltage (µm)")
plt.show()
