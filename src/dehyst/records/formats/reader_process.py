"""The readable formats: for each suffix the function that reads columns from bytes, and the library it needs."""

from __future__ import annotations

import atexit
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from math import ceil
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np

from dehyst import _errors
from dehyst._errors import DehystError, FileFormatError
from dehyst.records import hdf5
from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.containers import (
    in_first_line,
    is_hdf5,
    read_hdf5,
    read_mat,
    read_npy,
    read_npz,
    read_parquet,
    read_tdms,
    restored,
)
from dehyst.records.formats.file_content import Allowance, Content, as_utf8, library
from dehyst.records.formats.text_table import read_text
from dehyst.records.formats.vendor_files import is_gcs, is_labview, read_gcs, read_labview, read_xlsx
from dehyst.records.hdf5 import Stored

_NAMES = {".parquet": "Parquet", ".tdms": "TDMS"}


class Format(NamedTuple):
    """A readable format.

    `load`: function of the bytes and their allowance that returns columns. `library`: module of an optional package
    that it needs; empty without one. `isolated`: whether it runs in a separate process, because a damaged file may
    crash or stop its C library.
    """

    load: Callable[[bytes, Allowance], list[Column]]
    library: str = ""
    isolated: bool = False


def _read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    data = as_utf8(data)
    if is_labview(data):
        return read_labview(data, allowance)
    columns = read_gcs(data, allowance) if is_gcs(data) else read_text(data, allowance)
    return restored(columns, in_first_line(data))


LOADERS: dict[str, Format] = {
    **dict.fromkeys((*TEXT, ".lvm", ".asc"), Format(_read_text)),
    ".xlsx": Format(read_xlsx, "openpyxl", isolated=True),
    ".mat": Format(read_mat, "scipy.io", isolated=True),
    ".h5": Format(read_hdf5, "h5py", isolated=True),
    ".hdf5": Format(read_hdf5, "h5py", isolated=True),
    ".parquet": Format(read_parquet, "pyarrow.parquet", isolated=True),
    ".tdms": Format(read_tdms, "nptdms", isolated=True),
    ".npy": Format(read_npy),
    ".npz": Format(read_npz),
}


def package(content: Content) -> tuple[str, str]:
    """Return the module that reads a file, and its purpose; MAT files of version 7.3 are HDF5."""
    module = "h5py" if content.suffix == ".mat" and is_hdf5(content.data) else LOADERS[content.suffix].library
    return module, f"Reading {_NAMES.get(content.suffix, content.suffix)} files"


# CPU time for a file [s], and the bytes that add another second.
_SECONDS, _A_SECOND = 5, 5_000_000
# Memory of the libraries beside twice the numbers of a file [bytes].
_BESIDE = 256_000_000
# Exit status of the helper after a signal ended a child: this plus the signal's number.
_SIGNAL = 64
_START = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); "
    "from dehyst.records.formats import reader_process as r; r.serve()"
)


class Loaded(NamedTuple):
    """Columns of a file, and its name and meta if dehyst wrote the file."""

    columns: list[Column]
    stored: Stored | None


def load(content: Content) -> Loaded:
    """Read a file's columns, in the helper process if its format needs isolation.

    Raise `FileFormatError` or `MissingExtraError`.
    """
    if not LOADERS[content.suffix].isolated or not sys.executable or getattr(sys, "frozen", False):
        return _load_here(content)
    demand_library(*package(content))
    with _LOCK:
        return _HELPER.load(content)


def demand_library(module: str, purpose: str) -> None:
    """Raise MissingExtraError, as the helper does, if a module is not installed."""
    from importlib.util import find_spec

    if sys.modules.get(module, ...) is None or find_spec(module.split(".", maxsplit=1)[0]) is None:
        library(module, purpose)


def close() -> None:
    """Stop the helper; it is started again when needed."""
    with _LOCK:
        _HELPER.close()


