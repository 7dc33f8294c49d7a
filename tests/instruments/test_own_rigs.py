"""The files in `examples/instruments`, on fakes of their libraries; rigs are held to the contract of all rigs too."""

import runpy

import numpy as np
import nv200_on_emulator
import places
import pytest
from plain_records import STROKE, VOLTS, plant
from truths import ModelledActuator

from dehyst.instruments import RigError
from dehyst.instruments.simulated import SimulatedRig

FILES = places.EXAMPLES / "instruments"


@pytest.mark.parametrize("path", sorted(FILES.glob("*.py")), ids=lambda path: path.stem)
def test_each_example_is_short(path):
    assert len(path.read_text().splitlines()) < 90


@pytest.mark.parametrize("setting", [{"acmeasure": "0"}, {"cl": "1"}, {"modsrc": "3"}, {"unitcl": "mrad"}])
def test_an_amplifier_that_cannot_be_used_is_refused(setting):
    with nv200_on_emulator.amplifier(**setting) as device:
        with pytest.raises(RigError) as caught:
            nv200_on_emulator.rig_of(device)
        assert caught.value.argument in setting
        assert device.bench.axis.log.largest_step == 0


@pytest.fixture
def bluesky():
    """The names in the file of the axis, and a run engine."""
    pytest.importorskip("ophyd_async", reason="ophyd-async is not installed: there is no bluesky device to test")
    pytest.importorskip("bluesky", reason="bluesky is not installed: there are no plans to run")
    from bluesky import RunEngine
    from bluesky.plans import list_scan

    return runpy.run_path(str(FILES / "bluesky_axis.py")) | {"engine": RunEngine({}), "list_scan": list_scan}


def test_an_axis_scans_without_hysteresis(bluesky):
    actuator, rows, engine = plant(), [], bluesky["engine"]
    wanted = 1e6 * STROKE * np.array([0.2, 0.5, 0.8, 0.5, 0.2, 0.6])
    with SimulatedRig(ModelledActuator(actuator, VOLTS), device_limits=(0.0, VOLTS)) as rig:
        axis = bluesky["CompensatedAxis"](rig, actuator, name="axis")
        engine(bluesky["homing"](axis))
        engine(
            bluesky["list_scan"]([], axis, wanted.tolist()),
            lambda kind, document: rows.append(document["data"]["axis-position"]) if kind == "event" else None,
        )
    assert rows == pytest.approx(wanted, abs=1e-9 * wanted.max())


def test_an_axis_of_unknown_state_is_not_moved(bluesky):
    actuator, engine = plant(), bluesky["engine"]
    move = bluesky["list_scan"]
    with SimulatedRig(ModelledActuator(actuator, VOLTS), device_limits=(0.0, VOLTS)) as rig:
        axis = bluesky["CompensatedAxis"](rig, actuator, name="axis")
        with pytest.raises(Exception, match="home it first"):
            engine(move([], axis, [1.0]))
        assert rig.instrument.axis.log.largest_step == 0
        engine(bluesky["homing"](axis))
        highest = rig.instrument.axis.voltage
        with pytest.raises(Exception, match="got 1000 um"):
            engine(move([], axis, [1000.0]))
        assert rig.instrument.axis.voltage == highest
        engine(move([], axis, [1.0]))
        put = rig._put
        rig._put = lambda _: 1 / 0
        with pytest.raises(Exception, match="ZeroDivisionError"):
            engine(move([], axis, [2.0]))
        rig._put = put
        with pytest.raises(Exception, match="home it first"):
            engine(move([], axis, [1.0]))
