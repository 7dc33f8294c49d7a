"""The readable formats; those with a library in C are read in a child process, which may crash.

One helper process imports the libraries once, and forks a child with bounds of memory and time for each file. No child
outlives the process that asked.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields
from importlib import import_module
from importlib.util import find_spec
from math import ceil
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from dehyst import _errors
from dehyst._errors import DehystError, FileFormatError, MissingExtraError
from dehyst.records import hdf5
from dehyst.records.formats import containers, vendor_files
from dehyst.records.formats.columns import TEXT, Column
from dehyst.records.formats.file_content import Allowance, Content
from dehyst.records.formats.text_table import as_utf8, read_text


class Format(NamedTuple):
    """A readable format: the function of bytes and their allowance that returns columns, and the library it needs.

    `library`: module in C of an optional package, for which it is read in a child process; empty without one. `name`:
    in messages, by default the suffix.
    """

    load: Callable[[bytes, Allowance], list[Column]]
    library: str = ""
    name: str = ""


def _read_text(data: bytes, allowance: Allowance) -> list[Column]:
    """Read a text file in the format that its first bytes show."""
    data = as_utf8(data)
    if vendor_files.is_labview(data):
        return vendor_files.read_labview(data, allowance)
    columns = vendor_files.read_gcs(data, allowance) if vendor_files.is_gcs(data) else read_text(data, allowance)
    mark = containers.LINE.encode()
    first = data[len(mark) : containers.LONGEST].splitlines()[:1] if data.startswith(mark) else []
    return containers.restored(columns, b"".join(first).decode(errors="replace"))


LOADERS = {
    **dict.fromkeys((*TEXT, ".lvm", ".asc"), Format(_read_text)),
    ".xlsx": Format(vendor_files.read_xlsx, "openpyxl"),
    ".mat": Format(containers.read_mat, "scipy.io"),
    ".h5": Format(containers.read_hdf5, "h5py"),
    ".hdf5": Format(containers.read_hdf5, "h5py"),
    ".parquet": Format(containers.read_parquet, "pyarrow.parquet", "Parquet"),
    ".tdms": Format(containers.read_tdms, "nptdms", "TDMS"),
    ".npy": Format(containers.read_npy),
    ".npz": Format(containers.read_npz),
}
# CPU time for a file [s], the bytes that add another second, and how many times longer it may take on a busy computer.
_SECONDS, _A_SECOND, _BUSY = 5, 5_000_000, 10
# How often the helper looks whether the process that asked is still there [s].
_TICK = 0.5
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
    stored: hdf5.Stored | None


def load(content: Content) -> Loaded:
    """Read a file's columns, in a child process if its format is of a library; raise FileFormatError.

    Raise `MissingExtraError` if the library is not installed.
    """
    module = _library(content)
    if module:
        package = module.split(".", maxsplit=1)[0]
        if sys.modules.get(module, ...) is None or find_spec(package) is None:
            name = LOADERS[content.suffix].name or content.suffix
            raise MissingExtraError.of(package, "files", f"Reading {name} files")
    if module and sys.executable and not getattr(sys, "frozen", False):
        with _LOCK:
            return _HELPER.load(content)
    return _load_here(content)


def _library(content: Content) -> str:
    """Return the module that reads a file; MAT files of version 7.3 are HDF5."""
    if content.suffix == ".mat" and containers.is_hdf5(content.data):
        return "h5py"
    return LOADERS[content.suffix].library


def _load_here(content: Content) -> Loaded:
    """Read a file in this process; its name comes before each message."""
    try:
        kept = content.with_meta and content.suffix in hdf5.SUFFIXES
        stored = hdf5.decode(content.data, 2, content.most) if kept else None
        allowance = Allowance(content.most, content.path.stem, content.decimal)
        return Loaded(LOADERS[content.suffix].load(content.data, allowance), stored)
    except FileFormatError as error:
        raise type(error)(**vars(error) | {"message": f"{content.path}: {error.message}"}) from error
    except DehystError:
        raise
    except MemoryError as error:
        raise FileFormatError(
            f"{content.path}: reading it takes more memory than {content.most / 1e6:.4g} MB of numbers should",
            hint="the file is damaged, or allow more bytes",
            change=("max_bytes",),
        ) from error
    except Exception as error:  # Every library has its own errors for broken content.
        raise FileFormatError(
            f"{content.path}: not a readable {content.suffix} file ({str(error)[:300] or type(error).__name__}); check "
            "that the suffix fits"
        ) from error


class _Helper:
    """The helper process, its pipes, and its owner: a fork of the owner needs a helper of its own."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def load(self, content: Content) -> Loaded:
        if self._process is None or self._owner != os.getpid() or self._process.poll() is not None:
            self.close()
            pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
            command = [sys.executable, "-c", _START, json.dumps(sys.path)]
            self._process = subprocess.Popen(command, start_new_session=True, **pipes)  # type: ignore[call-overload]
            self._owner = os.getpid()
        process = self._process
        try:
            answer = _exchange(process.stdin, process.stdout, content)  # type: ignore[arg-type]
        except DehystError:
            raise
        except BaseException:
            # An interrupted exchange cannot be resumed.
            self.close()
            raise
        if answer is None:
            status = process.wait()
            self.close()
            raise FileFormatError(_crash_message(content, status))
        return answer

    def close(self) -> None:
        """Kill the helper, and the child that reads a file."""
        process, self._process = self._process, None
        if process is not None and self._owner == os.getpid():
            if process.poll() is None:
                # The helper leads the group of its children.
                if hasattr(os, "killpg"):
                    os.killpg(process.pid, signal.SIGKILL)
                else:
                    process.kill()
            for pipe in (process.stdin, process.stdout):
                with suppress(BrokenPipeError):
                    pipe.close()  # type: ignore[union-attr]
            process.wait()


