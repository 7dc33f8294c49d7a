"""A run of an operation: its progress reports, its result, and the protection of files that exist."""

from __future__ import annotations

import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click

from dehyst._errors import FileFormatError, Terminated
from dehyst._io import demand_own_folder, draft_of, unwritten
from dehyst.operations.command import HOUSE, OperationError, Role, command_of, given_in, paths_in

# Formats of models, of one axis and several.
MODELS = ("dehyst-actuator", "dehyst-stage")


class Run:
    """Receiver of an operation's reports: silent here; subclasses print them to a terminal or send them from a worker.

    Attributes
    ----------
    command : str
        The equivalent command, for reports.
    force : bool
        Whether outputs may replace files.
    known : dict
        JSON values that are known before the end, also if the operation fails.
    remarks : list of str
        Remarks on the result, which are shown after it, also if the operation fails.
    """

    def __init__(self) -> None:
        self.command, self.force = "", False
        self.known: dict[str, Any] = {}
        self.remarks: list[str] = []

    def progress(self, words: str) -> None:
        """Show the present activity; an empty text ends this."""

    def note(self, sentence: object) -> None:
        """Report a warning at once."""

    def say(self, line: object) -> None:
        """Report a line of the result at once."""

    @contextmanager
    def ended_by(self, end: Callable[[], object]) -> Iterator[None]:
        """Let the first SIGINT end the operation early, and the second one interrupt it."""

        def interrupt(*_: object) -> None:
            signal.signal(signal.SIGINT, signal.default_int_handler)
            self.ending()
            end()

        before = signal.getsignal(signal.SIGINT)
        # A program in the background ignores Ctrl-C.
        handles = threading.current_thread() is threading.main_thread() and before is signal.default_int_handler
        if handles:
            signal.signal(signal.SIGINT, interrupt)
        try:
            yield
        finally:
            if handles:
                signal.signal(signal.SIGINT, before)

    def ending(self) -> None:
        """Report that the operation ends early; called in a signal handler."""


@contextmanager
def terminable() -> Iterator[None]:
    """Treat SIGTERM as an error, so that drafts and temporary folders are removed."""

    def leave(number: int, _: object) -> None:
        raise Terminated(128 + number)

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@dataclass(frozen=True)
class Result:
    """The result of an operation.

    Attributes
    ----------
    fields : dict
        JSON values.
    lines : sequence of str
        Lines for a person, the answer first.
    more : sequence of str
        The lines with all details; by default `lines`.
    good : bool
        False: done, but not good enough, for a reason in `lines`.
    """

    fields: Mapping[str, Any]
    lines: Sequence[str] = ()
    more: Sequence[str] = ()
    good: bool = True


def perform(ctx: click.Context, run: Run) -> Result:
    """Run the operation of a command with the values in its context.

    Raise `DehystError` if a parameter has no effect, or if an output is an input, exists or cannot be written: no
    result is lost because it has no place. The operation may raise too.
    """
    given, values = given_in(ctx), {name: value for name, value in ctx.params.items() if name not in HOUSE}
    run.command, run.force = command_of(ctx), bool(ctx.params.get("force"))
    for parameter in ctx.command.params:
        conditions = getattr(parameter, "conditions", ()) if parameter.name in given else ()
        for why in filter(None, (condition(given) for condition in conditions)):
            raise OperationError(f"has no effect {why}", argument=parameter.name, hint="leave it out")
    outputs = list(paths_in(ctx, Role.OUTPUT))
    folders = list(paths_in(ctx, Role.FOLDER))
    continued = list(paths_in(ctx, Role.CONTINUED))
    if run.force and not outputs and not folders and not continued:
        raise OperationError("has no effect without an output", argument="force", hint="leave it out")
    demand_outputs(paths_in(ctx, Role.INPUT), outputs, () if "dry_run" in given else continued, force=run.force)
    for folder in folders:
        if folder.is_dir():
            demand_own_folder(folder, "", "", force=run.force)
        demand_writable(folder)
    assert ctx.command.callback is not None
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = lambda message, *_, **__: run.remarks.append(str(message))
        result: Result = ctx.command.callback(run, **values)
    written = (each.name for each in ctx.command.params if getattr(each.type, "role", Role.INPUT) is not Role.INPUT)
    made = {str(name): str(values[name]) for name in written if values.get(name) is not None}
    # Some results have warnings of their own.
    remarks = dict.fromkeys([*result.fields.get("warnings", ()), *run.remarks])
    return replace(result, fields={**made, **result.fields, "warnings": [*remarks]})


def demand_outputs(inputs: Iterable[Path], outputs: Sequence[Path], kept: Sequence[Path] = (), *, force: bool) -> None:
    """Raise `FileFormatError` for outputs that are inputs, share a name, lack a folder, or exist without `force`.

    `kept`: outputs that the command continues.
    """
    if len({os.path.realpath(output) for output in outputs}) < len(outputs):
        raise FileFormatError(f"{outputs[0]}: is the name of two outputs; give each its own name")
    before = {os.path.realpath(path) for path in inputs}
    for output in (*outputs, *kept):
        if str(output) == "-":
            raise FileFormatError("-: is no name of a file, and standard output holds the summary; name a file")
        if os.path.realpath(output) in before:
            raise FileFormatError(f"{output}: is also an input of this command; give another name for the output")
        demand_writable(output)
        if output in kept:
            continue
        if os.path.isdir(output):  # noqa: PTH112 (Path.is_dir raises an error for a name that is too long)
            raise FileFormatError(f"{output}: is a folder; give the name of a file in it")
        if not Path(os.path.realpath(output)).parent.is_dir():
            raise FileFormatError(f"{output}: the folder {output.parent} does not exist; create it first")
        if os.path.isfile(output) and not force:  # noqa: PTH113
            raise FileFormatError(f"{output}: is there already; give another name, or --force to replace it")


def demand_writable(path: Path) -> None:
    """Raise `FileFormatError` unless a file can be made at a path, or in the nearest folder above that exists."""
    place = Path(os.path.realpath(path))
    try:
        # A device such as /dev/null, and a pipe, are written to.
        if place.exists() and not place.is_dir() and not place.is_file():
            return
        while not place.is_dir():
            place = place.parent
        draft = draft_of(place / "draft")
        draft.touch(exist_ok=False)
        draft.unlink()
    except OSError as error:
        raise unwritten(path, error) from error


def files(**paths: Path | None) -> list[str]:
    """Return a line for each file that was written, with its name."""
    return [f"{name}: {path}" for name, path in paths.items() if path is not None]
