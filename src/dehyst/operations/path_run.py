"""`run`: a path followed on an instrument, with a model that may adapt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from tempfile import gettempdir
from typing import Annotated, Any

import numpy as np

import dehyst._validation as check
from dehyst._errors import FileFormatError, ModelError, RecordError
from dehyst._types import Array
from dehyst.adaptation import AdaptiveCompensator
from dehyst.calibration.path_run import REPETITION, WANTED, PathRun, Repetition
from dehyst.calibration.plan import even_rate
from dehyst.control import VoltageLimits
from dehyst.instruments import open_rig
from dehyst.model import Actuator
from dehyst.operations.axes import AxesModel, Slew, is_stage
from dehyst.operations.declaration import Input, Output, beside, operation
from dehyst.operations.files import AS_FOUND, PATH, Columns, write_table
from dehyst.operations.paths import PathSlew, Zero, bounds_remarks, reach_remarks, temperature_of, zero_of_path
from dehyst.operations.run import Result, Run, files
from dehyst.records import Column, Recording, largest, percent, rms, salvage, unused_path
from dehyst.records.files import demand_text
from dehyst.records.record import Channel
from dehyst.trust import Judgement

# Repetitions that are printed: the first, the last, and some between them.
_PRINTED = 12
# Error [%] above which the model is of another actuator; part of the stroke from which on an offset is mentioned.
_FOREIGN, _OFFSET = 50.0, 0.005
# Part by which a rate may differ without a remark; ratio to the promise from which on a larger one is printed.
_RATES, _MORE = 0.01, 1.25
_adapting = beside("adapt")


@operation(AdaptiveCompensator, name="run", rare=("memory", "zero_drifts"), details=True)
def run_path(
    run: Run,
    rig: str,
    *,
    model: Input,
    path: Input,
    cycles: int = 10,
    adapt: bool = False,
    output: Output | None = None,
    updated: Annotated[Output | None, _adapting] = None,
    memory: Annotated[float, _adapting] = 10.0,
    zero_drifts: Annotated[bool, _adapting] = True,
    limits: tuple[float, float] | None = None,
    slew_rate: float | None = None,
    zero: Zero | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Follow a path on RIG again and again, and measure the error; with --adapt the model is kept true.

    RIG: as of dehyst calibrate, with one axis. A homing comes first. Each repetition is played as a whole, and the
    weights adapt between two repetitions. The voltage ends at the safe one; Ctrl-C brings it there too. The status is 1
    if a voltage of the last repetition was clamped.

    Parameters
    ----------
    model
        The model (JSON) of one axis.
    path
        A file with times and a displacement, or the path of dehyst scan. If it does not end where it begins, a way back
        follows. A column temperature_C counts if the model depends on temperature and the rig measures none.
    cycles
        Repetitions of the path.
    adapt
        Adapt the model to the rig's sensor after each repetition.
    output
        Write the record of all repetitions here (CSV): with the wanted displacement, and the number of the repetition.
        A repetition that is cut short is in it too. While it is played, each sample is in a file beside it at once.
    updated
        Write the adapted model here (JSON).
    limits
        Range of the voltage [V]; default: that of the model and the device.
    slew_rate
        Largest slew rate [V/s]; default: the device's, or the whole range in 0.1 s.
    zero
        Zero of the path, as of dehyst compensate.
    """
    columns.demand(PATH, "on a path")
    check.between(cycles, "cycles", 1, 1_000_000)
    if output is not None:
        demand_text(output)
    if is_stage(model):
        raise ModelError(argument="model", got="one of several axes", need="one of a single axis")
    known = AxesModel.read(run, model)
    (actuator,) = known.actuators
    wanted, rate, given = _read(run, path, known, columns)
    done: list[dict[str, Any]] = []
    last: Repetition | None = None
    with run.held or open_rig(rig, limits=limits, slew_rate=slew_rate) as instrument:
        allowed = instrument.limits.low, instrument.limits.high
        wanted = wanted + zero_of_path(actuator, allowed, zero)
        # Refused in micrometres here; the library's refusal would be in metres.
        reach_remarks(actuator, wanted, actuator.voltage_range, zero, given)
        options: dict[str, Any] = {"adapt": adapt, "memory": memory, "zero_drifts": zero_drifts}
        follower = PathRun(instrument, actuator, wanted, rate, temperature=given, **options)
        if abs(follower.rate / rate - 1) > _RATES:
            run.note(f"the path has {rate:.6g} Hz, and is played at {follower.rate:.6g} Hz, as {instrument.name} can")
        bounds = VoltageLimits(*follower.limits, instrument.slew_rate)
        asked = None if slew_rate is None else Slew("", slew_rate)
        remarks = bounds_remarks(limits, asked, bounds, "device and model allow no more")
        slew = PathSlew(bounds.slew_rate, "option", actuator.recorded_slew_rate)
        if slew_rate is not None or slew.times > 1:
            remarks.append(slew.words)
        warmth = None if follower.measures_temperature else given
        for remark in [*remarks, *reach_remarks(actuator, wanted, follower.limits, zero, warmth)]:
            run.note(remark)
        if given is not None and follower.measures_temperature:
            run.note(f"{instrument.name} measures the temperature: that of the path is not used")
        promises = _Promises(run, follower)
        recording = None if output is None else _recording(run, follower, output, cycles)

        def write() -> Iterator[str]:
            yield from _record(recording, output)
            if updated is not None and last is not None:
                _judged(follower.actuator, last, adapted=_used(done) > 0).save(updated)
                yield from files(Model=updated)

        with _written(recording, write) as ends:
            steps = ["homing", *(f"repetition {k}" for k in range(1, cycles + 1))]
            with instrument.safely(), run.watch(steps) as watcher:
                for last in follower.play(cycles, watcher, promises.update, recording):
                    done.append(_fields(last))
                    run.known = {**promises.fields, "cycles": done}
                    _demand_same_actuator(last, len(done))
    assert last is not None
    fields = {
        "rig": instrument.identity,
        "limits_V": list(follower.limits),
        "slew_V_per_s": bounds.slew_rate,
        "stroke_um": 1e6 * follower.stroke,
        **promises.fields,
        "cycles": done,
        "exchanges": _used(done),
    }
    rows = [_line(number, one) for number, one in enumerate(done, 1)]
    picked = np.unique(np.linspace(0, len(rows) - 1, _PRINTED).astype(int)).tolist()
    head = [_head(done[-1], follower.stroke), *(_offset(last, follower.stroke) if zero_drifts else [])]
    return Result(
        fields,
        [*head, *(rows[k] for k in picked), *ends],
        [*head, *(f"{row}  {one.get('reason', '')}" for row, one in zip(rows, done, strict=True)), *ends],
        good=not last.clamped,
    )


