"""The public names of each room: `__all__` of its package; `tests/golden/public_api.txt` has them with signatures."""

import importlib

_ROOMS = (
    "calibration cli control exports fleet identification instruments model records report paper testing trust virtual "
    "waveforms web workbench"
)
FACES = {
    "dehyst": list(importlib.import_module("dehyst").__all__),
    **{room: list(getattr(importlib.import_module(f"dehyst.{room}"), "__all__", ())) for room in _ROOMS.split()},
}
# Drivers are imported one by one: each needs its own library or instrument.
DRIVERS = {
    "dehyst.instruments.epics": ["EpicsRig", "PvNames"],
    "dehyst.instruments.pi": ["PiRig"],
}
