"""Output of the commands: one line at a time, on streams that may be closed, full or of a small character set."""

from __future__ import annotations

import errno
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

import click

from dehyst._io import finite
from dehyst._text import escaped

if TYPE_CHECKING:
    from dehyst._errors import DehystError

# Seconds between lines of progress where there is no terminal, and before the first one; and their name.
_FEW_SECONDS, _SECONDS_NAME = 5.0, "DEHYST_PROGRESS_SECONDS"

# Arguments that a parameter of another name sets, in all commands and in one.
_RENAMED = {"slew_rate": "slew", "seconds": "edge", "base": "present"}
_RENAMED_IN = {"compensate": {"cycles": "start_up"}}
# Arguments that hold data; the option of the same name says which column or file has them.
_DATA = frozenset({"time", "voltage", "displacement", "model", "records", "trajectory", "report", "output"})


class UnprintedError(Exception):
    """Standard output cannot be written."""


def echo(line: object = "", *, err: bool = False) -> None:
    """Print one line on standard output or standard error; what would end or change a line is escaped."""
    _write(f"{escaped(line)}\n", err=err)


def echo_json(value: Any) -> None:
    """Print JSON values, with null for numbers that are not finite."""
    _write(f"{json.dumps(finite(value), indent=1)}\n", err=False)


def note(sentence: object) -> None:
    """Print a warning or an error on standard error."""
    echo(f"dehyst: {sentence}", err=True)


def options_of(command: Any) -> dict[str, click.Parameter]:
    """Return the options of a click command, or of all commands of a group, by the argument that each sets."""
    options: dict[str, click.Parameter] = {}
    for inner in getattr(command, "commands", {}).values():
        options |= options_of(inner)
    options |= {str(parameter.name): parameter for parameter in command.params}
    renamed = {argument: name for argument, name in _RENAMED.items() if argument not in options and name in options}
    renamed |= _RENAMED_IN.get(str(command.name), {})
    return options | {argument: options[name] for argument, name in renamed.items()}


def flag_of(parameter: click.Parameter) -> str:
    """Return the name of an option, or of an argument of the command line."""
    return next((flag for flag in parameter.opts if flag.startswith("--")), parameter.human_readable_name)


def error_text(error: DehystError, command: Any) -> str:
    """Return the message of an error with the options of a command in the place of the library's arguments."""
    options = options_of(command)

    def named(argument: str) -> str:
        return flag_of(options[argument]) if argument in options and argument not in _DATA else argument

    def given(argument: str) -> str:
        option = options.get(argument)
        value = "" if option is None or getattr(option, "is_flag", False) else f" {option.metavar or ''}"
        return f"{flag_of(option)}{value}".rstrip() if option is not None else ""

    return error.text(named, given)


def progress_line() -> Callable[[str], None]:
    """Return a function that shows progress: it overwrites one line on a terminal, elsewhere it prints one at times."""
    if not sys.stderr.isatty():
        return _every_few_seconds()

    def progress(words: str) -> None:
        line = f"{escaped(words)}{' ...' if words else ''}"
        _write(f"\r\033[K{_fitted(line, shutil.get_terminal_size().columns - 1)}", err=True)

    return progress


def _every_few_seconds() -> Callable[[str], None]:
    """Return a function that prints what it is given if its last line is some seconds old."""
    last, pause = time.monotonic(), _pause()

    def progress(words: str) -> None:
        nonlocal last
        if words and time.monotonic() - last >= pause:
            last = time.monotonic()
            note(words)

    return progress


def _pause() -> float:
    """Return the seconds between two lines; a program that shows them sets fewer in the environment."""
    with suppress(ValueError):
        return float(os.environ.get(_SECONDS_NAME, ""))
    return _FEW_SECONDS


def _fitted(line: str, width: int) -> str:
    """Return a line without its middle if it is wider than a terminal, which cannot overwrite two lines."""
    if len(line) <= width:
        return line
    half = max((width - 5) // 2, 0)
    return f"{line[:half]} ... {line[len(line) - half :]}"


def _write(text: str, *, err: bool) -> None:
    try:
        click.echo(text, file=sys.stderr if err else sys.stdout, nl=False, color=True)
    except OSError as error:
        # Messages beside the result may be lost; click exits quietly when the reader of a pipe has gone.
        if err:
            _silence(sys.stderr)
        elif error.errno == errno.EPIPE:
            raise
        else:
            raise UnprintedError(error.strerror) from error


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Run a command so that a closed or full standard stream ends with a message and status 1."""
    _prepare()
    try:
        try:
            yield
        finally:
            # A stream without a reader shall not change the status when the program ends.
            _flush(sys.stderr)
            sys.stdout.flush()
    except UnprintedError as error:
        sys.exit(_unprinted(error))
    except OSError as error:
        # An error of a file has its name; an error of a stream, such as click's own when it prints a help, has none.
        if error.filename is None:
            sys.exit(_unprinted(error.strerror))
        note(error)
        sys.exit(2)


def _flush(stream: TextIO) -> None:
    """Flush a stream, or discard what it holds."""
    try:
        stream.flush()
    except OSError:
        _silence(stream)


def _unprinted(why: object) -> int:
    _silence(sys.stdout)
    note(f"standard output cannot be written ({why}); make room, or send it elsewhere")
    return 1


def _prepare() -> None:
    """Open closed streams, so that the next file does not take their number; escape what a stream cannot encode."""
    for number in range(3):
        with suppress(OSError):
            os.fstat(number)
            continue
        # Standard output that was closed stays an error where something is printed.
        os.open(os.devnull, os.O_WRONLY if number == 2 else os.O_RDONLY)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if (reconfigure := getattr(stream, "reconfigure", None)) is not None:
            reconfigure(errors="backslashreplace")


def _silence(stream: TextIO) -> None:
    """Discard what a stream still holds, so that the program ends quietly."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)
