"""`update`: a model updated from one new record."""

from __future__ import annotations

from collections.abc import Iterator

from dehyst.operations.axes import AxesModel
from dehyst.operations.declaration import Input, Output, operation
from dehyst.operations.files import AS_FOUND, RECORD, Columns
from dehyst.operations.run import Result, Run, files
from dehyst.records import read
from dehyst.trust import Update
from dehyst.trust import update as update_one


@operation(update_one)
def update(
    run: Run,
    model: Input,
    record: Input,
    *,
    output: Output,
    goal: float | None = None,
    columns: Columns = AS_FOUND,
) -> Result:
    """Update a MODEL from a new RECORD of its actuator, even of a single loop, and report what has changed.

    If no updated model predicts the record better, the output is the old model; a record on which it does not keep its
    promise widens it. A record that clearly belongs to another actuator is refused. The coupling of several axes is
    checked, not changed. The status is 0 if the error on held-out parts and the promise are within the goal, else 1.

    Parameters
    ----------
    output
        Write the new model here (JSON).
    goal
        Largest error allowed [% of the stroke]; default: the model's, or 1.
    """
    known = AxesModel.read(run, model)
    known.demand(columns, RECORD, "on a record")
    measured = read(record, known.of_records(columns))
    coupling: tuple[str, ...] = ()
    if known.stage is None:
        found = update_one(known.actuators[0], measured, goal=goal)
        found.actuator.save(output)
        fields, updates, good = found.as_dict(), [found], found.good
    else:
        stage = update_one(known.stage, measured, goal=goal)
        stage.stage.save(output)
        fields, updates, good = stage.as_dict(), [*stage.updates], stage.good
        coupling = stage.coupling_changes
    lines = known.prefixed(_lines(one) for one in updates)
    lines += files(Model=output)
    return Result({**fields, "output": str(output)}, lines, warnings=coupling, good=good)


def _lines(update: Update) -> Iterator[str]:
    """Yield the result, the promise, and the changes."""
    yield update.sentence
    if update.promise is not None:
        yield from update.promise.lines
    yield from update.sentences()
    yield from (f"  - {remark}" for remark in update.recheck.remarks)
