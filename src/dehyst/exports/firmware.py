"""A compensator as a folder of C for a microcontroller: the core that Python runs, and the numbers of the model."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from string import Template
from typing import NamedTuple, TypeVar

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import PathLike, draft_of, path_of, settle, settle_folder, unwritten
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
from dehyst.exports.model_header import (
    NUMBERS,
    SIZES,
    Number,
    config_header,
    demand_compensator,
    numbers,
    size_macros,
    title,
)
from dehyst.exports.naming import DEFAULT, demand_name, file_of, name_in, printable, text_of
from dehyst.exports.shipped import shipped
from dehyst.exports.start import ExportedStart

__all__ = ["SOURCES", "Exported", "Footprint", "code", "export", "sizes"]

_Result = TypeVar("_Result")
SOURCES = ("piezo.c", "dehyst.c")
CORE = ("dehyst.c", "dehyst.h", "dehyst_model.h")
CONFIG = "dehyst_config.h"
_FILES = {*CORE, CONFIG, "piezo.c", "piezo.h", "check.c", "trace.h", "Makefile", "README.md", "LICENSE"}
_BUILT = re.compile(r".*\.(o|ci|su)|check_program")
# A float's error, as a share of the range: below the first, the number type was not changed everywhere.
_LEAST, _UNMEASURED, _MARGIN = 1e-9, 1e-3, 2.0
_ANY = 1e300
_AHEAD = "\n        /* Give each displacement {ahead} samples before its time, MODEL_AHEAD. */"
_SMOOTH = """

Wanted displacements must be smooth, without jumps, corners or noise: delays are compensated by differences between
samples, which amplify these. Voltages stay within the limits all the same.
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
_TABLE_NOTES = (
    "",
    "Flash: code, numbers and the compiler's own arithmetic; `-flto` leaves out what this model does not need.",
    "Stack: the deepest chain of calls, without that arithmetic.",
)
_MEASURED = re.compile(r"largest error ([\d.e+-]+) of the range")


class Exported(NamedTuple):
    """An exported folder.

    Attributes
    ----------
    folder : Path
    footprints : dict of str to Footprint
        Bytes by processor, for each compiler that was found.
    error : float or None
        Of floats: the largest error of the trace, as a share of the limits or of the reach; None if not measured.
    unmeasured : str or None
        Why bytes or error were not measured on this computer; None if they were.
    """

    folder: Path
    footprints: dict[str, Footprint]
    error: float | None
    unmeasured: str | None


def code(compensator: Compensator, number: Number = "double", name: str = DEFAULT) -> dict[str, str]:
    """Return the C files of a compensator by name: `SOURCES` and their headers, as `export` writes them.

    Raise `ModelError` if it is no Compensator, the number type is another one, floats cannot hold this model, or the
    name is no name in C or has a meaning there.
    """
    demand_compensator(compensator)
    if number not in ("double", "float"):
        raise ModelError(argument="number", got=repr(number), need="'double' or 'float'")
    demand_name(name)
    files = {file: shipped(file) for file in (*CORE, "piezo.c", "piezo.h")} | {CONFIG: config_header(number)}
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
    """Write a compensator as C: the whole folder, or nothing.

    Six files go into a firmware: the core, `dehyst.c`, `dehyst.h` and `dehyst_model.h`, byte for byte the one that
    Python runs; `dehyst_config.h` with the number type; the model, `piezo.c` and `piezo.h`, with its numbers and calls.
    Beside them are a golden trace that ``make check`` replays, and a README with the usage and the bytes that it takes.

    Parameters
    ----------
    compensator : Compensator
        The export has the state in which it was made or last reset. It does not change.
    directory : path
        A new or an empty folder.
    number : {'double', 'float'}, optional
        float: every number is rounded once; the error is measured if there is a compiler.
    force : bool, optional
        Replace an earlier export. A folder with other files is always refused.
    name : str, optional
        Name in C of the type and the calls, so that several models fit into one firmware: the files of the model are
        then NAME.c and NAME.h, and macros begin with it.
    measure : bool, optional
        Compile the export to measure bytes and the error of floats, which takes seconds.

    Returns
    -------
    Exported

    Raises
    ------
    ModelError
        If it is no Compensator, the number type is another one, floats cannot hold this model, or the name is no name
        in C or has a meaning there.
    FileFormatError
        If it is no path, the folder holds other files, or it cannot be written.
    """
    folder = path_of(directory)
    files = code(compensator, number, name)
    files |= {file: text_of(shipped(file), name) for file in ("check.c", "Makefile")} | {"LICENSE": shipped("LICENSE")}

    def fill(draft: Path) -> Exported:
        write_files(draft, files)
        return _complete(draft, compensator, number, name, measure)

    return fill_folder(folder, fill, force)._replace(folder=folder)


