"""A compensator of one axis or of several as a folder of C: the core that Python runs, and the numbers of the model."""

from __future__ import annotations

import re
import shutil
import tempfile
from pathlib import Path
from string import Template
from typing import NamedTuple

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import PathLike, draft_of, path_of, settle, settle_folder, unwritten
from dehyst._version import __version__
from dehyst.control import Compensator, StageCompensator
from dehyst.exports.coupling import coupled_sources, labels
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
from dehyst.exports.golden_trace import GoldenTrace, Loop, golden_trace, trace_header
from dehyst.exports.model_header import (
    NUMBERS,
    SIZES,
    ExportedStart,
    Number,
    config_header,
    demand_compensator,
    numbers,
    size_macros,
)
from dehyst.exports.naming import DEFAULT, demand_name, file_of, in_comment, name_in, printable, shipped, text_of

__all__ = ["SOURCES", "Exported", "Footprint", "code", "export", "sizes"]

STAGE_NAME = "stage"
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


def code(compensator: Loop, number: Number = "double", name: str | None = None) -> dict[str, str]:
    """Return the C files of a compensator by name: `SOURCES` and their headers, as `export` writes them.

    Raise `ModelError` if it is no Compensator, the number type is another one, floats cannot hold this model, or the
    name is no name in C or has a meaning there.
    """
    coupled = isinstance(compensator, StageCompensator)
    if not coupled:
        demand_compensator(compensator)
    if number not in ("double", "float") or (coupled and number == "float"):
        need = "'double', of coupled axes" if coupled else "'double' or 'float'"
        raise ModelError(argument="number", got=repr(number), need=need)
    own = _name(compensator, name)
    demand_name(own)
    files = {file: shipped(file) for file in CORE} | {CONFIG: config_header(number)}
    if isinstance(compensator, StageCompensator):
        title = f"stage '{in_comment(compensator.stage.name)}'"
        source, header = coupled_sources(compensator, own)
    else:
        title = f"actuator '{in_comment(compensator.actuator.name)}'"
        source, header = (
            text_of(shipped(file).replace(place, generated(compensator, number)), own)
            for file, place, generated in (("piezo.c", NUMBERS, numbers), ("piezo.h", SIZES, size_macros))
        )
    # The actuator's name is not to be renamed.
    title = f"/* The {title}, made by dehyst {__version__}. Units: V, m, s. Do not edit. */\n"
    return files | {f"{own}.c": title + source, f"{own}.h": title + header}


def _name(compensator: Loop, name: str | None) -> str:
    """Return the name in C: the one given, or the usual one."""
    if name is not None:
        return name
    return STAGE_NAME if isinstance(compensator, StageCompensator) else DEFAULT


