"""A compensator as a folder of C for a microcontroller: the very files that Python runs, and its numbers."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path
from string import Template
from typing import NamedTuple

from dehyst._errors import FileFormatError, ModelError
from dehyst._io.drafts import PathLike, draft_of, path_of, settle, settle_folder, unwritten
from dehyst._version import __version__
from dehyst.control import Compensator
from dehyst.exports.footprint import (
    CORTEX_M4,
    CORTEX_M4_SMALL,
    CORTEX_M4F,
    CORTEX_M4F_SMALL,
    STRICT,
    Footprint,
    run,
    sizes,
)
from dehyst.exports.golden_trace import GoldenTrace, golden_trace, trace_header
from dehyst.exports.model_header import NUMBERS, SIZES, Number, demand_compensator, numbers, size_macros, title
from dehyst.exports.naming import DEFAULT, demand_name, file_of, name_in, printable, text_of
from dehyst.exports.operation_count import Operations, worst_case
from dehyst.exports.shipped import shipped
from dehyst.exports.start import ExportedStart

__all__ = ["SOURCES", "Exported", "Footprint", "Operations", "code", "export", "sizes", "worst_case"]

SOURCES = ("piezo.c", "dehyst.c")
_HEADERS = ("piezo.h", "dehyst.h")
_FILES = {*SOURCES, *_HEADERS, "check.c", "trace.h", "Makefile", "README.md", "LICENSE"}
_BUILT = re.compile(r".*\.(o|ci|su)|check_program")
# A float's error, as a share of the range: above the first, or the number type was not rewritten everywhere.
_LEAST, _UNMEASURED, _MARGIN = 1e-9, 1e-3, 2.0
_ANY = 1e300
_AHEAD = "\n        /* Give each displacement {ahead} samples before its time, MODEL_AHEAD. */"
_SMOOTH = """

