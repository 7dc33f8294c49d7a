"""Each key of --columns changes what is read."""

from dataclasses import replace

import numpy as np
import plain_records
import pytest
from command_line import run

from dehyst.operations.files import RECORD
from dehyst.records import write_columns


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """A folder with a model, a record with other columns, and a path."""
    folder = tmp_path_factory.mktemp("laboratory")
    model = replace(plain_records.plant(6), limits=(0.0, 200.0), delay=2e-3)
    time = np.arange(200) / 50
    voltage = 40 + 35 * np.sin(2 * np.pi * time)
    moved = 1e6 * model.simulate(voltage).displacement
    record = {"time_s": time, "voltage_V": voltage, "displacement_um": moved}
    more = {"bare": 0.1 * voltage, "monitor_V": 1.1 * voltage, "back_um": 1.2 * moved, "clock_s": 2 * time}
    write_columns(folder / "record.csv", record | more)
    write_columns(folder / "other.csv", {"time_s": time, "extra_um": 0.9 * moved})
    rows = zip(time + 1, voltage + 1, moved + 1, strict=True)
    lines = ["time_s\tvoltage_V\tdisplacement_um", *("\t".join(f"{cell:.3f}" for cell in row) for row in rows)]
    (folder / "commas.txt").write_text("\n".join(lines).replace(".", ","))
    write_columns(folder / "path.csv", {"time_s": time, "displacement_um": 2 + np.cos(time)})
    model.save(folder / "model.json")
    return folder


# For each key of --columns: the numbers that are read without it, and with it.
KEYS = {
    "time": ("record.csv", "", "time=clock_s"),
    "voltage": ("record.csv", "", "voltage=monitor_V"),
    "voltage scale": ("record.csv", "", "voltage=voltage_V*1.1"),
    "displacement": ("record.csv", "", "displacement=back_um"),
    "displacement scale": ("record.csv", "displacement=monitor_V*0.09um/V", "displacement=monitor_V*0.08um/V"),
    "rate": ("record.csv", "", "rate=50"),
    "hold": ("record.csv", "", "hold=sample"),
    "temperature": ("record.csv", "", "temperature=bare:C"),
    "join": ("record.csv", "", "join=other.csv, displacement=extra_um"),
    "decimal": ("commas.txt", "", "decimal=comma"),
    "max_size": ("record.csv", "", "max_size=0.0001"),
    "axes": ("record.csv", "", "x=voltage_V:displacement_um, y=monitor_V:back_um"),
}


@pytest.mark.parametrize("key", KEYS)
def test_each_key_of_columns_changes_what_is_read(laboratory, monkeypatch, key):
    monkeypatch.chdir(laboratory)
    file, *columns = KEYS[key]
    before, after = (run("show", file, "--json", *(["--columns", text] if text else [])) for text in columns)
    assert before != after
    # A bound refuses what is larger.
    assert after[0] == (2 if key == "max_size" else 0), after


def test_every_key_of_columns_is_tried():
    assert {key.split()[0] for key in KEYS} == {*RECORD, "axes"}