class _Helper:
    """The helper process, its pipes, and its owner: a fork of the owner needs a helper of its own."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def load(self, content: Content) -> Loaded:
        process = self._running()
        # The bytes follow the request.
        request = [*content._replace(path=str(content.path), data=len(content.data))]  # type: ignore[arg-type]
        try:
            answer = _exchange(process, request, content.data)
        except BaseException:
            # An interrupted exchange cannot be resumed.
            process.kill()
            self.close()
            raise
        if answer is None:
            status = process.wait()
            self.close()
            raise FileFormatError(_crash_message(content, status))
        if isinstance(answer, DehystError):
            raise answer
        return answer

    def close(self) -> None:
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    try:
                        pipe.close()
                    except BrokenPipeError:
                        continue
            process.wait()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is not None and self._owner == os.getpid() and self._process.poll() is None:
            return self._process
        self.close()
        command = [sys.executable, "-c", _START, json.dumps(sys.path)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
        )
        self._owner = os.getpid()
        return self._process


_HELPER, _LOCK = _Helper(), threading.Lock()
atexit.register(close)


def _exchange(process: subprocess.Popen[bytes], request: list[Any], data: bytes) -> Loaded | DehystError | None:
    """Send a file; return its columns or the error to raise, None without an answer."""
    requests, answers = process.stdin, process.stdout
    assert requests is not None
    assert answers is not None
    try:
        requests.write(json.dumps(request).encode() + b"\n")
        requests.write(data)
        requests.flush()
    except BrokenPipeError:
        return None
    line = answers.readline()
    if not line.endswith(b"\n"):
        return None
    answer = json.loads(line)
    if "error" in answer:
        error: DehystError = getattr(_errors, answer["error"])(**answer["fields"])
        return error
    columns = []
    for size, stated in answer["columns"]:
        values = np.empty(size)
        raw = values.view(np.uint8)
        if raw.size and answers.readinto(raw) < raw.size:  # type: ignore[attr-defined]
            return None
        columns.append(Column(**stated | {"data": values, "ends": tuple(stated["ends"])}))
    return Loaded(columns, Stored(*answer["stored"]) if answer["stored"] else None)


def _crash_message(content: Content, status: int) -> str:
    number = status - _SIGNAL if status > _SIGNAL else -status
    word = signal.Signals(number).name if number in set(signal.Signals) else f"status {status}"
    how = f"crashed on it ({word})"
    if word in ("SIGXCPU", "SIGKILL"):
        how = f"did not finish it in {_seconds(content)} s of CPU time, or was killed"
    return (
        f"{content.path}: not a readable {content.suffix} file: its library {how}; the file is damaged: take it from a "
        "copy, or export the measurement again"
    )


def _load_here(content: Content) -> Loaded:
    """Read a file in this process; convert the errors of every library for broken content."""
    try:
        kept = content.with_meta and content.suffix in hdf5.SUFFIXES
        stored = hdf5.decode(content.path, 2, content.data, content.most) if kept else None
        allowance = Allowance(content.path, content.most, content.decimal)
        return Loaded(LOADERS[content.suffix].load(content.data, allowance), stored)
    except DehystError:
        raise
    except MemoryError as error:
        raise FileFormatError(
            f"{content.path}: reading it takes more memory than {content.most / 1e6:.4g} MB of numbers should",
            hint="the file is damaged, or allow more bytes",
            change=("max_bytes",),
        ) from error
    except Exception as error:
        raise FileFormatError(
            f"{content.path}: not a readable {content.suffix} file ({str(error)[:300] or type(error).__name__}); check "
            "that the suffix fits"
        ) from error


def _seconds(content: Content) -> int:
    return _SECONDS + ceil(len(content.data) / _A_SECOND)


def serve() -> None:
    """Run the helper: read files from standard input until it is closed, answer on standard output."""
    source = sys.stdin.buffer
    with os.fdopen(os.dup(1), "wb") as answers:
        # The output of a library must not get into an answer.
        os.dup2(2, 1)
        while line := source.readline():
            path, size, *options = json.loads(line)
            content = Content(Path(path), source.read(size), *options)
            if len(content.data) < size:
                return
            if not hasattr(os, "fork"):
                _answer(content, answers)
            elif status := _answer_in_child(content, answers):
                os._exit(status)


def _answer_in_child(content: Content, answers: BinaryIO) -> int:
    """Answer in a forked child; return 0, or the status with which it ended."""
    with suppress(DehystError):
        library(*package(content))  # once, not in each child
    child = os.fork()
    if not child:
        try:
            _limit(content)
            _answer(content, answers)
            os._exit(0)
        finally:
            os._exit(1)
    _, status = os.waitpid(child, 0)
    return _SIGNAL + os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def _limit(content: Content) -> None:
    """Bound the memory and the CPU time of this process."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for kind, allowed in ((resource.RLIMIT_CPU, _seconds(content)), (resource.RLIMIT_AS, _memory(content.most))):
        _, hard = resource.getrlimit(kind)
        resource.setrlimit(kind, (allowed if hard == resource.RLIM_INFINITY else min(allowed, hard), hard))


def _memory(most: int) -> int:
    """Return the address space of this process, plus the space that reading may add [bytes]."""
    try:
        present = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        present = 1 << 32
    return present + 2 * most + _BESIDE


def _answer(content: Content, answers: BinaryIO) -> None:
    try:
        columns, stored = _load_here(content)
    except DehystError as error:
        answers.write(json.dumps({"error": type(error).__name__, "fields": vars(error)}).encode() + b"\n")
    else:
        names = [field.name for field in fields(Column) if field.name != "data"]
        heads = [[column.data.size, {name: getattr(column, name) for name in names}] for column in columns]
        answers.write(json.dumps({"columns": heads, "stored": stored and list(stored)}).encode() + b"\n")
        for column in columns:
            answers.write(np.ascontiguousarray(column.data, dtype=np.float64).data)
    answers.flush()