Wishes must be smooth, without jumps, corners or noise: what is late is made up for by differences between samples, and
these make such wishes large. Voltages stay within the limits all the same.
"""
_INDENT = " " * 22 + "# "
_COMPILER, _UNASKED = "cc", "not asked for"
_PROCESSORS: dict[str, tuple[str, tuple[str, ...]]] = {
    "this computer, -O2": (_COMPILER, ("-O2",)),
    "Cortex-M4, -O2": ("arm-none-eabi-gcc", CORTEX_M4),
    "Cortex-M4, -Os -flto": ("arm-none-eabi-gcc", CORTEX_M4_SMALL),
    "Cortex-M4F, -O2": ("arm-none-eabi-gcc", CORTEX_M4F),
    "Cortex-M4F, -Os -flto": ("arm-none-eabi-gcc", CORTEX_M4F_SMALL),
}
_MEASURED = re.compile(r"largest error ([\d.e+-]+) of the range")


class Exported(NamedTuple):
    """An exported folder.

    Attributes
    ----------
    folder : Path
    footprints : dict of str to Footprint
        Bytes by processor, for each compiler that was found.
    operations : Operations
        Of a step, at most.
    error : float or None
        Of floats: the largest error of the trace, as a share of the limits or of the reach; None if not measured.
    unmeasured : str or None
        Why bytes or error were not measured on this computer; None if they were.
    """

    folder: Path
    footprints: dict[str, Footprint]
    operations: Operations
    error: float | None
    unmeasured: str | None


def code(compensator: Compensator, number: Number = "double", name: str = DEFAULT) -> dict[str, str]:
    """The C files of a compensator by name: `SOURCES` and the headers that they include, as `export` writes them.

    Raises
    ------
    ModelError
        If it is no Compensator, the number type is another one, floats cannot hold this model, or the name is none in
        C or means something else there.
    """
    demand_compensator(compensator)
    if number not in ("double", "float"):
        raise ModelError(f"number: got {number!r}, need 'double' or 'float'")
    demand_name(name)
    files = {file: shipped(file) for file in (*SOURCES, *_HEADERS)}
    if number == "float":
        files["dehyst.h"] = _single(files["dehyst.h"])
    for file, place, generated in (("piezo.c", NUMBERS, numbers), ("piezo.h", SIZES, size_macros)):
        text = text_of(files[file].replace(place, generated(compensator, number)), name)
        # The actuator's name is not to be renamed.
        files[file] = f"{title(compensator)}\n{text}"
    return {file_of(file, name): text for file, text in files.items()}


def export(
    compensator: Compensator,
    directory: PathLike,
    number: Number = "double",
    *,
    force: bool = False,
    name: str = DEFAULT,
    measure: bool = True,
) -> Exported:
    """Write a compensator as C: all of it, or nothing.

    The folder holds the files of the core, byte for byte but for the number type, `model.h` with the numbers, `piezo.h`
    with the calls, a trace of what Python does that ``make check`` replays, and a README that says how to use it, how
    many bytes it takes and how many operations a step is at most.

    Parameters
    ----------
    compensator : Compensator
        It is exported as it was made or last reset, and stays as it is.
    directory : path
        Made here; may exist if it is empty.
    number : {'double', 'float'}, optional
        float: every number is rounded once. The error against double is measured if there is a compiler.
    force : bool, optional
        Replace an earlier export. Other files are never replaced.
    name : str, optional
        Of the type and the calls, a name in C, so that several models go into one firmware: files are then NAME.c,
        NAME.h, NAME_model.h and NAME_model_size.h, and macros begin with it.
    measure : bool, optional
        Compile it, for bytes and for the error of floats, which takes seconds; False: README goes without.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError
        If it is no Compensator, the number type is another one, floats cannot hold this model, or the name is none in
        C or means something else there.
    FileFormatError
        If it is no path, the folder holds other files, or cannot be written.
    """
    folder = path_of(directory)
    files = code(compensator, number, name)
    files |= {file: text_of(shipped(file), name) for file in ("check.c", "Makefile")} | {"LICENSE": shipped("LICENSE")}
    target = folder.resolve()
    draft = draft_of(target)
    try:
        _demand_free(folder, force)
        draft.mkdir()
        _write(draft, files)
        measured = _complete(draft, compensator, number, name, measure)
        _put(draft, target)
    except OSError as error:
        raise unwritten(folder, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return measured._replace(folder=folder)


def _complete(draft: Path, compensator: Compensator, number: Number, name: str, measure: bool) -> Exported:
    """Add what needs the other files: the trace with its bound, and the README with what was measured."""
    trace = golden_trace(compensator)
    _write(draft, {"trace.h": trace_header(trace, _LEAST, _ANY)})
    made = Exported(draft, {}, worst_case(compensator), None, None if measure else _UNASKED)
    if measure:
        made = _measured(made, number, name)
    if number == "float":
        most = _UNMEASURED if made.error is None else _MARGIN * made.error
        _write(draft, {"trace.h": trace_header(trace, _LEAST, most)})
    _write(draft, {"README.md": _readme(compensator, number, trace, made, name)})
    return made


def _measured(made: Exported, number: Number, name: str) -> Exported:
    """With what the compilers at hand make of it, or why they do not."""
    found, error, why = {}, None, None
    if number == "float":
        try:
            error = _float_error(made.folder, name)
        except FileFormatError as failure:
            why = _reason(failure)
    for processor, (compiler, flags) in _PROCESSORS.items():
        # Its unit knows floats only.
        if processor.startswith("Cortex-M4F") and number == "double":
            continue
        try:
            found[processor] = sizes(made.folder, compiler, flags)
        except FileFormatError as failure:
            why = _reason(failure) if compiler == _COMPILER else why
    return made._replace(footprints=found, error=error, unmeasured=why)


def _reason(failure: FileFormatError) -> str:
    if shutil.which(_COMPILER) is None:
        return f"no C compiler ({_COMPILER}) was found"
    return f"the C compiler failed ({failure})"


def _single(header: str) -> str:
    """`dehyst.h` for floats."""
    if header.count("typedef double dehyst_real;") != 1 or header.count("DBL_") != 2:
        raise FileFormatError("exports/templates/dehyst.h: not the file of this version; install dehyst again")
    return header.replace("typedef double dehyst_real;", "typedef float dehyst_real;").replace("DBL_", "FLT_")


def _demand_free(folder: Path, force: bool) -> None:
    """Refuse a folder that holds what an export would not write; an earlier export, too, unless told otherwise."""
    if not folder.resolve().parent.is_dir():
        raise FileFormatError(f"{folder}: the folder {folder.parent} does not exist; create it first")
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: is a file, need the name of a folder")
    there = sorted(path.name for path in folder.iterdir())
    earlier = name_in(folder)
    own = {file_of(file, earlier or DEFAULT) for file in _FILES}
    other = [name for name in there if name not in own and not _BUILT.fullmatch(name)]
    if other or (there and earlier is None):
        named = ", ".join((other or there)[:3])
        raise FileFormatError(
            f"{folder}: holds other files ({named}); an export replaces its folder whole, so own files must live "
            "outside it: give the name of a new or an empty folder"
        )
    if there and not force:
        raise FileFormatError(f"{folder}: holds an earlier export; give another name, or --force to replace it")


def _put(draft: Path, target: Path) -> None:
    """The draft at its place, what was there removed."""
    settle_folder(draft)
    if not target.exists():
        draft.rename(target)
    else:
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".dehyst-") as old:
            kept = target.rename(Path(old) / "old")
            try:
                draft.rename(target)
            except OSError:
                kept.rename(target)
                raise
    settle_folder(target.parent)


def _write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        with (folder / name).open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            settle(stream.fileno())


def _float_error(folder: Path, name: str) -> float:
    """Largest error of the trace in floats, as a share of the range."""
    with tempfile.TemporaryDirectory() as work:
        program, sources = str(Path(work) / "check"), [file_of(file, name) for file in SOURCES]
        run([_COMPILER, *STRICT, "-O2", "check.c", *sources, "-o", program], folder)
        found = _MEASURED.search(run([program], folder))
    if found is None:
        raise FileFormatError("check.c: did not tell the error of floats; install dehyst again")
    return float(found[1])


def _readme(compensator: Compensator, number: Number, trace: GoldenTrace, made: Exported, own: str) -> str:
    low, high = compensator.limits
    period, slew, ahead = compensator.period, compensator.slew_rate, compensator.samples_ahead
    outset, tables = ExportedStart.of(compensator), compensator.tables()
    text = shipped("README.md")
    if own != DEFAULT:
        # The example's variable must not be called as its type.
        text = text_of(re.sub(r"\bstage\b", "piezo_1", text), own)
    return Template(text).substitute(
        name=printable(compensator.actuator.name),
        version=__version__,
        number=number,
        every="a sample" if period is None else f"every {period:.9g} s",
        timer="this model does not depend on time"
        if period is None
        else text_of(f"every {period:.9g} s, MODEL_PERIOD", own),
        low=f"{low:.9g}",
        high=f"{high:.9g}",
        slew="" if slew is None else f" and change by {slew:.9g} V/s at most",
        ahead=text_of(_AHEAD.format(ahead=ahead), own) if ahead else "",
        smooth=_SMOOTH if tables["tap"].size > 1 or compensator.actuator.lag else "",
        begins=outset.words,
        way=outset.way,
        bytes=text_of(_bytes(made), own),
        arithmetic=made.operations.arithmetic,
        divisions=made.operations.divisions,
        comparisons=made.operations.comparisons,
        rows=len(trace.rows),
        error=_error_words(number, made),
        config="" if number == "double" else ", its numbers made floats in `dehyst.h`",
    )


def _error_words(number: Number, made: Exported) -> str:
    if number == "double":
        return ": the same bits"
    if made.error is None:
        return f"; the error was not\n{_INDENT}measured, it is taken to be below {_UNMEASURED:.0e} of the range"
    most = f"{_MARGIN * made.error:.1e}"
    return f"; errors are {made.error:.1e}\n{_INDENT}of the range at most, to be above {_LEAST:.0e} and below {most}"


def _bytes(made: Exported) -> str:
    if made.unmeasured is not None:
        left_out = (
            f"Not measured on this computer: {made.unmeasured}. Later, "
            "`dehyst.exports.sizes(folder, compiler)` measures it."
        )
        return left_out if not made.footprints else f"{left_out}\n\n{_table(made.footprints)}"
    return _table(made.footprints)


def _table(footprints: dict[str, Footprint]) -> str:
    return "\n".join(
        [
            "| bytes | flash | RAM for one `piezo` | stack |",
            "| --- | --- | --- | --- |",
            *(f"| {name} | {one.flash} | {one.ram} | {one.stack or 'not told'} |" for name, one in footprints.items()),
            "",
            "Flash: code, numbers and the compiler's own arithmetic; `-flto` leaves out what this model does not need.",
            "Stack: the deepest chain of calls, without that arithmetic.",
        ]
    )
