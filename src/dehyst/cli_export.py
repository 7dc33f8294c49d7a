"""`dehyst export`: a model as C for a microcontroller."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dehyst.console import PATH, came_from, conclude, json_option, read_model, start_option, start_state

if TYPE_CHECKING:
    from dehyst.compensator import Compensator
    from dehyst.export import Exported


@click.command()
@click.argument("model", type=PATH)
@click.argument("directory", metavar="DIR", type=PATH)
@click.option("--number", type=click.Choice(["double", "float"]), default="double", show_default=True,
              help="double: the same bits as Python. float: for a processor that has no more.")  # fmt: skip
@click.option(
    "--limits", type=(float, float), metavar="LOW HIGH", help="Voltages allowed.  [default: those of the records]"
)
@click.option("--slew", type=float, metavar="V/S", help="Largest slew rate; needs --period.")
@click.option("--period", type=float, metavar="S", help="Seconds between steps; a model with time in it needs them.")
@click.option("--preview", is_flag=True, help="Make up for delay and inertia; displacements are then given ahead.")
@click.option("--force", is_flag=True, help="Replace an earlier export.")
@start_option
@json_option
def export(
    model: Path, directory: Path, number: Any, limits: tuple[float, float] | None, slew: float | None,
    period: float | None, preview: bool, force: bool, start: str, as_json: bool,
) -> None:  # fmt: skip
    """Write a MODEL's compensator as C into DIR: files, numbers, a README, and a trace that `make check` replays."""
    from dehyst.compensator import Compensator
    from dehyst.export import export as run

    actuator = read_model(model)
    state = start_state(actuator, start)
    compensator = Compensator(actuator, limits, slew, period=period, state=state, preview=preview)
    made = run(compensator, directory, number, force=force)
    said = _start_words(compensator)
    result = {"directory": str(directory), "number": number, "warnings": said, **_numbers(made)}
    line = f"{directory}: a compensator of {number}s {came_from(actuator, start)}\n{_table(made)}"
    conclude(as_json, result, line, said)


def _start_words(compensator: Compensator) -> list[str]:
    (low, high), present = compensator.limits, compensator.voltage
    if low <= present <= high:
        return []
    return [
        f"the state that it starts in is held by {present:.6g} V, outside the limits {low:.6g} to {high:.6g} V: choose "
        "another with --start"
    ]


def _numbers(made: Exported) -> dict[str, Any]:
    operations = made.operations
    return {
        "bytes": {name: one._asdict() for name, one in made.footprints.items()},
        "operations": {"arithmetic": operations.arithmetic, "divisions": operations.divisions,
                       "comparisons": operations.comparisons},
        "error_of_range": made.error,
    }  # fmt: skip


def _table(made: Exported) -> str:
    worst = made.operations
    rows = [f"{'bytes':<40}{'flash':>8}{'RAM':>8}{'stack':>8}"] if made.footprints else []
    rows += [
        f"{name:<40}{one.flash:>8}{one.ram:>8}{'-' if one.stack is None else one.stack:>8}"
        for name, one in made.footprints.items()
    ]
    rows.append(
        f"a step: at most {worst.arithmetic} additions, subtractions and multiplications, {worst.divisions} divisions, "
        f"{worst.comparisons} comparisons"
    )
    if made.error is not None:
        rows.append(f"floats: errors up to {made.error:.1e} of the range")
    return "\n".join(rows)
