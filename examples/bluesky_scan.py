"""Scan a piezo axis up and down with bluesky, without its hysteresis and with it.

In one terminal a virtual controller::

    dehyst rig serve --epics BENCH

and in another::

    export EPICS_CA_ADDR_LIST=127.0.0.1 EPICS_CA_AUTO_ADDR_LIST=NO
    python examples/bluesky_scan.py BENCH [MODEL.json]

MODEL.json is what `dehyst calibrate epics://BENCH` or `dehyst identify` writes. Without it loops are recorded first.
"""

import sys

import numpy as np
from bluesky import RunEngine
from bluesky.plans import list_scan
from ophyd_async.core import init_devices

import dehyst
from dehyst.instruments.bluesky_axis import CompensatedAxis, homing
from dehyst.instruments.epics import EpicsRig
from dehyst.waveforms import Sampling, descending_tops

POINTS = 13


def recorded_model(prefix):
    """Record loops of ten heights through the IOC, and identify."""
    with EpicsRig.connect(prefix) as rig:
        low, high = rig.limits.low, rig.limits.high
        rig.set_voltage(low)
        drive = Sampling(frequency=2, base=low, limits=(low, high), slew_rate=rig.slew_rate)
        record = rig.play(descending_tops(high, drive=drive))
        rig.retreat()
    return dehyst.identify(record).actuator


def proportional(actuator, limits):
    """Return a model without hysteresis: displacement in proportion to voltage."""
    reach = dehyst.Compensator(actuator, limits).reach
    nothing = dehyst.MaxwellSlip([1e-9], [0.0])
    return dehyst.Actuator(nothing, dehyst.Spring(reach, limits), limits=limits, name="proportional")


def scanned(engine, axis, displacements):
    """Home, scan, and return what was measured [um] at each displacement."""
    rows = []
    engine(homing(axis))
    engine(
        list_scan([], axis, list(displacements)),
        lambda kind, document: rows.append(document["data"][axis.position.name]) if kind == "event" else None,
    )
    return np.array(rows)


def main(prefix, path=None):
    """Print what was wanted, what was measured, and the errors in percent of the stroke."""
    actuator = recorded_model(prefix) if path is None else dehyst.Actuator.load(path)
    engine = RunEngine({})
    with init_devices():
        axis = CompensatedAxis(prefix, actuator, name="axis")
        plain = CompensatedAxis(prefix, proportional(actuator, actuator.limits), name="plain")
    engine(homing(axis))
    low, high = axis.reach
    up = low + (high - low) * np.linspace(0.05, 0.95, POINTS)
    wanted = np.concatenate([up, up[-2::-1]])
    percent = 100 / (high - low)
    compensated, straight = (scanned(engine, each, wanted) for each in (axis, plain))
    print("wanted um   compensated um  error %   proportional um  error %")
    for y, ours, theirs in zip(wanted, compensated, straight, strict=True):
        print(f"{y:9.4f}   {ours:14.4f}  {percent * (ours - y):7.3f}   {theirs:15.4f}  {percent * (theirs - y):7.3f}")
    for name, found in (("compensated", compensated), ("proportional", straight)):
        print(f"{name}: largest error {percent * np.abs(found - wanted).max():.3f} % of the stroke")

    with EpicsRig.connect(prefix) as rig:
        rig.retreat()


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        sys.exit(f"usage: {sys.argv[0]} PREFIX [MODEL.json]")
    try:
        main(*sys.argv[1:])
    except dehyst.DehystError as error:
        sys.exit(f"bluesky_scan: {error}")
