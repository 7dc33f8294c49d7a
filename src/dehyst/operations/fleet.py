"""`fleet identify` and `fleet report`: thousands of records identified at once, and what their table shows."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Any, Literal

from dehyst._errors import FileFormatError
from dehyst.fleet import Drifts, Fleet, FleetOptions, drifts_of, findings_of, identify_fleet, load
from dehyst.fleet.page import write_fleet_page
from dehyst.fleet.run import refuse_inside
from dehyst.fleet.task import COLUMNS
from dehyst.operations.declaration import Input, Only, Output, operation
from dehyst.operations.files import AS_FOUND, Columns
from dehyst.operations.run import Result, Run

_KEYS = ("time", "voltage", "displacement", "rate", "decimal")
_slip = Only(lambda given: given.get("structure") != "auto", "with --structure auto")


@operation(identify_fleet, name="fleet identify", rare=("elements", "norm", "delay", "drift"))
def identify(
    run: Run,
    dataset: Input,
    *,
    output: Output,
    by: str | None = None,
    structure: Literal["maxwell_slip", "auto"] = "maxwell_slip",
    elements: Annotated[int | None, _slip] = None,
    norm: Literal["l1", "l2"] = "l1",
    delay: float | None = None,
    drift: bool = True,
    prior: Annotated[Input | None, _slip] = None,
    jobs: int | None = None,
    dask: str | None = None,
    time_limit: float | None = None,
    resume: bool = False,
    columns: Columns = AS_FOUND,
) -> Result:
    """Identify every record of DATASET: a Parquet file (a record in each row group), a Zarr store or a folder.

    The table has one row for each record. Until it is written, the folder TABLE.parquet.parts holds a file for each
    finished record; --resume continues a stopped run. The exit status is 1 if a record was lost.

    Parameters
    ----------
    output
        Write the table here (.parquet).
    by
        Keys of a record, such as serial,session; default: its number or name.
    structure
        maxwell_slip: slip elements and a spring. auto: parts selected by cross-validation, much slower.
    elements
        Number of slip elements; default 20.
    norm
        Norm of the residuals.
    delay
        Lag of the displacements [s]; default: estimated.
    drift
        Whether the drift of a record is estimated and removed.
    resume
        Continue a stopped run; records that have changed are computed again.
    """
    columns.demand(_KEYS, "on a dataset")
    refuse_inside(dataset, output)
    chosen = {name: value for name in COLUMNS if (value := getattr(columns, name)) is not None}
    options = FleetOptions(structure=structure, elements=elements, norm=norm, delay=delay, drift=drift, columns=chosen)
    remarks: list[str] = []

    def remark(sentence: str) -> None:
        # At once: a run may take hours.
        remarks.append(sentence)
        run.note(sentence)

    keys = () if by is None else tuple(part.strip() for part in by.split(","))
    given: dict[str, Any] = {"prior": prior, "jobs": jobs, "dask": dask, "time_limit": time_limit, "resume": resume}
    try:
        done = identify_fleet(dataset, output, by=keys, options=options, **given, progress=run.progress, remark=remark)
    except (KeyboardInterrupt, SystemExit):
        run.note(f"stopped; what is done is in {output}.parts: give the same command with --resume to go on")
        raise
    tally = Counter(row["outcome"] for row in done.rows)
    seconds = float(sum(row["cpu_s"] or 0.0 for row in done.rows))
    fields = {"records": len(done), **tally, "output": str(output), "cpu_s": seconds, "remarks": remarks}
    lines = [
        f"{len(done)} records: {', '.join(f'{count} {outcome}' for outcome, count in tally.most_common())}",
        f"table: {output}",
    ]
    if tally["lost"]:
        lines.append("lost records are tried again by the same command with --resume")
    return Result(fields, [*lines, f"next: dehyst fleet report {output} -o fleet.html"], good=not tally["lost"])


@operation(name="fleet report")
def report(
    run: Run,
    table: Input,
    *,
    output: Output | None = None,
    threshold: float = 5.0,
    by: str = "serial",
    over: str = "session",
    goal: float = 1.0,
) -> Result:
    """Report ageing, outliers, refused records with reasons, duplicates and distributions of an identified fleet.

    Ageing is left out if the table has no sessions. The status is 1 if an actuator needs recalibration: the cost of its
    oldest model, its largest difference from the model of the last session, exceeds --goal, or the costs leave their
    control limits.

    Parameters
    ----------
    table
        Table of dehyst fleet identify.
    output
        Write a self-contained HTML page here.
    threshold
        Deviation from the fleet's median, in robust standard deviations, from which a record is listed.
    by
        Key that identifies an actuator.
    over
        Key that orders the sessions, oldest first: 2 is before 10.
    goal
        Cost [% of the stroke] above which an actuator needs recalibration in any case.
    """
    loaded = load(table)
    found = findings_of(loaded, threshold=threshold)
    drifts = _drifts(loaded, by, over, goal)
    if output is not None:
        write_fleet_page(output, found, drifts=drifts, command=run.command)
    written = [] if output is None else [f"page: {output}"]
    if drifts is None:
        return Result({**found.as_dict(), "drift": None}, [*found.lines(), *written])
    fields = {**found.as_dict(), "drift": drifts.as_dict()}
    lines = [*drifts.lines(), "", *found.lines(), *written]
    return Result(fields, lines, warnings=drifts.remarks, good=not drifts.recalibrate)


def _drifts(table: Fleet, by: str, over: str, goal: float) -> Drifts | None:
    """Return the costs of ageing; None if the table has no sessions and none were requested."""
    try:
        return drifts_of(table, by=by, over=over, goal=goal)
    except FileFormatError:
        if (by, over) != ("serial", "session"):
            raise
    return None
