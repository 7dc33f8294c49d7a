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
from typing import Any, TextIO

import click

from dehyst._text import escaped

INTERRUPTED = 130  # exit status after Ctrl-C
# Seconds between lines of progress where there is no terminal, and before the first one.
_FEW_SECONDS = 5.0


class UnprintedError(Exception):
    """Standard output cannot be written."""


def echo(line: object = "", *, err: bool = False) -> None:
    """Print one line on standard output or standard error; control characters are escaped."""
    _write(f"{escaped(line)}\n", err=err)


def echo_json(value: Any) -> None:
    """Print JSON values, with null for numbers that are not finite."""
    from dehyst._io import finite

    _write(f"{json.dumps(finite(value), indent=1)}\n", err=False)


def note(sentence: object) -> None:
    """Print a warning or an error on standard error."""
    echo(f"dehyst: {sentence}", err=True)


def progress_line() -> Callable[[str], None]:
    """Return a function that shows progress: it overwrites one line on a terminal, elsewhere it prints one at times."""
    if not sys.stderr.isatty():
        return _every_few_seconds()

    def progress(words: str) -> None:
        line = f"{escaped(words)}{' ...' if words else ''}"
        _write(f"\r\033[K{line[: shutil.get_terminal_size().columns - 1]}", err=True)

    return progress


def _every_few_seconds() -> Callable[[str], None]:
    """Return a function that prints what it is given if its last line is some seconds old."""
    last = time.monotonic()

    def progress(words: str) -> None:
        nonlocal last
        if words and time.monotonic() - last >= _FEW_SECONDS:
            last = time.monotonic()
            note(words)

    return progress


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
