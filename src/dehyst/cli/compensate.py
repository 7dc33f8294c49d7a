"""`dehyst compensate`: the voltage that makes an actuator follow a file or a named scan, or a scan's wave table."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    json_option,
    limits_option,
    refuse_overwriting,
    refuse_unused,
    write_output,
)
from dehyst.cli.models import AXIS_BOUNDS, AxesModel, axes_option, axis_bounds_options, bounds_of, is_stage
from dehyst.cli.output.terminal import progress_line
from dehyst.cli.record_files import path_columns_options, table_of, time_of_table
from dehyst.cli.scans import NAMES, named_scan, scan_options
from dehyst.cli.slew import Slew, path_slew_option
from dehyst.cli.start import (
    Request,
    StartFile,
    WantedPath,
    clock_columns,
    described,
    error_lines,
    given_starts,
    home_option,
    left_open,
    path_start_dict,
    planned,
    promise_lines,
    start_option,
)
from dehyst.cli.wave_table import refuse_cycles, tabulate
from dehyst.cli.zero import outside_reach, refuse_astray, scan_from_zero, zero_of_path, zero_option

if TYPE_CHECKING:
    from dehyst.control import HomedPath
    from dehyst.waveforms import Scan

_BOTH = ("output", "force", "limits", "slew", "start", "home", "sample_rate")
_OF_FILES = ("time", "columns", "join", "displacement_scale")
_OF_TEXTS = ("decimal", "max_bytes")
_OF_TABLES = ("cycle", "approach", "start_up", "tolerance")
_HOME = (
    "Put the shortest homing before the path; the output then has a column phase: 0 homing, 1 the way to the first "
    "sample, 2 the path.  [default: if --start is left out and the start matters more than the model's error]"
)


@click.command()
@click.argument("model", type=PATH)
@click.argument("trajectory", type=PATH, required=False)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, displacement and voltage here (CSV).")
@limits_option()
@path_slew_option
@axis_bounds_options
@scan_options
@click.option("--axis", type=click.Choice(["x", "y"]), help="Axis of the scan that MODEL moves.  [default: x]")
@click.option("--cycles", type=int, metavar="N", help="Cycles of the scan.  [default: 1]")
@click.option(
    "--cycle",
    type=PATH,
    metavar="TABLE",
    help="Write the scan's steady cycle here (CSV); the output then has a column "
    "phase: 0 homing, 1 start-up, 2 steady cycles. Status 1 if clipped, not settled, or the homing is not certified.",
)
@zero_option("From where the path is counted: bottom or mean of the reachable range, first: where the actuator starts.")
@home_option(_HOME)
@click.option(
    "--present", type=float, metavar="V", help="Voltage on the actuator now.  [default: 0, or that of --start]"
)
@click.option(
    "--approach", type=float, metavar="S", help="With --cycle: time to its first sample.  [default: shortest]"
)
@click.option(
    "--start-up", type=int, metavar="N", help="With --cycle: cycles before the steady ones.  [default: by --tolerance]"
)
@click.option(
    "--tolerance",
    type=float,
    metavar="UM",
    help="With --cycle: error left by the start-up.  [default: 1e-4 of the stroke]",
)
@axes_option("those of the records")
@force_option
@start_option
@path_columns_options
@json_option
def compensate(
    model: Path,
    trajectory: Path | None,
    output: Path,
    scan: str | None,
    axes: str | None,
    **options: Any,
) -> None:
    """Compute the voltage that makes the actuator follow a TRAJECTORY or a --scan; adds voltage_V, within limits.

    Without --start the state before the path is unknown: a homing comes first where that matters, and what the start
    leaves open is reported. The status is 1 if a voltage was clamped, or --home leaves more than the model's error.
    """
    from dehyst._errors import ModelError

    if (trajectory is None) == (scan is None):
        raise ModelError(
            argument="compensate", got=f"{'neither' if scan is None else 'both'} of TRAJECTORY and --scan", need="one"
        )
    _refuse_unused(is_stage(model), scan, options)
    table = options.pop("cycle")
    before = options["start"].path if isinstance(options["start"], StartFile) else None
    inputs = [path for path in (model, trajectory, before) if path is not None]
    refuse_overwriting(inputs, output, table)
    zero = options.pop("zero")
    known = AxesModel.read(model)
    requests, remarks = _requests(known, axes, options)
    places = _places(known, requests, zero)
    if zero is not None:
        counts = [
            [f"the path is counted from {place * 1e6:.6g} um of the sensor, and written in um of the sensor"]
            for place in places.tolist()
        ]
        remarks += known.prefixed(counts)
    if scan is None:
        wanted, time = _of_file(known, trajectory, axes, options, several=len(inputs) > 2)
        _follow(known, requests, (wanted + places, time, {}), output, zero, remarks)
    if known.stage is None:
        options = scan_from_zero(options, float(places[0]))
    axis, cycles = options["axis"] or "x", 1 if options["cycles"] is None else options["cycles"]
    path = named_scan(scan or "", options["sample_rate"], options)
    if table is None:
        refuse_cycles(path, cycles)
        way = _of_scan(path, axis, cycles) if known.stage is None else _of_axes(known, path, cycles, places)
        _follow(known, requests, way, output, zero, [*remarks, *path.warnings])
    wanted = path.path(axis).displacement
    remarks += _reach_remarks(requests[0], wanted, zero)
    tabulate(requests[0], path, axis, cycles, (output, table), options, remarks)


def _requests(known: AxesModel, axes: str | None, options: dict[str, Any]) -> tuple[list[Request], list[str]]:
    """Return what is asked for of each axis, and remarks on the start."""
    from dehyst.control import VoltageLimits

    limits, slews = bounds_of(known.axes, options)
    start, home, present, as_json = (options.pop(name) for name in ("start", "home", "present", "as_json"))
    starts, remarks = given_starts(known, start, limits, options, axes)
    requests = []
    for actuator, bounds, slew, named in zip(known.actuators, limits, slews, starts, strict=True):
        begin, now = named, present
        if named is not None and present is not None:
            volts = VoltageLimits(*(bounds or actuator.voltage_range)).within(present, "--present")
            begin, now = named.standing_at(actuator, volts), None
        requests.append(Request(actuator, bounds, Slew.chosen(actuator, slew), begin, home, now, as_json))
    return requests, remarks


def _places(known: AxesModel, requests: list[Request], zero: str | float | None) -> Any:
    """Return the displacement (axes,) [m] from which a path is counted."""
    import numpy as np

    places = np.array([zero_of_path(request, zero) for request in requests])
    return known.moved(places[None])[0] if isinstance(zero, str) else places


def _refuse_unused(stage: bool, scan: str | None, options: dict[str, Any]) -> None:
    """Refuse an option that would have no effect."""
    from dehyst._errors import ModelError

    of_path = (*_OF_FILES, *_OF_TEXTS) if scan is None else ("scan", "cycles", *NAMES)
    # A start in a file is read too.
    of_path += _OF_TEXTS if isinstance(options["start"], StartFile) else ()
    if stage:
        of_axes = ("axes",) if scan is None or isinstance(options["start"], StartFile) else ()
        refuse_unused(
            f"with a stage and {_path_words(scan)}", *_BOTH, *of_path, *of_axes, *AXIS_BOUNDS, "present", "zero"
        )
    else:
        more = (
            ("displacement",)
            if scan is None
            else ("axis", "cycle")
            if options["cycle"] is None
            else ("axis", *_OF_TABLES)
        )
        beside = f"with {_path_words(scan)}{'' if scan is None or options['cycle'] else ' without --cycle'}"
        refuse_unused(beside, *_BOTH, *of_path, *more, "present", "zero")
    if options["start"] is not None and options["home"]:
        raise ModelError(argument="start", got="it with --home, which determines the state", hint="leave one out")
    if options["present"] is not None and options["start"] is None and options["home"] is False:
        raise ModelError(
            argument="present", got="it with --no-home, without a homing", hint="leave one out, or give --start"
        )


def _path_words(scan: str | None) -> str:
    return "a TRAJECTORY" if scan is None else "--scan"


def _reach_remarks(request: Request, wanted: Any, zero: str | float | None) -> list[str]:
    """Refuse a path far outside of the reachable range; return a remark if it lies outside at all."""
    refuse_astray(request.actuator, wanted, request.limits, zero)
    return outside_reach(request.actuator, wanted, request.limits, zero)


def _of_file(
    known: AxesModel, trajectory: Path | None, axes: str | None, options: dict[str, Any], several: bool
) -> tuple[Any, dict[str, Any]]:
    """Return the wanted displacements (n, axes) [m], and the time column if there is one."""
    table = table_of(trajectory or Path(), options, several)
    wanted = known.values_in(table, "displacement", axes, options)
    return wanted, time_of_table(table, len(wanted), options)


def _of_scan(scan: Scan, axis: str, cycles: int) -> WantedPath:
    """Return the wanted displacement (n, 1) [m], its time and its derivatives."""
    path = scan.path(axis)
    if cycles != 1 or path.periodic:
        path = path.repeated(cycles)
    rates = {"velocity": path.velocity, "acceleration": path.acceleration}
    return path.displacement[:, None], {"time_s": path.time}, rates


def _of_axes(known: AxesModel, scan: Scan, cycles: int, places: Any) -> WantedPath:
    """Return displacements (n, axes) [m]: a scan on the axes x and y, or the first two, the others in their middle."""
    import numpy as np

    from dehyst._errors import ModelError

    if len(known.axes) < 2:
        raise ModelError(argument="scan", got=f"{len(known.axes)} axis", need="a stage of two axes at least")
    middle = known.moved(np.array([[0.5 * sum(one.reach) for one in known.actuators]]))
    parts = [_of_scan(scan, axis, cycles) for axis in "xy"]
    wanted = np.tile(middle, (len(parts[0][0]), 1))
    for k, (axis, part) in enumerate(zip("xy", parts, strict=True)):
        j = known.axes.index(axis) if {"x", "y"} <= set(known.axes) else k
        wanted[:, j] = part[0][:, 0] + places[j]
    return wanted, parts[0][1], {}


def _follow(
    known: AxesModel,
    requests: list[Request],
    path: WantedPath,
    output: Path,
    zero: str | float | None,
    remarks: list[str],
) -> None:
    """Write the voltages of a path, and exit."""
    from dehyst.trust import judge

    wanted, time, derivatives = path
    if "time_s" not in time:
        requests = [
            one._replace(slew=Slew.chosen(one.actuator, None, timed=False)) if one.slew.origin == "records" else one
            for one in requests
        ]
    first, slews = requests[0], [request.slew for request in requests]
    limits = [request.limits or request.actuator.voltage_range for request in requests]
    own = [
        [
            *_reach_remarks(request, target, zero),
            *request.slew.remarks(request.actuator, allowed, target, time.get("time_s"), **derivatives),
        ]
        for request, allowed, target in zip(requests, limits, known.targets(wanted).T, strict=True)
    ]
    answers = planned(known, requests, path)
    starts = [described(*each) for each in zip(requests, answers, strict=True)]
    samples, progress = answers[0].voltage.size, progress_line()
    progress(f"writing {samples} rows")
    write_output(output, _written(known, answers, time))
    progress("")
    warnings = [*remarks, *known.prefixed(own), *known.prefixed(found for _, found in starts)]
    clamped = [int(answer.clamped.sum()) for answer in answers]
    misses = [float(abs(answer.expected - answer.displacement).max(initial=0.0)) for answer in answers]
    spans = [(float(answer.voltage.min()), float(answer.voltage.max())) for answer in answers]
    judged = [judge(one.actuator, path=left_open(path)) for one, path in zip(requests, answers, strict=True)]
    result = {
        "samples": samples,
        "clamped": known.by_axis(clamped),
        "missed_um": known.by_axis(miss * 1e6 for miss in misses),
        "lowest_V": known.by_axis(low for low, _ in spans),
        "highest_V": known.by_axis(high for _, high in spans),
        **known.merged([slew.as_dict() for slew in slews]),
        **known.merged([path_start_dict(answer) for answer in answers]),
        "judgement": known.by_axis(one.as_dict() for one in judged),
        "warnings": warnings,
        "state": known.by_axis(answer.state.as_dict() for answer in answers),
        "output": str(output),
    }
    words = []
    parts = zip(answers, slews, limits, spans, starts, clamped, misses, strict=True)
    for answer, slew, allowed, (low, high), (start, _), count, miss in parts:
        missed = slew.missed_words(allowed, answer.voltage[answer.first :], miss) if count else ""
        words.append([f"{low:.6g} to {high:.6g} V {start}{missed}"])
    lines = [f"{counted(samples, 'sample')}, {', '.join(known.prefixed(words))}: {output}"]
    lines += known.prefixed([slew.words] for slew in slews)
    lines += known.prefixed(error_lines(answer) for answer in answers)
    lines += known.prefixed(promise_lines(*each) for each in zip(requests, judged, strict=True))
    conclude(first.as_json, result, lines, warnings)
    certified = all(answer.certified for answer in answers)
    sys.exit(0 if all(answer.followed for answer in answers) and (certified or not first.home) else 1)


def _written(known: AxesModel, answers: list[HomedPath], time: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of a wanted displacement, its voltage and the displacement to expect, of each axis."""
    import numpy as np

    wanted, volts, expected = (
        np.column_stack([getattr(answer, name) for answer in answers])
        for name in ("displacement", "voltage", "expected")
    )
    columns = known.columns("displacement", wanted * 1e6) | known.columns("voltage", volts)
    return {**clock_columns(answers[0], time), **columns, **known.columns("displacement", expected * 1e6, "expected")}
