"""`dehyst simulate`: the displacement that a voltage causes."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst._text import counted
from dehyst.cli.common import (
    PATH,
    conclude,
    force_option,
    json_option,
    read_model,
    refuse_overwriting,
    refuse_replacing,
    write_output,
)
from dehyst.cli.record_files import column_of, columns_options, table_of, time_of_table
from dehyst.cli.start import (
    error_line,
    given_start,
    home_option,
    homed_words,
    lagging,
    outside_warnings,
    start_dict,
    start_option,
    start_words,
)

if TYPE_CHECKING:
    from dehyst.control import HomedPath, PossibleStart, StartError
    from dehyst.model import Actuator


@click.command()
@click.argument("model", type=PATH)
@click.argument("voltage_file", metavar="VOLTAGE", type=PATH)
@click.option("-o", "--output", type=PATH, required=True, help="Write time, voltage and displacement here (CSV).")
@click.option("--lag", is_flag=True, help="Delay the displacement by the delay found at identification.")
@force_option
@start_option
@home_option("Put the shortest homing before the voltages, from 0 V.  [default: no-home]")
@columns_options
@json_option
def simulate(
    model: Path,
    voltage_file: Path,
    output: Path,
    lag: bool,
    start: str | Path | None,
    home: bool | None,
    as_json: bool,
    **columns: Any,
) -> None:
    """Compute the displacement that a VOLTAGE file causes; adds displacement_um.

    Without --start the state before the first sample is unknown: the displacement is that from the middle of the
    possible states, and lowest_um and highest_um bound it. The status is 1 if a voltage lies outside the model's
    limits by more than a tenth of their range, or if --home leaves more than the model's error.
    """
    from dehyst._errors import ModelError

    if home and start is not None:
        raise ModelError("--start: got it with --home, which determines the state; leave one out")
    refuse_overwriting([model, voltage_file, *([start] if isinstance(start, Path) else [])], output)
    actuator = read_model(model)
    table = table_of(voltage_file, columns)
    voltage = column_of(table, "voltage", columns)
    time = time_of_table(table, voltage.size, columns)
    given, remarks = (None, []) if start is None else given_start(actuator, start, None, columns["max_bytes"])
    run = _homed(actuator, voltage, time) if home else _run(actuator, voltage, time, given)
    written = {"displacement_um": run.displacement}
    if run.error is not None and run.homed is None:
        written |= {"lowest_um": run.error.lowest, "highest_um": run.error.highest}
    if lag:
        written = {name: lagging(values, actuator, run.time) for name, values in written.items()}
    refuse_replacing(output)
    micro = {name: values * 1e6 for name, values in written.items()}
    write_output(output, {**run.time, **run.phase, "voltage_V": run.voltage, **micro})
    outside, far, warnings = outside_warnings(actuator, voltage)
    warnings += [*remarks, *run.warnings]
    if actuator.delay and not lag:
        warnings.append(
            f"the measured displacement lagged by {actuator.delay * 1e3:.4g} ms, which is left out here; add --lag"
        )
    result = {
        "samples": run.voltage.size,
        "outside": outside,
        "far_outside": far,
        **start_dict(run.start.name, run.error, run.homed),
        "warnings": warnings,
        "state": run.state.as_dict(),
        "output": str(output),
    }
    lines = [f"{counted(run.voltage.size, 'sample')} {run.words}: {output}"]
    if run.error is not None:
        lines.append(error_line(run.start.name, run.error, homed=run.homed is not None))
    conclude(as_json, result, lines, warnings)
    sys.exit(1 if far or not run.known else 0)


@dataclass(frozen=True, eq=False)
class _Run:
    """A simulation: its columns, and what is known of its start."""

    time: dict[str, Any]
    voltage: Any
    displacement: Any
    state: Any
    start: PossibleStart
    words: str
    error: StartError | None
    homed: HomedPath | None = None
    warnings: tuple[str, ...] = ()

    @property
    def phase(self) -> dict[str, Any]:
        return {} if self.homed is None else {"phase": self.homed.phase}

    @property
    def known(self) -> bool:
        """Whether the homing, if there is one, does what it is for."""
        return self.homed is None or self.homed.certified


def _run(actuator: Actuator, voltage: Any, time: dict[str, Any], given: PossibleStart | None) -> _Run:
    """Simulate from the start that was given, or from the middle of the possible ones."""
    from dehyst.control import PossibleStart, StartError

    first = float(voltage[0]) if voltage.size else 0.0
    start = PossibleStart.unknown(actuator, first) if given is None else given
    when = time.get("time_s")
    clock = when if actuator.needs_time else None
    motion = actuator.simulate(voltage, time=clock, state=start.state, extrapolate=True)
    error = None if start.known else StartError.along(actuator, start.states, voltage, time=when)
    words = start_words(actuator, start, start.state)
    return _Run(time, voltage, motion.displacement, motion.state, start, words, error)


def _homed(actuator: Actuator, voltage: Any, time: dict[str, Any]) -> _Run:
    """Simulate a homing, and the voltages after it."""
    from dehyst.control import Compensator, home_before_voltage

    compensator = Compensator(actuator, actuator.voltage_range)
    homed = home_before_voltage(compensator, voltage, time=time.get("time_s"))
    when = {} if homed.time is None else {"time_s": homed.time}
    return _Run(
        when,
        homed.voltage,
        homed.displacement,
        homed.state,
        homed.start,
        homed_words(homed),
        homed.error,
        homed,
        homed.warnings,
    )
