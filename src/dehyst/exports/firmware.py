"""A compensator of one or several axes as a folder of C: the core that Python runs, and the numbers of the model."""

from __future__ import annotations

import shutil
from itertools import accumulate
from pathlib import Path
from string import Template

import numpy as np

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import draft_of, settle, settle_folder, unwritten
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.control import Axis, Compensator, only_axis
from dehyst.exports.golden_trace import golden_trace, trace_header
from dehyst.exports.model_header import ExportedStart, ModelText, Number, config_header
from dehyst.exports.naming import DEFAULT, demand_name, printable, shipped, text_of
from dehyst.model import Stage

STAGE_NAME = "stage"
SOURCES = ("piezo.c", "dehyst.c")
CORE = ("dehyst.c", "dehyst.h", "dehyst_model.h")
CONFIG = "dehyst_config.h"
# Files beside the sources: for the targets of `make`, and the deviations from MISRA C.
BESIDE = ("Makefile", "worst.c", "start.S", "board.ld", "MISRA.md")
# Lines of the templates that generated text replaces.
_SIZES, _NUMBERS, _TEMPERATURE = "/* sizes */\n", "/* numbers */\n", "/* temperature */\n"
_TEMPERATURES_DECLARED = """\
/* Set gain and offset of the displacements for the temperature of each actuator [degC], between two periods. Before the
 * first call the reference temperatures apply. If it does not return DEHYST_OK, nothing changes. */
dehyst_status piezo_temperature(piezo *p, const dehyst_real degrees[PIEZO_AXES]);
"""
_TEMPERATURES_DEFINED = """
dehyst_status piezo_temperature(piezo *p, const dehyst_real degrees[PIEZO_AXES])
{
    dehyst_status status = DEHYST_OK;
    dehyst_loop trial;
    int j;
    /* All axes are tried on a copy first, so that an error changes no axis. */
    for (j = 0; j < 2 * PIEZO_AXES && status == DEHYST_OK; j++) {
        const int axis = j % PIEZO_AXES;
        const dehyst_real kelvins = degrees[axis] - thermal[axis][2];
        status = dehyst_loop_scale(j < PIEZO_AXES ? &trial : &p->loop[axis], 1 + thermal[axis][0] * kelvins,
                                   thermal[axis][1] * kelvins);
    }
    return status;
}
"""
# Bounds of the error of floats, as a share of the range. A smaller error shows that doubles are still in use.
_LEAST, _MOST = 1e-9, 1e-3
_AHEAD = "\n        /* Give each displacement {ahead} samples before its time, PIEZO_AHEAD. */"
_SMOOTH = """

Wanted displacements must be smooth, without jumps, corners or noise: the compensation of delays uses differences
between samples, which amplify them. Voltages stay within the limits in any case.
"""


def code(compensator: Compensator, number: Number = "double", name: str | None = None) -> dict[str, str]:
    """Return the C files of a compensator by name: `SOURCES` and their headers, as `export` writes them.

    Raise `ModelError` if `compensator` is not a Compensator, the number type is invalid, floats cannot hold this model,
    or the name is not a valid name in C or already has a meaning there.
    """
    coupled = _coupled(compensator)
    if number not in ("double", "float") or (coupled and number == "float"):
        need = "'double' for coupled axes" if coupled else "'double' or 'float'"
        raise ModelError(argument="number", got=repr(number), need=need)
    own = _name(compensator, name)
    demand_name(own)
    if coupled:
        kind, title, templates = "stage", compensator.stage.name, ("stage.h", "stage.c")
        macros, numbers = _coupled_numbers(compensator)
        declared, defined = _coupled_temperature(compensator)
    else:
        axis = only_axis(compensator)
        kind, title, templates = "actuator", axis.actuator.name, ("piezo.h", "piezo.c")
        text = ModelText(axis, number)
        macros, numbers = text.macros(), text.numbers()
        declared, defined = text.temperature()
    # The name of the actuator must not be renamed by `text_of`, and must not end the comment.
    title = printable(title).replace("*/", "* /").replace("/*", "/ *")
    title = f"/* The {kind} '{title}', made by dehyst {__version__}. Units: V, m, s. Do not edit. */\n"
    header, source = map(shipped, templates)
    header, source = header.replace(_TEMPERATURE, declared), source.replace(_TEMPERATURE, defined)
    own_files = {
        f"{own}.c": title + text_of(source.replace(_NUMBERS, numbers), own),
        f"{own}.h": title + text_of(header.replace(_SIZES, macros), own),
    }
    return {**{file: shipped(file) for file in CORE}, CONFIG: config_header(number), **own_files}