def _read(run: Run, path: Path, known: AxesModel, columns: Columns) -> tuple[Array, float, float | Array | None]:
    """Return the displacement (n,) [m] in a file, its rate [Hz], and its temperature (n,) [degC] if that counts."""
    table = columns.table(path)
    wanted, clock = columns.values(table, "displacement"), columns.clock(table, len(table.columns[0].data))
    if not clock:
        raise RecordError(argument="path", got="no times", need="a time of each sample", hint="--columns rate=HERTZ")
    warmth = temperature_of(known, None, columns, table, len(wanted), remark=run.note)
    return wanted, even_rate(path, clock["time_s"]), warmth


class _Promises:
    """The promises of a run: one before anything moves, and a later one if the rig shows that more is to be expected.

    `fields`: as JSON values.
    """

    def __init__(self, run: Run, follower: PathRun) -> None:
        self._run, self._stroke, self._printed = run, follower.stroke, follower.judged()
        lines = [*self._printed.lines(self._stroke), *self._printed.untested]
        self.fields: dict[str, Any] = {"judgement": self._printed.as_dict(), "promise": lines}
        run.known = self.fields
        for line in lines:
            run.say(line)

    def update(self, now: Judgement) -> None:
        """Print the errors to expect on the next repetition, if they are larger than those that were printed."""
        if now.bounds is None or self._printed.bounds is None or now.bounds[1] <= _MORE * self._printed.bounds[1]:
            return
        self._printed = now
        new = [*(f"From now on {line}." for line in now.lines(self._stroke)), *now.untested]
        lines = [line for line in new if line not in self.fields["promise"]]
        self.fields["promise"] += lines
        for line in lines:
            self._run.say(line)


def _demand_same_actuator(last: Repetition, number: int) -> None:
    """Raise `ModelError` if a repetition missed the path by so much that the model cannot be of this actuator."""
    missed = last.path.largest_percent
    # A clamped voltage explains any error.
    if missed > _FOREIGN and not last.clamped:
        raise ModelError(
            argument="model",
            got=f"an error of {missed:.3g} % of the stroke in repetition {number}",
            need="a model of this actuator, whose zero is that of the sensor",
            hint="check the unit of the path, the zero, and that the model is of this rig",
        )


