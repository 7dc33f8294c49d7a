"""`dehyst rig`: emulated instruments for rehearsals without a real one."""

from __future__ import annotations

import math
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from dehyst.cli.terminal import echo

if TYPE_CHECKING:
    from dehyst.virtual import VirtualBench
    from dehyst.virtual.emulator import Fault, Server


class Finite(click.FloatRange):
    """A range of numbers without NaN and infinity."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Refuse what is not finite."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number", param, ctx)
        return number


@click.group()
def rig() -> None:
    """Serve an emulated instrument."""


@rig.command()
@click.option(
    "--actuator",
    default="play",
    show_default=True,
    metavar="play|creep|preisach|boucwen|MODEL.json",
    help="Actuator to drive: a virtual one that is not an instance of any model, or a model file.",
)
@click.option("--host", default="127.0.0.1", show_default=True, help="Interface to listen on; 0.0.0.0 is all.")
@click.option("--port", type=click.IntRange(0, 65535), default=50000, show_default=True, help="0: any that is free.")
@click.option("--limits", type=(float, float), metavar="LOW HIGH", help="Voltages.  [default: the actuator's]")
@click.option("--slew", type=float, metavar="V/S", help="Slew rate of the amplifier.  [default: not limited]")
@click.option(
    "--speed",
    type=Finite(min=0, min_open=True, max=1e6),
    default=1.0,
    show_default=True,
    metavar="X",
    help="Seconds of the instrument for each second of the clock.",
)
@click.option(
    "--noise",
    type=Finite(min=0, max=1e6),
    metavar="NM",
    help="Noise of the sensor.  [default: the actuator's, 2 nm]",
)
@click.option(
    "--wave-points",
    type=click.IntRange(2, 10_000_000),
    default=65536,
    show_default=True,
    metavar="N",
    help="Samples that wave generator and recorder hold.",
)
@click.option(
    "--fault",
    "faults",
    multiple=True,
    metavar="NAME[@WHEN]",
    help="A fault to rehearse, after so many samples of a wave (drop@2000) or seconds (unplug@3.5s), or in the middle "
    "of the first wave: drop, silence, garble, truncate, error, narrow, saturate, unplug, refuse, stall.",
)
@click.option("--seconds", type=Finite(min=0), metavar="S", help="Stop after this time.  [default: at Ctrl-C]")
@click.option("--epics", metavar="PREFIX", help="Also serve the same instrument by EPICS Channel Access.")
def serve(
    actuator: str,
    host: str,
    port: int,
    faults: tuple[str, ...],
    seconds: float | None,
    epics: str | None,
    **options: Any,
) -> None:
    """Serve an emulated piezo controller that speaks GCS 2.0 over TCP.

    At the end it prints the voltages that it has put out.
    """
    from dehyst.virtual.emulator import Controller, Fault, Rehearsal, Server

    rehearsed = [Fault.parse(text) for text in faults]
    instrument, reported = _instrument(actuator, rehearsed, **options)
    lock, rehearsal = threading.Lock(), Rehearsal(rehearsed, report=lambda words: echo(f"fault: {words}"))
    controller = Controller(instrument, reported_limits=reported)
    server = Server(controller, host=host, port=port, lock=lock, rehearsal=rehearsal)
    if epics is not None:
        _serve_epics(instrument, epics, lock)
    with _stop_by_signal(server):
        echo(f"serving {actuator}, {reported[0]:g} to {reported[1]:g} V, on pi://{host}:{server.port}")
        sys.stdout.flush()
        server.serve(seconds)
    echo(f"{_tally(instrument)}, {controller.recorder.rows_sent} samples reported")


def _instrument(
    actuator: str,
    faults: list[Fault],
    *,
    limits: tuple[float, float] | None,
    slew: float | None,
    speed: float,
    noise: float | None,
    wave_points: int,
) -> tuple[VirtualBench, tuple[float, float]]:
    """Return the virtual bench, and the limits [V] that it reports."""
    from dehyst.model import Actuator
    from dehyst.virtual import ModelledActuator, VirtualBench
    from dehyst.virtual.emulator.faults import actual_limits
    from dehyst.virtual.modelled import virtual_actuator

    driven = virtual_actuator(actuator)
    if isinstance(driven, Actuator):
        limits, driven = limits or driven.limits, ModelledActuator(driven)
    reported = limits or (0.0, driven.highest)
    bench = VirtualBench(
        driven,
        limits=actual_limits(reported, faults),
        slew_rate=slew,
        wave_points=wave_points,
        record_points=wave_points,
        speed=speed,
        noise=None if noise is None else 1e-9 * noise,
    )
    return bench, reported


def _serve_epics(instrument: VirtualBench, prefix: str, lock: threading.Lock) -> None:
    from importlib import import_module
    from importlib.util import find_spec

    from dehyst._errors import RigError

    if find_spec("dehyst.virtual.emulator.epics_ioc") is None:
        raise RigError("--epics: this version of dehyst does not serve EPICS; leave it out")
    import_module("dehyst.virtual.emulator.epics_ioc").serve_ioc(instrument, prefix, lock)
    echo(f"serving epics://{prefix}")


@contextmanager
def _stop_by_signal(server: Server) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM stop the server, and not the program."""
    before = {number: signal.signal(number, lambda *_: server.stop()) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _tally(instrument: VirtualBench) -> str:
    log, present = instrument.log, instrument.voltage
    refused = f", {log.refused} requests refused" if log.refused else ""
    return (
        f"put out {log.lowest:.6g} to {log.highest:.6g} V, largest step {log.largest_step:.4g} V, steepest "
        f"{log.steepest:.6g} V/s, now at {present:.6g} V{refused}"
    )