def _coupled(compensator: object) -> bool:
    """Return whether a compensator is one of a stage."""
    return isinstance(compensator, Compensator) and isinstance(compensator.model, Stage)


def _name(compensator: Compensator, name: str | None) -> str:
    """Return the name in C: the given name, or the default name."""
    return name if name is not None else STAGE_NAME if _coupled(compensator) else DEFAULT


def _coupled_numbers(compensator: Compensator) -> tuple[str, str]:
    """Return the macros and the numbers of several axes: numbers of each axis, and the matrices."""
    for name, axis in zip(compensator.stage.axes, compensator._axes, strict=True):
        if axis.actuator.displacement_creep is not None:
            raise ModelError(
                f"axis {name} has creep in displacement, which an export of coupled axes does not compute",
                hint="export the actuator of each axis alone, or leave creep out",
            )
    texts = [ModelText(axis, "double") for axis in compensator._axes]
    ends, count = list(accumulate(text.memory for text in texts)), len(texts)
    macros = {
        "AXES": count,
        "PERIOD": repr(compensator.period or 0.0),
        "MEMORY": ends[-1],
    }
    numbers = [text_of(text.numbers(), f"axis{j}") for j, text in enumerate(texts)]
    numbers.append(_table("decoupling", "PIEZO_AXES", compensator.stage.decoupling))
    numbers.append(_table("coupling", "PIEZO_AXES", compensator.stage.coupling))
    models = ", ".join(f"&axis{j}_model" for j in range(count))
    numbers += [
        f"static const dehyst_model *const models[PIEZO_AXES] = {{{models}}};",
        "/* Index at which the memory of each axis begins. */",
        f"static const int begins[PIEZO_AXES] = {{{', '.join(map(str, [0, *ends[:-1]]))}}};\n",
    ]
    return "".join(f"#define PIEZO_{name} {value}\n" for name, value in macros.items()), "\n".join(numbers)


def _coupled_temperature(compensator: Compensator) -> tuple[str, str]:
    """Return declaration and definition of the call that takes the temperatures of several axes; or empty texts."""
    thermals = [actuator.thermal for actuator in compensator.stage.actuators]
    if not any(thermals):
        return "", ""
    numbers = [(part.gain, part.offset, part.reference) if part else (0.0, 0.0, 0.0) for part in thermals]
    return _TEMPERATURES_DECLARED, f"\n{_table('thermal', '3', np.array(numbers))}{_TEMPERATURES_DEFINED}"


def _table(name: str, columns: str, numbers: Array) -> str:
    """Return a table in C with a row for each axis."""
    rows = ",\n    ".join("{" + ", ".join(value.hex() for value in row) + "}" for row in numbers.tolist())
    return f"static const dehyst_real {name}[PIEZO_AXES][{columns}] = {{\n    {rows}}};\n"