def _head(last: dict[str, Any], stroke: float) -> str:
    """Return a line on the last repetition."""
    words = f"The last repetition: {_errors(last)} of the stroke of {1e6 * stroke:.4g} um"
    if last["promised_percent"] is not None:
        words += f", {last['promised_percent']:.2g} % was to be expected"
    if last["clamped"]:
        words += f"; {last['clamped']} samples were clamped at a limit or by the slew rate"
    return words


def _offset(last: Repetition, stroke: float) -> list[str]:
    """Return a line on an offset that is not corrected, if there is one."""
    if last.drift is None or abs(last.drift.offset) < _OFFSET * stroke:
        return []
    return [
        f"Attributed to the sensor's zero, and not corrected: {1e6 * last.drift.offset:+.4f} um. If that zero has not "
        "moved: --options '{\"zero_drifts\": false}'"
    ]


def _recording(run: Run, follower: PathRun, output: Path, cycles: int) -> Recording:
    """Begin the recording from which the output is written at the end; make files of what killed processes left."""
    # There is no room beside a device or a pipe.
    folder = output.parent if output.is_file() or not output.exists() else Path(gettempdir())
    for left in salvage(folder):
        run.note(f"{left}: holds the samples of a recording whose process was killed")
    return follower.recording(unused_path(folder / f"{output.stem}.h5"), cycles)


@contextmanager
def _written(recording: Recording | None, write: Callable[[], Iterator[str]]) -> Iterator[list[str]]:
    """Write the files at the end, also after an error, to which it adds where they are; yield the lines of `write`.

    If the output cannot be written, the samples stay in the file of the recording, or in its journal.
    """
    lines: list[str] = []
    try:
        with recording or nullcontext():
            try:
                yield lines
            except BaseException as error:
                try:
                    for line in write():
                        error.add_note(f"{line}, until then")
                except FileFormatError as failure:
                    error.add_note(str(failure))
                raise
            lines += write()
    except BaseException as error:
        if recording is not None and recording.path.exists():
            error.add_note(f"Record: {recording.path}, until then")
        raise


def _record(recording: Recording | None, output: Path | None) -> Iterator[str]:
    """Write all repetitions, or the homing if it did not end; yield a line with the file."""
    if recording is None or output is None:
        return
    if recording.samples:
        columns = recording.columns
        number = columns[REPETITION]
        rows = number > 0 if number.any() else np.ones(number.size, dtype=bool)
        others = [Channel.of(Column(name, columns[name])) for name in recording.others]
        table = {
            "time_s": columns["time_s"],
            "voltage_V": columns["voltage_V"],
            "displacement_um": 1e6 * columns["displacement_m"],
            "wanted_um": 1e6 * columns[WANTED],
            **{one.column: one.values for one in others if one.column not in (WANTED, REPETITION)},
            "repetition": number,
        }
        write_table(output, {name: values[rows] for name, values in table.items()})
        yield from files(Record=output)
    recording.discard()


def _judged(actuator: Actuator, last: Repetition, *, adapted: bool) -> Actuator:
    """Return an adapted model with the errors of the last repetition in its promise."""
    known = actuator.identification
    if known is None or known.validity is None or not adapted:
        return actuator
    errors = {"rms": rms(last.path.error), "largest": largest(last.path.error)}
    validity = known.validity.with_record(last.record, **errors)
    return actuator.with_validity(validity, errors["largest"])


def _used(done: list[dict[str, Any]]) -> int:
    """Return after how many repetitions new weights were used."""
    return sum(one.get("used", False) for one in done)


def _errors(one: dict[str, Any]) -> str:
    return f"largest {one['largest_percent']:6.3f} %, RMS {one['rms_percent']:6.3f} %"


def _line(number: int, one: dict[str, Any]) -> str:
    words = f"  {number:4d}  {_errors(one)}"
    if "gain_percent" in one:
        words += (
            f"; gain {one['gain_percent']:+.2f} %, width {one['width_percent']:+.2f} %, "
            f"offset {one['offset_um']:+.4f} um"
        )
    return words


def _fields(one: Repetition) -> dict[str, Any]:
    promised = None if one.promised.bounds is None else percent(one.promised.bounds[1], one.path.stroke)
    found = {**one.path.as_dict(), "promised_percent": promised, "clamped": one.clamped}
    if one.drift is None:
        return found
    return found | {
        "gain_percent": 100 * one.drift.gain,
        "width_percent": 100 * one.drift.width,
        "offset_um": 1e6 * one.drift.offset,
        "used": one.used,
        "reason": one.reason,
    }