_HELPER, _LOCK = _Helper(), threading.Lock()


@atexit.register
def close() -> None:
    """Stop the helper; it is started again when needed."""
    with _LOCK:
        _HELPER.close()


def _exchange(requests: BinaryIO, answers: BinaryIO, content: Content) -> Loaded | None:
    """Send a file, the bytes after the request; return its columns, None without an answer, or raise its error."""
    request = [str(content.path), len(content.data), *content[2:]]
    try:
        requests.write(json.dumps(request).encode() + b"\n")
        requests.write(content.data)
        requests.flush()
    except BrokenPipeError:
        return None
    line = answers.readline()
    if not line.endswith(b"\n"):
        return None
    answer = json.loads(line)
    if "error" in answer:
        raise getattr(_errors, answer["error"])(**answer["fields"])
    columns = []
    for size, stated in answer["columns"]:
        values = np.empty(size)
        if size and answers.readinto(values.view(np.uint8)) < values.nbytes:  # type: ignore[attr-defined]
            return None
        columns.append(Column(**stated | {"data": values, "ends": tuple(stated["ends"])}))
    return Loaded(columns, hdf5.Stored(*answer["stored"]) if answer["stored"] else None)


def _crash_message(content: Content, status: int) -> str:
    number = status - _SIGNAL if status > _SIGNAL else -status
    word = signal.Signals(number).name if number in set(signal.Signals) else ""
    how = f"crashed on it ({word})" if word else f"ended without an answer (status {status})"
    if word in ("SIGXCPU", "SIGKILL"):
        seconds = _seconds(content)
        how = f"did not finish it in {seconds} s of CPU time, or {_BUSY * seconds} s in all, or was killed"
    advice = "the file is damaged: take it from a copy, or export the measurement again"
    return f"{content.path}: not a readable {content.suffix} file: its library {how}; {advice}"


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
            elif (status := _answer_in_child(content, answers)) is not None:
                os._exit(status)


def _answer_in_child(content: Content, answers: BinaryIO) -> int | None:
    """Answer in a forked child; return the status with which it ended if it did not answer, else None."""
    if module := _library(content):  # Once, not in each child.
        with suppress(ImportError):
            import_module(module)
    asker, end = os.getppid(), time.monotonic() + _BUSY * _seconds(content)
    done, answered = os.pipe()
    child = os.fork()
    if not child:
        try:
            _limit(content)
            _answer(content, answers)
            os.write(answered, b"\n")
            os._exit(0)
        finally:
            os._exit(1)
    os.close(answered)
    ended: list[int] = []
    while not ended and os.getppid() == asker and time.monotonic() < end:
        ended, _, _ = select.select([done], [], [], _TICK)
    finished = bool(ended) and os.read(done, 1) != b""
    os.close(done)
    if not finished:
        os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if finished:
        return None
    return _SIGNAL + os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.waitstatus_to_exitcode(status)


def _limit(content: Content) -> None:
    """Bound the memory and the CPU time of this process, for good."""
    import resource

    try:
        present = int(Path("/proc/self/statm").read_text("ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        present = 1 << 32
    seconds, memory = _seconds(content), present + 2 * content.most + _BESIDE
    for kind, soft, hard in (
        (resource.RLIMIT_CORE, 0, 0),
        # A second later, SIGKILL ends what ignores SIGXCPU.
        (resource.RLIMIT_CPU, seconds, seconds + 1),
        (resource.RLIMIT_AS, memory, memory),
    ):
        _, most = resource.getrlimit(kind)
        resource.setrlimit(kind, (soft, hard) if most == resource.RLIM_INFINITY else (min(soft, most), min(hard, most)))


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