def write_c(compensator: Compensator, folder: Path, number: Number = "double", name: str | None = None) -> list[Path]:
    """Write a compensator as C, see `dehyst.export`, a whole folder or nothing; return its files."""
    files, own = code(compensator, number, name), _name(compensator, name)
    check = "stage_check.c" if _coupled(compensator) else "check.c"
    files |= {"check.c": text_of(shipped(check), own), "LICENSE": shipped("LICENSE")}
    files |= {file: text_of(shipped(file), own) for file in BESIDE}
    target = folder.resolve()
    draft = draft_of(target)
    try:
        _demand_place(folder)
        draft.mkdir()
        trace = golden_trace(compensator)
        files["trace.h"] = trace_header(trace, _LEAST, _MOST)
        files["README.md"] = _readme(compensator, number, len(trace.rows), own)
        _write(draft, files)
        _put(draft, target)
        return [folder / file for file in sorted(files)]
    except OSError as error:
        raise unwritten(folder, error) from error
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _demand_place(folder: Path) -> None:
    """Refuse a file, and a folder whose parent does not exist."""
    if not folder.resolve().parent.is_dir():
        raise FileFormatError(f"{folder}: the folder {folder.parent} does not exist; create it first")
    if folder.exists() and not folder.is_dir():
        raise FileFormatError(f"{folder}: is a file, need the name of a folder")


def _put(draft: Path, target: Path) -> None:
    """Move the draft to the target, or its files into a target folder that exists."""
    settle_folder(draft)
    if target.exists():
        for path in draft.iterdir():
            path.replace(target / path.name)
        settle_folder(target)
    else:
        draft.rename(target)
    settle_folder(target.parent)


def _write(folder: Path, files: dict[str, str]) -> None:
    """Write `files` (text by name) into a `folder`."""
    for name, text in files.items():
        with (folder / name).open("w", encoding="utf-8", newline="\n") as stream:
            stream.write(text)
            stream.flush()
            settle(stream.fileno())


def _readme(compensator: Compensator, number: Number, rows: int, own: str) -> str:
    period = compensator.period
    words: dict[str, object] = {
        "version": __version__,
        "every": "a sample" if period is None else f"every {period:.9g} s",
        "rows": rows,
    }
    if _coupled(compensator):
        template = "stage_README.md"
        words |= {
            "name": printable(compensator.stage.name),
            "count": len(compensator._axes),
            "axes": ", ".join(compensator.stage.axes),
            "table": "\n".join(map(_axis_row, compensator.stage.axes, compensator._axes)),
        }
    else:
        template = "README.md"
        words |= _axis_words(only_axis(compensator), number, own)
    return Template(text_of(shipped(template), own)).substitute(words)


def _axis_row(name: str, axis: Axis) -> str:
    """Return the row of an axis in the table of the README."""
    (low, high), start = axis.limits, ExportedStart.of(axis)
    slew = "not limited" if axis.slew_rate is None else f"{axis.slew_rate:.9g} V/s"
    return f"| {name} | {low:.9g} to {high:.9g} | {slew} | {start.words}: {start.way} |"


def _axis_words(axis: Axis, number: Number, own: str) -> dict[str, object]:
    """Return the words of the README for a single axis."""
    low, high = axis.limits
    period, slew, ahead = axis.period, axis.slew_rate, axis.preview[1]
    start = ExportedStart.of(axis)
    timer = "this model does not depend on time" if period is None else f"every {period:.9g} s, PIEZO_PERIOD"
    bound = ": the same bits" if number == "double" else f", with errors below {_MOST:.0e} of the range"
    return {
        "name": printable(axis.actuator.name),
        "number": number,
        "timer": text_of(timer, own),
        "low": f"{low:.9g}",
        "high": f"{high:.9g}",
        "slew": "" if slew is None else f" and change by {slew:.9g} V/s at most",
        "ahead": text_of(_AHEAD.format(ahead=ahead), own) if ahead else "",
        "smooth": _SMOOTH if axis.preview[0].size > 1 or axis.actuator.lag else "",
        "begins": start.words,
        "way": start.way,
        "error": bound,
        "config": "" if number == "double" else ", with floats in `dehyst_config.h`",
    }
