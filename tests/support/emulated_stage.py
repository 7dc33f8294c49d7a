"""Emulated controllers of several axes, served over a socket."""

import time
from contextlib import contextmanager

import numpy as np
from emulator import Controller, Fault, Rehearsal, Server
from emulator.faults import actual_limits
from truths import PreisachActuator

from dehyst.instruments import open_rig
from dehyst.virtual import PlayActuator, VirtualBench, VirtualStage

COUPLING = np.array([[1.0, -0.047, 0.044], [-0.042, 1.0, -0.036], [0.033, -0.031, 1.0]])
HIGHEST = (100.0, 120.0, 150.0)
LIMITS = tuple((0.0, high) for high in HIGHEST)


def virtual_stage(**options):
    return VirtualStage(
        [
            PlayActuator(plays=60, highest=HIGHEST[0], stroke=16e-6),
            PreisachActuator(highest=HIGHEST[1], stroke=20e-6),
            PlayActuator(plays=60, highest=HIGHEST[2], stroke=12e-6, width=0.4),
        ],
        options.pop("coupling", COUPLING),
        **options,
    )


@contextmanager
def served(*faults, speed=20.0, stage=None, **options):
    """A server of three axes, and its virtual bench."""
    kinds = [Fault.parse(text) for text in faults]
    limits = [actual_limits(limits, kinds) for limits in LIMITS]
    bench = VirtualBench(stage or virtual_stage(), speed=speed, limits=limits, **options)
    controller = Controller(bench, reported_limits=LIMITS)
    with Server(controller, port=0, rehearsal=Rehearsal(kinds)) as server:
        yield server, bench


@contextmanager
def rig_of(server, axes="1,2,3", **options):
    with open_rig(f"pi://127.0.0.1:{server.port}/{axes}", **options) as rig:
        for each in rig.rigs:
            each._now = lambda: server.controller.instrument._speed * time.monotonic()
        yield rig
