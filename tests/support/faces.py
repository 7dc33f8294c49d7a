"""What each room offers: the `__all__` of its face, which `tests/golden/public_api.txt` holds with its signatures."""

import importlib

_ROOMS = (
    "calibration cli control exports fleet identification instruments model records report paper testing trust virtual "
    "waveforms web workbench"
)
FACES = {
    "dehyst": list(importlib.import_module("dehyst").__all__),
    **{room: list(getattr(importlib.import_module(f"dehyst.{room}"), "__all__", ())) for room in _ROOMS.split()},
}
# Drivers are imported one by one: each needs a library or an instrument of its own.
DRIVERS = {
    "dehyst.instruments.epics": ["EpicsRig", "PvNames"],
    "dehyst.instruments.pi": ["PiRig"],
}
