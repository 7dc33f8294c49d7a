"""Bytes of flash, RAM and stack of an exported folder, by a compiler."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from dehyst._errors import FileFormatError
from dehyst._io import PathLike
from dehyst.exports.naming import DEFAULT, name_in, text_of

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
_M4, _UNIT = ("-mcpu=cortex-m4", "-mthumb"), ("-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
CORTEX_M4, CORTEX_M4_SMALL = ("-O2", *_M4), ("-Os", "-flto", *_M4)
CORTEX_M4F, CORTEX_M4F_SMALL = (*CORTEX_M4, *_UNIT), (*CORTEX_M4_SMALL, *_UNIT)
_BARE = ("-ffreestanding", "-ffunction-sections", "-fdata-sections", "-fno-asynchronous-unwind-tables")
_PROGRAM = """#include "piezo.h"
static piezo memory;
volatile dehyst_real wanted, sent;
int main(void)
{
    if (piezo_begin(&memory) != DEHYST_OK) return 1;
    for (;;) sent = piezo_step(&memory, wanted);
}
"""
_STAGE_PROGRAM = """#include "piezo.h"
static piezo memory;
volatile dehyst_real wanted, sent;
int main(void)
{
    dehyst_real given[MODEL_AXES], got[MODEL_AXES];
    int j;
    if (piezo_begin(&memory) != DEHYST_OK) return 1;
    for (;;) {
        for (j = 0; j < MODEL_AXES; j++) given[j] = wanted;
        piezo_step(&memory, given, got);
        for (j = 0; j < MODEL_AXES; j++) sent = got[j];
    }
}
"""
_MEMORY = '#include "piezo.h"\nextern char memory[sizeof(piezo)];\nchar memory[sizeof(piezo)] = {0};\n'
_FRAME = re.compile(r'node: \{ title: "([^"]+)" label: "[^"]*?(\d+) bytes')
_CALL = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')


class Footprint(NamedTuple):
    """Bytes of `flash` (code and numbers), of RAM for one piezo, and of `stack` below a call, None if unknown.

    RAM is `ram`.
    """

    flash: int
    ram: int
    stack: int | None


def sizes(directory: PathLike, compiler: str = "cc", flags: Sequence[str] = ("-O2",)) -> Footprint:
    """Compile an exported folder and measure it.

    Parameters
    ----------
    directory : path
        A folder that `dehyst.export` wrote.
    compiler : str, optional
        The compiler for the processor, such as ``arm-none-eabi-gcc``; its `size` is expected beside it.
    flags : sequence of str, optional
        Optimisation and processor; ``-flto`` leaves out what this model does not need.

    Returns
    -------
    Footprint
        Flash is that of a program that begins and steps, with the compiler's own arithmetic and nothing else. Stack is
        that of the deepest chain of calls without this arithmetic; only gcc reports it.

    Raises
    ------
    FileFormatError
        If there is no such compiler, or it cannot compile the folder.
    """
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        for source in (*Path(directory).glob("*.c"), *Path(directory).glob("*.h")):
            if source.name != "check.c":
                shutil.copy(source, folder)
        name = name_in(folder) or DEFAULT
        several = "MODEL_AXES" in (folder / f"{name}.h").read_text(encoding="utf-8")
        (folder / "program.c").write_text(text_of(_STAGE_PROGRAM if several else _PROGRAM, name))
        sources = sorted(path.name for path in folder.glob("*.c"))
        options = [*STRICT, *_BARE, *flags]
        graphs = _compile(folder, compiler, options, sources)
        link = ["-static", "-nostdlib", "-Wl,--gc-sections", "-Wl,-e,main", "-Wl,--build-id=none"]
        objects = [f"{name[:-2]}.o" for name in sources]
        # With -flto the program is compiled when it is linked.
        late = ["-fcallgraph-info=su", *_BARE] if graphs else []
        run([compiler, *flags, *late, *link, *objects, "-lgcc", "-o", "program"], folder)
        (folder / "memory.c").write_text(text_of(_MEMORY, name))
        run([compiler, *options, "-fno-lto", "-c", "memory.c"], folder)
        text, data, _ = _size(folder, compiler, "program")
        return Footprint(
            text + data, sum(_size(folder, compiler, "memory.o")), _deepest(folder, name) if graphs else None
        )


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


def _compile(folder: Path, compiler: str, options: list[str], sources: Sequence[str]) -> bool:
    """Compile, and return whether the compiler also wrote the graph of calls."""
    try:
        run([compiler, *options, "-fcallgraph-info=su", "-c", *sources], folder)
    except FileFormatError:
        run([compiler, *options, "-c", *sources], folder)
        return False
    return True


def _size(folder: Path, compiler: str, file: str) -> tuple[int, int, int]:
    """Return the bytes of text, data and bss."""
    beside = re.sub(r"(gcc|clang|cc)(-[\d.]+)?$", "size", compiler)
    row = run([beside if shutil.which(beside) else "size", file], folder).splitlines()[1].split()
    return int(row[0]), int(row[1]), int(row[2])


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
        return frames.get(caller, 0) + _most(below(called) for called in calls.get(caller, ()))

    # Compiled as a whole, a step may have become a part of the program; titles then begin with a file.
    own = {title: title.rpartition(":")[2] for title in frames}
    inlined = f"{name}_step" not in own.values()
    begins = f"{name}_"
    return _most(below(title) for title, call in own.items() if call.startswith(begins) or (inlined and call == "main"))


def _most(values: Iterable[int]) -> int:
    return max(values, default=0)