def export(
    compensator: Loop,
    directory: PathLike,
    number: Number = "double",
    *,
    force: bool = False,
    name: str | None = None,
    measure: bool = True,
) -> Exported:
    """Write a compensator as C: the whole folder, or nothing.

    Six files go into a firmware: the core, `dehyst.c`, `dehyst.h` and `dehyst_model.h`, byte for byte the one that
    Python runs; `dehyst_config.h` with the number type; the model, `piezo.c` and `piezo.h`, with its numbers and calls.
    Those of a stage, stage.c and stage.h, have the coupling matrix and the numbers and calls of each axis. Beside
    them are a golden trace that ``make check`` replays, and a README with the usage and the bytes that it takes.

    Parameters
    ----------
    compensator : Compensator or StageCompensator
        The export has the state in which it was made or last reset. It does not change.
    directory : path
        A new or an empty folder.
    number : {'double', 'float'}, optional
        float: every number is rounded once; the error is measured if there is a compiler. Coupled axes have double.
    force : bool, optional
        Replace an earlier export. A folder with other files is always refused.
    name : str, optional
        Name in C of the type and the calls, by default piezo, or stage, so that several models fit into one firmware:
        the files of the model are then NAME.c and NAME.h, and macros begin with it.
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
    files, own = code(compensator, number, name), _name(compensator, name)
    check = "stage_check.c" if isinstance(compensator, StageCompensator) else "check.c"
    files |= {"check.c": text_of(shipped(check), own), "Makefile": text_of(shipped("Makefile"), own)}
    target = folder.resolve()
    draft = draft_of(target)
    try:
        _demand_free(folder, force)
        draft.mkdir()
        _write(draft, {**files, "LICENSE": shipped("LICENSE")})
        result = _complete(draft, compensator, number, own, measure)
        _put(draft, target)
    except OSError as error:
        raise unwritten(folder, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)
    return result._replace(folder=folder)


def _complete(draft: Path, compensator: Loop, number: Number, name: str, measure: bool) -> Exported:
    """Add the trace with its error bound and the README with the measured sizes, which need the other files."""
    trace = golden_trace(compensator)
    _write(draft, {"trace.h": trace_header(trace, _LEAST, _ANY)})
    result = Exported(draft, {}, None, None if measure else _UNASKED)
    if measure:
        result = _measured(result, number, name)
    if number == "float":
        most = _UNMEASURED if result.error is None else _MARGIN * result.error
        _write(draft, {"trace.h": trace_header(trace, _LEAST, most)})
    _write(draft, {"README.md": _readme(compensator, number, trace, result, name)})
    return result


def _measured(result: Exported, number: Number, name: str) -> Exported:
    """Add sizes and error by the compilers at hand, or the reason why they are missing."""
    error, reason, footprints = None, None, {}
    if number == "float":
        try:
            error = _float_error(result.folder, name)
        except FileFormatError as failure:
            reason = _reason(failure)
    for processor, (compiler, flags) in _PROCESSORS.items():
        # Its floating-point unit has floats only.
        if processor.startswith("Cortex-M4F") and number == "double":
            continue
        try:
            footprints[processor] = sizes(result.folder, compiler, flags)
        except FileFormatError as failure:
            reason = _reason(failure) if compiler == _COMPILER else reason
    return result._replace(footprints=footprints, error=error, unmeasured=reason)


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


def _write(folder: Path, files: dict[str, str]) -> None:
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


def _readme(compensator: Loop, number: Number, trace: GoldenTrace, result: Exported, own: str) -> str:
    period = compensator.period
    common = {
        "version": __version__,
        "every": "a sample" if period is None else f"every {period:.9g} s",
        "bytes": text_of(_bytes(result), own),
        "rows": len(trace.rows),
    }
    if isinstance(compensator, StageCompensator):
        template, more = "stage_README.md", _axes_words(compensator, own)
    else:
        template, more = "README.md", _axis_words(compensator, number, result, own)
    return Template(text_of(shipped(template), own)).substitute(common | more)


def _axes_words(compensator: StageCompensator, own: str) -> dict[str, object]:
    rows = []
    for axis, loop in zip(compensator.stage.axes, compensator.compensators, strict=True):
        low, high = loop.limits
        slew = "not limited" if loop.slew_rate is None else f"{loop.slew_rate:.9g} V/s"
        start = ExportedStart.of(loop)
        rows.append(f"| {axis} | {low:.9g} to {high:.9g} | {slew} | {start.words}: {start.way} |")
    return {
        "name": printable(compensator.stage.name),
        "count": len(rows),
        "axes": ", ".join(compensator.stage.axes),
        "table": "\n".join(rows),
        "example": f"{own}_{labels(compensator)[0]}_step",
    }


def _axis_words(compensator: Compensator, number: Number, result: Exported, own: str) -> dict[str, object]:
    low, high = compensator.limits
    period, slew, ahead = compensator.period, compensator.slew_rate, compensator.samples_ahead
    start = ExportedStart.of(compensator)
    timed = "this model does not depend on time"
    return {
        "name": printable(compensator.actuator.name),
        "number": number,
        "timer": timed if period is None else text_of(f"every {period:.9g} s, MODEL_PERIOD", own),
        "low": f"{low:.9g}",
        "high": f"{high:.9g}",
        "slew": "" if slew is None else f" and change by {slew:.9g} V/s at most",
        "ahead": text_of(_AHEAD.format(ahead=ahead), own) if ahead else "",
        "smooth": _SMOOTH if compensator.tables()["tap"].size > 1 or compensator.actuator.lag else "",
        "begins": start.words,
        "way": start.way,
        "error": _error_words(number, result),
        "config": "" if number == "double" else ", with floats in `dehyst_config.h`",
    }


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
    """Return the bytes by processor as Markdown, and why some are not measured."""
    left_out = (
        f"Not measured on this computer: {result.unmeasured}. To measure it later: "
        "`dehyst.exports.sizes(folder, compiler)`."
    )
    parts = [] if result.unmeasured is None else [left_out]
    if result.footprints or not parts:
        head = ("| bytes | flash | RAM for one `piezo` | stack |", "| --- | --- | --- | --- |")
        rows = (
            f"| {name} | {size.flash} | {size.ram} | {size.stack or 'unknown'} |"
            for name, size in result.footprints.items()
        )
        parts.append("\n".join([*head, *rows, *_TABLE_NOTES]))
    return "\n\n".join(parts)
