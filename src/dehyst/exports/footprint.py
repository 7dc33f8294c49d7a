"""Footprint of an exported folder (flash, RAM, stack) and error of its floats, by the installed compilers."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from dehyst._errors import FileFormatError
from dehyst._io import PathLike
from dehyst.exports.naming import DEFAULT, name_in, shipped, text_of

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
_M4, _UNIT = ("-mcpu=cortex-m4", "-mthumb"), ("-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
CORTEX_M4, CORTEX_M4_SMALL = ("-O2", *_M4), ("-Os", "-flto", *_M4)
CORTEX_M4F, CORTEX_M4F_SMALL = (*CORTEX_M4, *_UNIT), (*CORTEX_M4_SMALL, *_UNIT)
_COMPILER, _ARM = "cc", "arm-none-eabi-gcc"
# Compiler and flags by processor, and whether it computes doubles: the unit of a Cortex-M4F has floats only.
PROCESSORS = {
    "this computer, -O2": (_COMPILER, ("-O2",), True),
    "Cortex-M4, -O2": (_ARM, CORTEX_M4, True),
    "Cortex-M4, -Os -flto": (_ARM, CORTEX_M4_SMALL, True),
    "Cortex-M4F, -O2": (_ARM, CORTEX_M4F, False),
    "Cortex-M4F, -Os -flto": (_ARM, CORTEX_M4F_SMALL, False),
}
_BARE = ("-ffreestanding", "-ffunction-sections", "-fdata-sections", "-fno-asynchronous-unwind-tables")
_MEMORY = '#include "piezo.h"\nextern char memory[sizeof(piezo)];\nchar memory[sizeof(piezo)] = {0};\n'
_FRAME = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes')
_CALL = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')
_ERROR = re.compile(r"largest error ([\d.e+-]+) of the range")


class Footprint(NamedTuple):
    """Bytes of `flash` (code and numbers), of `ram` for one piezo, and of `stack` below a call, None if unknown."""

    flash: int
    ram: int
    stack: int | None


class Measurement(NamedTuple):
    """Bytes by processor, the largest error of floats as a share of the range, and why a value is missing."""

    footprints: dict[str, Footprint]
    error: float | None
    unmeasured: str | None


def measure(folder: Path, number: str, name: str) -> Measurement:
    """Measure an exported folder, whose model has a `name`, with the installed compilers."""
    error, reason, footprints = None, None, {}
    try:
        if number == "float":
            error = _float_error(folder, name)
    except FileFormatError as failure:
        reason = _reason(failure)
    for processor, (compiler, flags, doubles) in PROCESSORS.items():
        if number == "double" and not doubles:
            continue
        try:
            footprints[processor] = sizes(folder, compiler, flags)
        except FileFormatError as failure:
            reason = _reason(failure) if compiler == _COMPILER else reason
    return Measurement(footprints, error, reason)


def _reason(failure: FileFormatError) -> str:
    if shutil.which(_COMPILER) is None:
        return f"no C compiler ({_COMPILER}) was found"
    return f"the C compiler failed ({failure})"


def _float_error(folder: Path, name: str) -> float:
    """Measure the largest error of the trace in floats, as a share of the range."""
    with tempfile.TemporaryDirectory() as work:
        program = str(Path(work) / "check")
        run([_COMPILER, *STRICT, "-O2", "check.c", f"{name}.c", "dehyst.c", "-o", program], folder)
        error = _ERROR.search(run([program], folder))
    if error is None:
        raise FileFormatError("check.c: did not print the error of floats; install dehyst again")
    return float(error[1])


def sizes(directory: PathLike, compiler: str = "cc", flags: Sequence[str] = ("-O2",)) -> Footprint:
    """Compile a `directory` that `dehyst.export` wrote, and measure it.

    `compiler`: the compiler for the processor, such as ``arm-none-eabi-gcc``, with its ``size`` in the same folder.
    `flags`: optimisation and processor; ``-flto`` leaves out what this model does not need.

    Flash is the size of a program that only begins and steps, including the compiler's own arithmetic. Stack is the
    depth of the deepest chain of calls without this arithmetic; only gcc reports it. Raise `FileFormatError` if there
    is no such compiler, or it cannot compile the folder.
    """
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        for source in (*Path(directory).glob("*.c"), *Path(directory).glob("*.h")):
            if source.name != "check.c":
                shutil.copy(source, folder)
        name = name_in(folder) or DEFAULT
        (folder / "program.c").write_text(text_of(shipped("footprint.c"), name))
        sources = sorted(path.name for path in folder.glob("*.c"))
        options, graph = [*STRICT, *_BARE, *flags], ["-fcallgraph-info=su"]
        try:
            run([compiler, *options, *graph, "-c", *sources], folder)
        except FileFormatError:
            graph = []
            run([compiler, *options, "-c", *sources], folder)
        link = ["-static", "-nostdlib", "-Wl,--gc-sections", "-Wl,-e,main", "-Wl,--build-id=none"]
        objects = [f"{source[:-2]}.o" for source in sources]
        # With -flto the program is compiled when it is linked.
        late = [*graph, *_BARE] if graph else []
        run([compiler, *flags, *late, *link, *objects, "-lgcc", "-o", "program"], folder)
        (folder / "memory.c").write_text(text_of(_MEMORY, name))
        run([compiler, *options, "-fno-lto", "-c", "memory.c"], folder)
        text, data, _ = _size(folder, compiler, "program")
        ram = sum(_size(folder, compiler, "memory.o"))
        return Footprint(text + data, ram, _deepest(folder, name) if graph else None)


def run(command: Sequence[str], folder: Path) -> str:
    """Run a command in a folder and return what it prints.

    Raise `FileFormatError` if it cannot be run, or fails; with its message.
    """
    try:
        english = {**os.environ, "LC_ALL": "C"}
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, check=False, timeout=300, env=english
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise FileFormatError(f"{command[0]}: cannot be run ({error}); name a compiler that is installed") from error
    if done.returncode:
        lines = (done.stderr.strip() or done.stdout.strip() or f"status {done.returncode}").splitlines()
        # A compiler names places before it names the error.
        lines = [line for line in lines if "error" in line.lower()] or lines
        raise FileFormatError(f"{' '.join(command[:2])} ...: {lines[0]}; need a C99 compiler for the processor")
    return done.stdout


def _size(folder: Path, compiler: str, file: str) -> list[int]:
    """Return the bytes of text, data and bss."""
    beside = re.sub(r"(gcc|clang|cc)(-[\d.]+)?$", "size", compiler)
    row = run([beside if shutil.which(beside) else "size", file], folder).splitlines()[1].split()
    return [int(word) for word in row[:3]]


def _deepest(folder: Path, name: str) -> int:
    """Return the bytes of the deepest chain of calls from a function of `NAME.h`; nothing here calls itself."""
    frames: dict[str, int] = {}
    calls: dict[str, set[str]] = {}
    for graph in folder.glob("*.ci"):
        text = graph.read_text()
        frames.update((title, int(size)) for title, size in _FRAME.findall(text))
        for caller, called in _CALL.findall(text):
            calls.setdefault(caller, set()).add(called)

    def below(caller: str) -> int:
        return frames.get(caller, 0) + max((below(called) for called in calls.get(caller, ())), default=0)

    # Compiled as a whole, a step may have become a part of the program; titles then begin with a file.
    own = {title: title.rpartition(":")[2] for title in frames}
    inlined = f"{name}_step" not in own.values()
    begins = [t for t, call in own.items() if call.startswith(f"{name}_") or (inlined and call == "main")]
    return max(map(below, begins), default=0)
