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

from dehyst.cli.common import refuse_given
from dehyst.cli.output.terminal import echo

if TYPE_CHECKING:
    from dehyst.virtual import VirtualActuator, VirtualBench
    from dehyst.virtual.bench import BenchAxis
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
    help="Actuator to drive: a virtual one that is not an instance of any model, or a model file; with --axes one for "
    "all axes, or one for each (play,preisach,boucwen).",
)
@click.option(
    "--axes",
    type=click.IntRange(1, 6),
    default=1,
    show_default=True,
    metavar="N",
    help="Axes of one body, a channel and a wave generator each, whose displacements are coupled.",
)
@click.option(
    "--coupling",
    type=Finite(min=0, max=30),
    default=4.0,
    show_default=True,
    metavar="PERCENT",
    help="With --axes: largest displacement of one axis by another.",
)
@click.option(
    "--hysteretic",
    type=Finite(min=0, max=30),
    default=0.0,
    show_default=True,
    metavar="PERCENT",
    help="With --axes: more coupling, by elements whose loops have another shape than those of the actuators.",
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
    axes: int,
    coupling: float,
    hysteretic: float,
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
    from dehyst._errors import RigError
    from dehyst.virtual.emulator import Controller, Fault, Rehearsal, Server

    rehearsed = [Fault.parse(text) for text in faults]
    if axes == 1:
        refuse_given("with one axis", "coupling", "hysteretic")
    elif epics is not None:
        raise RigError("serves one axis", argument="epics", hint="leave out --epics or --axes")
    instrument, ranges = _instrument(_names(actuator, axes), rehearsed, coupling, hysteretic, **options)
    lock, rehearsal = threading.Lock(), Rehearsal(rehearsed, report=lambda words: echo(f"fault: {words}"))
    controller = Controller(instrument, reported_limits=ranges)
    server = Server(controller, host=host, port=port, lock=lock, rehearsal=rehearsal)
    if epics is not None:
        _serve_epics(instrument, epics, lock)
    with _stop_by_signal(server):
        words = ", ".join(dict.fromkeys(f"{low:g} to {high:g} V" for low, high in ranges))
        path = "" if axes == 1 else "/" + ",".join(one.name for one in controller.axes)
        echo(f"serving {actuator}, {words}, on pi://{host}:{server.port}{path}")
        sys.stdout.flush()
        server.serve(seconds)
    for one in controller.axes:
        echo(
            ("" if axes == 1 else f"axis {one.name}: ")
            + _tally(one.bench)
            + (f", {controller.rows_sent} samples reported" if one is controller.axes[-1] else "")
        )


def _instrument(
    actuators: list[str],
    faults: list[Fault],
    coupling: float,
    hysteretic: float,
    *,
    limits: tuple[float, float] | None,
    **options: Any,
) -> tuple[VirtualBench, list[tuple[float, float]]]:
    """Return the virtual bench, and the limits [V] that it reports of each axis."""
    import numpy as np

    from dehyst.virtual import VirtualBench, VirtualStage
    from dehyst.virtual.emulator.faults import actual_limits
    from dehyst.virtual.stage import spread_coupling

    driven, own = zip(*map(_driven, actuators), strict=True)
    reported = [limits or one for one in own]
    device, count = driven[0], len(driven)
    if count > 1:
        table, second = (spread_coupling(count, share / 100) for share in (coupling, hysteretic))
        device = VirtualStage(driven, np.eye(count) + table, hysteretic=second)
    actual = [actual_limits(one, faults) for one in reported]
    return VirtualBench(device, limits=actual, **_bench_options(**options)), reported


def _names(actuator: str, axes: int) -> list[str]:
    """Return the name of the actuator of each axis."""
    names = actuator.split(",")
    if len(names) not in (1, axes):
        raise click.BadParameter(
            f"got {len(names)} actuators for {axes} axes, need one, or one for each", param_hint="--actuator"
        )
    return names * axes if len(names) == 1 else names


def _driven(actuator: str) -> tuple[VirtualActuator, tuple[float, float]]:
    """Return an actuator, and its own limits [V]."""
    from dehyst.model import Actuator
    from dehyst.virtual import ModelledActuator
    from dehyst.virtual.modelled import virtual_actuator

    driven = virtual_actuator(actuator)
    if isinstance(driven, Actuator):
        modelled = ModelledActuator(driven)
        return modelled, driven.limits or (0.0, modelled.highest)
    return driven, (0.0, driven.highest)


def _bench_options(*, slew: float | None, speed: float, noise: float | None, wave_points: int) -> dict[str, Any]:
    return {
        "slew_rate": slew,
        "wave_points": wave_points,
        "record_points": wave_points,
        "speed": speed,
        "noise": None if noise is None else 1e-9 * noise,
    }


def _serve_epics(instrument: VirtualBench, prefix: str, lock: threading.Lock) -> None:
    from importlib import import_module
    from importlib.util import find_spec

    from dehyst._errors import RigError

    if find_spec("dehyst.virtual.emulator.epics_ioc") is None:
        raise RigError("this version of dehyst does not serve EPICS", argument="epics", hint="leave it out")
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


def _tally(axis: BenchAxis) -> str:
    log, present = axis.log, axis.voltage
    refused = f", {log.refused} requests refused" if log.refused else ""
    return (
        f"put out {log.lowest:.6g} to {log.highest:.6g} V, largest step {log.largest_step:.4g} V, steepest "
        f"{log.steepest:.6g} V/s, now at {present:.6g} V{refused}"
    )
