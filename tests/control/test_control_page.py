"""The code of the page on control runs, and does what the page says."""

import re
from dataclasses import replace

import numpy as np
import places
import plain_records
import pytest
import structured_records

from dehyst import Compensator

PAGE = places.DOCS / "how_to" / "control.md"


def test_the_code_on_the_page_runs(tmp_path, monkeypatch):
    made = structured_records.plant(structured_records.STRUCTURES["all"])
    actuator = replace(made.actuator, limits=(0.0, 250.0))
    actuator.save(tmp_path / "model.json")
    monkeypatch.chdir(tmp_path)
    names = {}
    for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL):
        exec(code, names)
    compensator = names["compensator"]
    assert compensator.clamps == (0, 0)
    first = compensator._clone()
    time = 1e-3 * np.arange(names["sent"].size + 1)
    y = actuator.simulate(np.append(first.voltage, names["sent"]), time=time, state=first.state).displacement[1:]
    plain_records.assert_close(y, names["wanted"], 1e-12 * plain_records.STROKE)
    assert names["feedback"].believed and abs(names["feedback"].correction) < 1e-3 * plain_records.STROKE
    repetition = names["repetition"]
    assert repetition.believed and repetition.errors[-1] <= repetition.errors[0] < 1e-2 * plain_records.STROKE
    assert len(names["table"].cycle) == len(names["wanted"])
    written = []

    def write(voltage):
        if len(written) == 1:
            written.append(None)
            raise OSError("the converter is asleep")
        written.append(voltage)

    compensator = Compensator(actuator, (0, 200), period=1e-3)
    device, other = names["Stage"](compensator, write), Compensator(actuator, (0, 200), period=1e-3)
    device.set(5e-6)
    with pytest.raises(OSError, match="asleep"):
        device.set(9e-6)
    device.set(6e-6)
    assert [written[0], written[2]] == [other.step(5e-6), other.step(6e-6)]
    assert device.read() == {"displacement": 6e-6, "voltage": written[2]}
