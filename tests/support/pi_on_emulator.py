"""PI rigs on the emulated controller, for the contract of rigs: in this process, and over a socket."""

import time
from contextlib import contextmanager

from emulator import Controller, Server
from faulty_link import PipeLink, QuickRig
from hand_clock import Hand

from dehyst.instruments.pi import PiRig
from dehyst.virtual import PlayActuator, VirtualBench

LOW, HIGH = -20.0, 100.0


class Locked:
    """An instrument that a server uses at the same time."""

    def __init__(self, instrument, lock):
        self.__dict__.update(instrument=instrument, lock=lock)

    def __getattr__(self, name):
        with self.lock:
            return getattr(self.instrument.axis, name)

    def __setattr__(self, name, value):
        with self.lock:
            setattr(self.instrument.axis, name, value)


def _instrument(longest, **options):
    # A controller divides its recorder between two tables.
    return VirtualBench(
        PlayActuator(highest=HIGH, noise=1e-10),
        limits=(LOW, HIGH),
        wave_points=longest,
        record_points=2 * longest,
        **options,
    )


@contextmanager
def by_pipe(longest=65536, **options):
    """Open a PI controller in this process, with its own clock."""
    clock = Hand()
    instrument = _instrument(longest, clock=clock)
    controller = Controller(instrument)
    controller.clock = clock
    with QuickRig(PipeLink(controller), **options) as rig:
        yield rig, instrument.axis


@contextmanager
def by_tcp(longest=65536, speed=2.0, **options):
    """Open a PI controller over a socket, at twice the speed."""
    instrument = _instrument(longest, speed=speed)
    with Server(Controller(instrument), port=0) as server, PiRig.connect("127.0.0.1", server.port, **options) as rig:
        rig._now = lambda: speed * time.monotonic()
        yield rig, Locked(instrument, server.lock)
