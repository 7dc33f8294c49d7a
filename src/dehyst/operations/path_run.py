"""`run`: a path followed once on an instrument, and its error."""

from __future__ import annotations

import numpy as np

from dehyst._errors import ModelError, RecordError
from dehyst._types import Array
from dehyst.calibration import TrackedPath
from dehyst.calibration.plan import even_rate
from dehyst.control import Compensator, PathPlan, VoltageLimits, plan_path
from dehyst.instruments import AbstractRig, open_rig, played_rate
from dehyst.model import slew_rate_of_records
from dehyst.operations.axes import AxesModel, Slew, is_stage
from dehyst.operations.declaration import Input, Output, operation
from dehyst.operations.files import AS_FOUND, PATH, Columns, clock_of, values_of, write_table
from dehyst.operations.paths import PathSlew, Zero, bounds_remarks, reach_remarks, temperature_of, zero_of_path
from dehyst.operations.run import Result, Run, files
from dehyst.records import Record, columns_of, table_of
from dehyst.records.files import demand_text
from dehyst.waveforms import Excitation

# Part by which a rate may differ without a remark.
_RATES = 0.01


@operation(name="run")
def run_path(
    run: Run,
    rig: str,
    *,
    model: Input,
    path: Input,
    output: Output | None = None,
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    zero: Zero | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Follow a path on RIG, after a homing, and measure the error.

    RIG: as of dehyst calibrate, with one axis. Homing and path are played as one wave. The voltage ends at the safe
    one; Ctrl-C brings it there too. The status is 1 if a voltage of the path was clamped.

    Parameters
    ----------
    model
        The model (JSON) of one axis.
    path
        A file with times and a displacement, or the path of dehyst scan. A column temperature_C counts if the model
        depends on temperature.
    output
        Write the record of the path here (CSV), with the wanted displacement.
    limits
        Range of the voltage [V]; default: that of the model and the device.
    slew_rate
        Largest slew rate [V/s]; default: the device's, or the whole range in 0.1 s.
    zero
        Zero of the path, as of dehyst compensate.
    columns
        Columns of the path.
    """
    columns.demand(PATH, "on a path")
    if output is not None:
        demand_text(output)
    if is_stage(model):
        raise ModelError(argument="model", got="one of several axes", need="one of a single axis")
    known = AxesModel.read(run, model)
    (actuator,) = known.actuators
    table = table_of(path, columns)
    wanted, clock = values_of(table, "displacement", columns), clock_of(table, columns)
    if not clock:
        raise RecordError(argument="path", got="no times", need="a time of each sample", hint="--columns rate=HERTZ")
    warmth = temperature_of(known, None, columns, table, len(wanted), remark=run.note)
    rate = even_rate(path, clock["time_s"])
    with open_rig(rig, limits=limits, slew_rate=slew_rate) as instrument:
        device, recorded = instrument.limits, actuator.voltage_range
        bounds = VoltageLimits(max(device.low, recorded[0]), min(device.high, recorded[1]), instrument.slew_rate)
        wanted = wanted + zero_of_path(actuator, (device.low, device.high), zero)
        # Refused in micrometres here; the library's refusal would be in metres.
        reach_remarks(actuator, wanted, recorded, zero, warmth)
        played = played_rate(instrument, rate)
        if abs(played / rate - 1) > _RATES:
            run.note(f"the path has {rate:.6g} Hz, and is played at {played:.6g} Hz, as {instrument.name} can")
        asked_slew = None if slew_rate is None else Slew("", slew_rate)
        remarks = bounds_remarks(limits, asked_slew, bounds, "device and model allow no more")
        slew = PathSlew(bounds.slew_rate, "option", slew_rate_of_records(actuator))
        if slew_rate is not None or slew.times > 1:
            remarks.append(slew.words)
        for remark in [*remarks, *reach_remarks(actuator, wanted, (bounds.low, bounds.high), zero, warmth)]:
            run.note(remark)
        loop = Compensator(actuator, (bounds.low, bounds.high), bounds.slew_rate, period=1 / played, warns=False)
        present, at = bounds.nearest(instrument.read().voltage), np.arange(wanted.size) / played
        planned = plan_path(loop, wanted, time=at, temperature=warmth, home=True, present=present, on_time=True)
        promise = planned.promise
        for line in () if promise is None else promise.lines:
            run.say(line)
        record, reached = _played(run, instrument, planned, wanted, played, actuator.stroke)
    if output is not None:
        write_table(output, {**columns_of(record), "wanted_um": 1e6 * reached.wanted})
    clamped = int(planned.clamped.sum())
    fields = {
        "rig": instrument.identity,
        "limits_V": [bounds.low, bounds.high],
        "slew_V_per_s": bounds.slew_rate,
        "promise": None if promise is None else promise.as_dict(),
        **reached.as_dict(),
        "clamped": clamped,
    }
    words = f"largest error {reached.largest_percent:.3f} %, RMS {reached.rms_percent:.3f} %"
    head = f"Followed: {words} of the stroke of {1e6 * actuator.stroke:.4g} um"
    if clamped:
        head += f"; {clamped} samples were clamped at a limit or by the slew rate"
    return Result(fields, [head, *files(Record=output)], good=not clamped)


def _played(
    run: Run, rig: AbstractRig, planned: PathPlan, wanted: Array, rate: float, stroke: float
) -> tuple[Record, TrackedPath]:
    """Play a planned path at a rate [Hz]; return the record of the path (n,) [m] without the homing, and its error."""
    times = planned.time if planned.time is not None else np.zeros(1)
    # Rows of the homing are farther apart, and the last row is a sample.
    at = times[-1] - np.arange(round((times[-1] - times[0]) * rate), -1, -1) / rate
    excitation = Excitation("path", np.interp(at, times, planned.voltage), rate)
    with rig.safely(), run.watch() as watcher:
        watcher.step("path", excitation.duration)
        record = rig.play(excitation, watcher.samples)
        rig.retreat()
    rows = rig.rows(at.size) - (at.size - wanted.size)
    along = rows >= 0
    record = record[along]
    return record, TrackedPath(record.time, wanted[rows[along]], record.displacement, stroke)
