"""`calibrate` and `rig serve`: the whole experiment on an instrument, and emulated instruments to rehearse it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import dehyst._validation as check
from dehyst._errors import DehystError, RigError
from dehyst._io import demand_alike, format_of
from dehyst.calibration import Calibration, Plan
from dehyst.calibration import calibrate as run_calibration
from dehyst.calibration.experiment import RESULTS, STAGE_RESULTS
from dehyst.calibration.plan import entries, read_voltage
from dehyst.calibration.session import FORMAT
from dehyst.identification import Fit, StageFit
from dehyst.instruments import AbstractRig, open_rig
from dehyst.model import Actuator
from dehyst.operations.axes import Limit, Slew, limits_of, slews_of
from dehyst.operations.declaration import Folder, Input, Only, Values, beside, operation
from dehyst.operations.files import AS_FOUND, Columns
from dehyst.operations.paths import bounds_remarks
from dehyst.operations.run import Result, Run
from dehyst.report import write_calibration, write_stage_report
from dehyst.virtual import AgeingActuator, AgeingCourse, ModelledActuator, VirtualActuator, VirtualBench, VirtualStage
from dehyst.virtual.bench import BenchAxis
from dehyst.virtual.emulator import Controller, Fault, Rehearsal, Server
from dehyst.virtual.emulator.epics_ioc import serve_ioc
from dehyst.virtual.emulator.faults import actual_limits
from dehyst.virtual.modelled import virtual_actuator
from dehyst.virtual.stage import spread_coupling

REPORT = "report.html"


def _names(given: Values) -> list[str] | None:
    """Return the names of several axes; None for one."""
    if given.get("axes") is not None:
        return [name.strip() for name in given["axes"].split(",")]
    last = str(given["rig"]).rpartition("/")[2]
    return last.split(",") if given["rig"].lower().startswith("pi://") and "," in last else None


_single = Only(lambda given: _names(given) is None, "with several axes")


@operation(Plan, rare=("rounds",))
def calibrate(
    run: Run,
    rig: str,
    *,
    output: Folder = Path("dehyst-calibration"),
    axes: str | None = None,
    limits: tuple[Limit, ...] = (),
    slew_rate: tuple[Slew, ...] = (),
    frequency: float = 1.0,
    hold: Annotated[float | None, _single] = None,
    protocol: Annotated[tuple[Input, ...], _single] = (),
    rounds: Annotated[int, _single] = 2,
    goal: float = 1.0,
    dry_run: bool = False,
    columns: Annotated[Columns, beside("protocol")] = AS_FOUND,
) -> Result:
    """Home, excite, record, identify, compensate and measure the actuator on RIG.

    RIG: pi://HOST:PORT, epics://PREFIX, sim://play, or FILE.py:FUNCTION, which returns a rig of your own. Several axes
    of one rig: pi://HOST:PORT/1,2,3, or --axes 1,2,3.

    Ctrl-C brings the voltage to a safe value; the same command continues from the records on disk, or with several axes
    begins again.

    Parameters
    ----------
    output
        Folder for records, model and report. With one axis, complete records in it are not played again, except one
        loop that must agree with them.
    axes
        Calibrate these axes of one body together, as 1,2,3: coupling, model and path of all axes; default: one axis.
    limits
        Range of the voltage [V]; default: the device's.
    slew_rate
        Largest slew rate [V/s]; default: the whole range in 0.1 s.
    protocol
        Record these voltages (from dehyst excite) instead of suggested ones.
    dry_run
        Print what would be sent, and send nothing.
    """
    columns.demand(("max_size",), "on voltages to play")
    names = _names({"rig": rig, "axes": axes})
    every = names or [""]
    allowed, rates = limits_of(every, limits), slews_of(every, slew_rate)
    steepest = [None if one is None else one.number for one in rates]
    played = tuple(read_voltage(path, max_bytes=columns.max_bytes).excitation for path in protocol)
    plan = Plan(protocol=played, frequency=frequency, hold=hold, rounds=rounds, goal=goal)
    if not dry_run and format_of(output / "campaign.json") != FORMAT:
        for name in (*(STAGE_RESULTS if names else RESULTS), REPORT):
            demand_alike(output / name)
    # A rig of one axis need not know lists.
    several = len(every) > 1
    bounds, steep = allowed if several else allowed[0], steepest if several else steepest[0]
    with (
        _left(output, again=names is None),
        open_rig(rig, names, limits=bounds, slew_rate=steep) as instrument,
    ):
        if len(instrument.axes) != len(every):
            raise RigError(f"{instrument.name}: has several axes; give --axes {','.join(instrument.axes)}")
        for one, wanted, rate in zip(instrument.rigs, allowed, rates, strict=True):
            device = f"axis {one.axis} of the device" if names else "the device"
            for remark in bounds_remarks(wanted, rate, one.limits, f"{device} allows no more"):
                run.note(remark)
        if dry_run:
            return _planned(instrument, plan)
        calibration = _calibrated(run, instrument, output, plan)
    kept = calibration.kept
    warnings = [] if calibration.agreement is None else [calibration.agreement.words]
    if kept and not calibration.played:
        warnings.append(f"nothing else was played; the rest comes from records on disk, {calibration.since}; {_ANEW}")
    elif kept:
        warnings.append(f"from records on disk, {calibration.since}, not played again: {', '.join(kept)}; {_ANEW}")
    fields = {**calibration.as_dict(), "output": str(output)}
    warnings += calibration.warnings()
    return Result(fields, [*_lines(calibration, output)], warnings=warnings, good=calibration.good)


_ANEW = "give another -o to measure anew"


@contextmanager
def _left(output: Path, *, again: bool) -> Iterator[None]:
    """Add to the error that ends a calibration where its records are, and whether the same command continues."""
    try:
        yield
    except (DehystError, KeyboardInterrupt, SystemExit) as error:
        records = output / "records"
        if any(records.glob("*.csv")):
            # A full disk may have room later; a folder of another instrument remains one.
            temporary = isinstance(error, RigError) or isinstance(error.__cause__, OSError)
            continues = again and (not isinstance(error, Exception) or temporary)
            end = "; the same command goes on from there" if continues else ""
            error.add_note(f"the records so far are in {records}{end}")
        raise


def _planned(rig: AbstractRig, plan: Plan) -> Result:
    """Return the voltages that would be sent, as JSON values and lines."""
    planned, several = entries(rig, plan), len(rig.axes) > 1
    columns: dict[str, list[Any]] = {
        "axes" if several else "axis": list(rig.axes),
        "limits_V": [[one.limits.low, one.limits.high] for one in rig.rigs],
        "slew_rate_V_per_s": [one.slew_rate for one in rig.rigs],
        "safe_V": [one.safe for one in rig.rigs],
    }
    allowed = columns if several else {name: values[0] for name, values in columns.items()}
    bounds = "; ".join(f"axis {one.axis}: {one.limits.words}, at most {one.slew_rate:.6g} V/s" for one in rig.rigs)
    more = "" if several else ", and further recordings that are suggested on the way"
    seconds = sum(entry.get("seconds", 0.0) for entry in planned)
    lines = [
        f"{rig.name}, {bounds}; nothing was sent",
        *_step_lines(planned),
        f"up to {seconds:.0f} s of playing in all{more}",
    ]
    return Result({"rig": rig.name, **allowed, "steps": planned}, lines)


def _step_lines(planned: Sequence[dict[str, Any]]) -> Iterator[str]:
    def joined(values: float | list[float], digits: int = 6) -> str:
        return ", ".join(f"{value:.{digits}g}" for value in (values if isinstance(values, list) else [values]))

    for entry in planned:
        numbers = ""
        if "samples" in entry:
            numbers = (
                f"{entry['seconds']:8.1f} s {entry['samples']:7d} samples, {joined(entry['lowest_V'])} to "
                f"{joined(entry['highest_V'])} V, up to {joined(entry['steepest_V_per_s'], 4)} V/s; "
            )
        yield f"  {entry['step']:12s}{numbers}{entry['what']}"


def _calibrated(run: Run, rig: AbstractRig, output: Path, plan: Plan) -> Calibration:
    if len(rig.axes) > 1:
        for line in _step_lines(entries(rig, plan)):
            run.note(line)
    with run.watch() as watcher:
        calibration = run_calibration(rig, output, plan=plan, watcher=watcher)
        watcher.step("report")
        if isinstance(calibration.fit, StageFit):
            records = [*calibration.training, *calibration.held_out]
            write_stage_report(output / REPORT, calibration.fit, records, command=run.command)
        else:
            write_calibration(output / REPORT, calibration, command=run.command)
        return calibration


def _lines(calibration: Calibration, output: Path) -> Iterator[str]:
    fit, several = calibration.fit, bool(calibration.compensated.axes)
    if isinstance(fit, Fit):
        yield fit.outcome.value
        for error in fit.errors:
            errors = f"largest {error.largest_percent:6.3f} %  RMS {error.rms_percent:6.3f} % of the stroke"
            yield f"  {error.record:12s} {error.role:12s} {errors}"
    else:
        yield from fit.summary().split("\n")
    what = "of all axes together, in % of the stroke of each" if several else "of nine reversals, in % of the stroke"
    yield f"Measured along a path {what}:"
    for name, path in (("nominal", calibration.nominal), ("compensated", calibration.compensated)):
        for axis, one in zip(path.axes or ("",), path.each, strict=True):
            word = f"axis {axis:6s} " if axis else ""
            yield f"  {name:12s} {word}largest {one.largest_percent:6.3f} %  RMS {one.rms_percent:6.3f} %"
    yield f"{'stage' if several else 'model'}.json, report.html, calibration.json and records: {output}"


_coupled = Only(lambda given: given.get("axes", 1) > 1, "with one axis")


@operation(name="rig serve", returns=False, rare=("hysteretic", "noise", "wave_points", "host", "ageing"))
def serve(
    run: Run,
    *,
    actuator: str = "play",
    axes: int = 1,
    coupling: Annotated[float, _coupled] = 4.0,
    hysteretic: Annotated[float, _coupled] = 0.0,
    host: str = "127.0.0.1",
    port: int = 50000,
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    speed: float = 1.0,
    noise: float | None = None,
    ageing: AgeingCourse | None = None,
    wave_points: int = 65536,
    fault: tuple[str, ...] = (),
    seconds: float | None = None,
    epics: Annotated[str | None, Only(lambda given: given.get("axes", 1) == 1, "with several axes")] = None,
) -> Result:
    """Serve an emulated piezo controller that speaks GCS 2.0 over TCP.

    At the end it prints the range and steps of its output voltages.

    Parameters
    ----------
    actuator
        Actuator to drive: play, creep, preisach or boucwen, which are not instances of a dehyst model, or a model file.
        With several axes: one for all, or one for each (play,preisach,boucwen).
    axes
        Number of axes of one body, 1 to 6, with coupled displacements; each has a channel and a wave generator.
    coupling
        Largest displacement of one axis by another [%].
    hysteretic
        Additional coupling [%] by elements whose loops have another shape than the actuators' loops.
    host
        Interface to listen on; 0.0.0.0 for all.
    port
        TCP port; 0: any free port.
    limits
        Voltages [V]; default: the actuator's.
    slew_rate
        Of the amplifier [V/s]; default: not limited.
    speed
        Speed of the instrument: its seconds for each second of real time.
    noise
        Of the sensor [nm]; default: the actuator's, 2 nm.
    ageing
        Changes of each actuator that grow until a time has passed: of its gain [%], of the width of its loop [%], of
        the sensor's zero [% of the stroke]; and this time [s of the instrument]; default: none. Kelvins are for
        sim:// only: this instrument records no temperature.
    wave_points
        Largest number of samples of wave generator and recorder.
    fault
        A fault to rehearse, NAME@WHEN: after a number of samples of a wave (drop@2000) or a time (unplug@3.5s); without
        @WHEN, in the middle of the first wave. NAME: drop, silence, garble, truncate, error, narrow, saturate, unplug,
        refuse, stall. May be repeated.
    seconds
        Stop after this time [s]; default: at Ctrl-C.
    epics
        Also serve the same instrument by EPICS Channel Access, with this prefix.
    """
    check.between(axes, "axes", 1, 6)
    check.between(coupling, "coupling", 0, 30, "a share in %")
    check.between(hysteretic, "hysteretic", 0, 30, "a share in %")
    check.between(port, "port", 0, 65535)
    check.between(speed, "speed", 1e-9, 1e6)
    check.between(0.0 if noise is None else noise, "noise", 0, 1e6, "nanometres")
    check.between(wave_points, "wave_points", 2, 10_000_000)
    check.between(seconds or 0.0, "seconds", 0, 1e9, "seconds")
    if ageing is not None and ageing.kelvins:
        raise RigError(
            argument="ageing",
            got=f"kelvins={ageing.kelvins:g}",
            need="none, as this instrument records no temperature",
            hint=f"the rig sim://{actuator.split(',', maxsplit=1)[0]}?{ageing} records it",
        )
    names = actuator.split(",")
    if len(names) not in (1, axes):
        raise RigError(argument="actuator", got=f"{len(names)} for {axes} axes", need="one, or one for each")
    rehearsed = [Fault.parse(text) for text in fault]
    shares = coupling / 100, hysteretic / 100
    bench = {"slew_rate": slew_rate, "speed": speed, "wave_points": wave_points, "record_points": wave_points}
    instrument, ranges = _instrument(
        names * axes if len(names) == 1 else names,
        rehearsed,
        limits,
        shares,
        **bench,
        noise=None if noise is None else 1e-9 * noise,
        ageing=ageing,
    )
    lock, rehearsal = threading.Lock(), Rehearsal(rehearsed, report=lambda words: run.say(f"fault: {words}"))
    controller = Controller(instrument, reported_limits=ranges)
    server = Server(controller, host=host, port=port, lock=lock, rehearsal=rehearsal)
    if epics is not None:
        serve_ioc(instrument, epics, lock)
        run.say(f"serving epics://{epics}")
    with _stop_by_signal(server):
        words = ", ".join(dict.fromkeys(f"{low:g} to {high:g} V" for low, high in ranges))
        path = "" if axes == 1 else "/" + ",".join(one.name for one in controller.axes)
        run.say(f"serving {actuator}, {words}, on pi://{host}:{server.port}{path}")
        server.serve(seconds)
    lines = [f"{'' if axes == 1 else f'axis {one.name}: '}{_tally(one.bench)}" for one in controller.axes]
    lines[-1] += f", {controller.rows_sent} samples reported"
    return Result({}, lines)


def _instrument(
    names: Sequence[str],
    faults: Sequence[Fault],
    limits: tuple[float, float] | None,
    shares: tuple[float, float],
    *,
    ageing: AgeingCourse | None,
    **options: Any,
) -> tuple[VirtualBench, list[tuple[float, float]]]:
    """Return the virtual bench, and the limits [V] that it reports of each axis."""
    driven, own = zip(*map(_driven, names), strict=True)
    reported = [limits or one for one in own]
    driven = driven if ageing is None else tuple(AgeingActuator(one, ageing) for one in driven)
    device, count = driven[0], len(driven)
    if count > 1:
        table, second = (spread_coupling(count, share) for share in shares)
        device = VirtualStage(driven, np.eye(count) + table, hysteretic=second)
    return VirtualBench(device, limits=[actual_limits(one, faults) for one in reported], **options), reported


def _driven(name: str) -> tuple[VirtualActuator, tuple[float, float]]:
    """Return an actuator, and its own limits [V]."""
    driven = virtual_actuator(name)
    if isinstance(driven, Actuator):
        modelled = ModelledActuator(driven)
        return modelled, driven.limits or (0.0, modelled.highest)
    return driven, (0.0, driven.highest)


@contextmanager
def _stop_by_signal(server: Server) -> Iterator[None]:
    """Let Ctrl-C and SIGTERM stop the server instead of the program."""
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
