"""Where an exported compensator's memory begins, and the way there: the words lead to the state."""

import numpy as np
import plain_records
import pytest
from compiled_exports import KINDS

from dehyst import Compensator
from dehyst.exports import export
from dehyst.exports.model_header import ExportedStart
from dehyst.model import turned


@pytest.mark.parametrize("kind", ["plain", "all", "moving"])
def test_the_files_say_where_memory_begins(tmp_path, kind):
    compensator = KINDS[kind]()
    export(compensator, tmp_path / "c")
    outset = ExportedStart.of(compensator)
    held = compensator.actuator.voltage(compensator._clone().state)
    assert outset.voltage == pytest.approx(np.clip(held, *compensator.limits), rel=1e-12)
    for file in ("README.md", "piezo.c"):
        text = (tmp_path / "c" / file).read_text()
        assert f"{outset.displacement * 1e6:.6g} um, {outset.voltage:.6g} V" in text
        assert outset.way in text


@pytest.mark.parametrize("rising", [True, False])
def test_the_way_to_where_memory_begins_leads_there(rising):
    """Two ways: the words followed on the virtual actuator, and the state that was exported."""
    actuator = plain_records.plant(10, seed=4)
    low, high = (
        actuator.voltage(turned(actuator, 0, rising=False)),
        actuator.voltage(turned(actuator, plain_records.STROKE)),
    )
    state = turned(actuator, plain_records.STROKE if rising else 0, rising=rising)
    outset = ExportedStart.of(Compensator(actuator, (low, high), state=state))
    first, words = (low, "raise the voltage slowly from its lowest") if rising else (high, "lower the voltage slowly")
    assert outset.way.startswith(words)
    elsewhere = actuator.relaxed(0.5 * (low + high))
    path = [actuator.voltage(elsewhere), *np.linspace(first, outset.voltage, 50)]
    reached = actuator.simulate(path, state=elsewhere).displacement[-1]
    assert reached == pytest.approx(outset.displacement, abs=1e-9 * plain_records.STROKE)