def fill_folder(folder: Path, fill: Callable[[Path], _Result], force: bool) -> _Result:
    """Write the `folder` of an export, whole or not at all; return what `fill`, called with a draft of it, returns.

    With `force` an earlier export is replaced. Raise `FileFormatError` if the folder holds other files, or cannot be
    written.
    """
    target = folder.resolve()
    draft = draft_of(target)
    try:
        _demand_free(folder, force)
        draft.mkdir()
        result = fill(draft)
        _put(draft, target)
    except OSError as error:
        raise unwritten(folder, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return result


def _complete(draft: Path, compensator: Compensator, number: Number, name: str, measure: bool) -> Exported:
    """Add the trace with its error bound and the README with the measured sizes, which need the other files."""
    trace = golden_trace(compensator)
    write_files(draft, {"trace.h": trace_header(trace, _LEAST, _ANY)})
    result = Exported(draft, {}, None, None if measure else _UNASKED)
    if measure:
        result = _measured(result, number, name)
    if number == "float":
        most = _UNMEASURED if result.error is None else _MARGIN * result.error
        write_files(draft, {"trace.h": trace_header(trace, _LEAST, most)})
    write_files(draft, {"README.md": _readme(compensator, number, trace, result, name)})
    return result


def _measured(result: Exported, number: Number, name: str) -> Exported:
    """Add sizes and error by the compilers at hand, or the reason why they are missing."""
    error, reason = None, None
    if number == "float":
        try:
            error = _float_error(result.folder, name)
        except FileFormatError as failure:
            reason = _reason(failure)
    footprints, unmeasured = footprints_of(result.folder, number)
    return result._replace(footprints=footprints, error=error, unmeasured=unmeasured or reason)


def footprints_of(folder: Path, number: Number) -> tuple[dict[str, Footprint], str | None]:
    """Return the bytes of an export in a `folder` by processor, and why they are missing, if they are."""
    footprints, reason = {}, None
    for processor, (compiler, flags) in _PROCESSORS.items():
        # Its floating-point unit has floats only.
        if processor.startswith("Cortex-M4F") and number == "double":
            continue
        try:
            footprints[processor] = sizes(folder, compiler, flags)
        except FileFormatError as failure:
            reason = _reason(failure) if compiler == _COMPILER else reason
    return footprints, reason


def _reason(failure: FileFormatError) -> str:
    if shutil.which(_COMPILER) is None:
        return f"no C compiler ({_COMPILER}) was found"
    return f"the C compiler failed ({failure})"


def _demand_free(folder: Path, force: bool) -> None:
    """Refuse a folder with files that an export does not write, and without `force` an earlier export."""
    if not folder.resolve().parent.is_dir():
        raise FileFormatError(f"{folder}: the folder {folder.parent} does not exist; create it first")
    if not folder.exists():
        return
    if not folder.is_dir():
        raise FileFormatError(f"{folder}: is a file, need the name of a folder")
    present = sorted(path.name for path in folder.iterdir())
    earlier = name_in(folder)
    exported = {file_of(file, earlier or DEFAULT) for file in _FILES}
    foreign = [name for name in present if name not in exported and not _BUILT.fullmatch(name)]
    if foreign or (present and earlier is None):
        named = ", ".join((foreign or present)[:3])
        raise FileFormatError(
            f"{folder}: holds other files ({named}); an export replaces its folder whole, so own files must live "
            "outside it: give the name of a new or an empty folder"
        )
    if present and not force:
        raise FileFormatError(f"{folder}: holds an earlier export; give another name, or --force to replace it")


def _put(draft: Path, target: Path) -> None:
    """Move the draft to its place, and remove what was there."""
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


def write_files(folder: Path, files: dict[str, str]) -> None:
    """Write `files`, their texts by name, into a `folder`."""
    for name, text in files.items():
        with (folder / name).open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            settle(stream.fileno())


def _float_error(folder: Path, name: str) -> float:
    """Measure the largest error of the trace in floats, as a share of the range."""
    with tempfile.TemporaryDirectory() as work:
        program, sources = str(Path(work) / "check"), [file_of(file, name) for file in SOURCES]
        run([_COMPILER, *STRICT, "-O2", "check.c", *sources, "-o", program], folder)
        error = _MEASURED.search(run([program], folder))
    if error is None:
        raise FileFormatError("check.c: did not print the error of floats; install dehyst again")
    return float(error[1])


def _readme(compensator: Compensator, number: Number, trace: GoldenTrace, result: Exported, own: str) -> str:
    low, high = compensator.limits
    period, slew, ahead = compensator.period, compensator.slew_rate, compensator.samples_ahead
    start, tables = ExportedStart.of(compensator), compensator.tables()
    text = shipped("README.md")
    if own != DEFAULT:
        # The variable of the example must not have the name of its type.
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
        begins=start.words,
        way=start.way,
        bytes=text_of(_bytes(result), own),
        rows=len(trace.rows),
        error=_error_words(number, result),
        config="" if number == "double" else ", with floats in `dehyst_config.h`",
    )


def _error_words(number: Number, result: Exported) -> str:
    if number == "double":
        return ": the same bits"
    if result.error is None:
        return f"; the error was not\n{_INDENT}measured, it must be below {_UNMEASURED:.0e} of the range"
    most = f"{_MARGIN * result.error:.1e}"
    return (
        f"; errors are at most {result.error:.1e}\n{_INDENT}of the range and must lie between {_LEAST:.0e} and {most}"
    )


def _bytes(result: Exported) -> str:
    return bytes_table(result.footprints, result.unmeasured)


def bytes_table(footprints: dict[str, Footprint], unmeasured: str | None) -> str:
    """Return the bytes of an export by processor as Markdown, and why some are `unmeasured`."""
    if unmeasured is not None:
        left_out = (
            f"Not measured on this computer: {unmeasured}. To measure it later: "
            "`dehyst.exports.sizes(folder, compiler)`."
        )
        return left_out if not footprints else f"{left_out}\n\n{_table(footprints)}"
    return _table(footprints)


def _table(footprints: dict[str, Footprint]) -> str:
    rows = (f"| {name} | {size.flash} | {size.ram} | {size.stack or 'unknown'} |" for name, size in footprints.items())
    head = ("| bytes | flash | RAM for one `piezo` | stack |", "| --- | --- | --- | --- |")
    return "\n".join([*head, *rows, *_TABLE_NOTES])
