"""Output of the commands: one line at a time, on streams that may be full or of a small character set."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from typing import Any

import click

from dehyst._text import escaped

INTERRUPTED = 130  # exit status after Ctrl-C
# Seconds between lines of progress where there is no terminal, and before the first one.
_FEW_SECONDS = 5.0


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
    """Return a function that shows progress: it overwrites a line on a terminal, elsewhere it prints some lines."""
    terminal, last = sys.stderr.isatty(), time.monotonic()

    def progress(words: str) -> None:
        nonlocal last
        if terminal:
            line = f"{escaped(words)}{' ...' if words else ''}"
            _write(f"\r\033[K{line[: shutil.get_terminal_size().columns - 1]}", err=True)
        elif words and time.monotonic() - last >= _FEW_SECONDS:
            last = time.monotonic()
            note(words)

    return progress


def _write(text: str, *, err: bool) -> None:
    """Write a text on a stream; messages beside the result may be lost."""
    try:
        click.echo(text, err=err, nl=False, color=True)
    except OSError:
        if not err:
            raise
        # The rest of the text is discarded, or the stream would fail at the end of the program.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())


@contextmanager
def guarded_streams() -> Iterator[None]:
    """Run a command so that an error of standard output ends with a message and status 1."""
    # A stream that was closed must not give its number to the next file.
    while os.open(os.devnull, os.O_RDWR) <= 2:
        pass
    sys.stdout, sys.stderr = (
        stream or os.fdopen(os.open(os.devnull, os.O_WRONLY), "w") for stream in (sys.stdout, sys.stderr)
    )
    for stream in (sys.stdout, sys.stderr):
        # Characters that a stream cannot encode are escaped.
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        yield
    except OSError as error:
        # An error of a file has its name; an error of a stream has none.
        if error.filename is not None:
            note(error)
            sys.exit(2)
        note(f"standard output cannot be written ({error.strerror}); make room, or send it elsewhere")
        # The rest of the text is discarded, so that the program ends quietly.
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
