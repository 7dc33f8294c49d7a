"""`export`: one function for all kinds of exports, which it chooses by suffix from a table."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import PathLike, path_of
from dehyst.control import Compensator
from dehyst.exports.firmware import write_c
from dehyst.exports.fmu import ANY_VOLTAGE, write_fmu
from dehyst.exports.model_header import Number
from dehyst.exports.wasm import wasm_files, write_wasm
from dehyst.model import Actuator, Stage

Source: TypeAlias = Compensator | Actuator | Stage
# The suffix of a file; the name of a folder such as "piezo-1.5" has none.
_OF_A_FILE = re.compile(r"\.[A-Za-z][A-Za-z0-9]{0,4}")


class Target(NamedTuple):
    """A kind of export.

    `words`: its name in messages. `write`: function that writes a compensator to a path, with keywords of `options`.
    `options`: options of the command that only some kinds have. `files`: function that returns all files of a path;
    None for a folder, as its `write` returns them.
    """

    words: str
    write: Callable[..., list[Path] | None]
    options: tuple[str, ...] = ()
    files: Callable[[Path], list[Path]] | None = lambda path: [path]


# Kinds by suffix; a path without the suffix of a file is a folder of C.
TARGETS = {
    "": Target("C", write_c, ("number", "name"), None),
    ".wasm": Target("WebAssembly", write_wasm, (), wasm_files),
    ".fmu": Target("an FMU", write_fmu, ("kind",)),
}


def target_of(path: Path, *, coupled: bool = False) -> Target:
    """Return the kind of export for a path, C for `coupled` axes; raise FileFormatError for an unknown suffix."""
    target = TARGETS[""] if coupled else TARGETS.get(path.suffix, TARGETS[""])
    if target.files is None and _OF_A_FILE.fullmatch(path.suffix) and not path.is_dir():
        files = " or ".join(suffix for suffix in TARGETS if suffix)
        need = "a folder for several axes" if coupled else f"a folder for C, or a file that ends in {files}"
        raise FileFormatError(f"{path}: ends in {path.suffix}, need {need}; change the name")
    return target


def export(
    source: Source, target: PathLike, number: Number = "double", *, name: str | None = None, period: float | None = None
) -> Path:
    """Write a compensator, or a model, in the form that the suffix of `target` names.

    - A folder: C for a microcontroller, which computes the bits of Python. Six files go into a firmware: the core,
      `dehyst.c`, `dehyst.h` and `dehyst_model.h`, byte for byte as Python runs it; the number type,
      `dehyst_config.h`; and the model, NAME.c and NAME.h. The folder also holds a golden trace, which ``make check``
      replays, and a README. It is written whole, or not at all.
    - FILE.wasm: WebAssembly with the same bits; beside it the JavaScript module that calls it, and its types.
    - FILE.fmu: an FMU for co-simulation (FMI 2.0). A compensator has displacement [m] in and voltage [V] out. An
      actuator has voltage in and displacement out, without limits. A step is the period or a whole multiple of it, with
      a constant input; without a period, any step is one sample.

    Parameters
    ----------
    source : Compensator, Actuator or Stage
        A compensator is exported in its state at construction or last reset, and does not change. For a model, the
        export is a compensator within its limits, or as an FMU the model itself, from its state. Several axes are
        exported as C only.
    target : path
        Files of the same names are replaced; other files in a folder stay.
    number : {'double', 'float'}, optional
        Number type of C. For float, every number is rounded once. Coupled axes need double.
    name : str, optional
        Name in C of the type, the calls, macros and files, so that several models fit into one firmware; by default
        piezo, for several axes stage.
    period : float, optional
        Time between steps [s] of a model; a compensator already has a period.

    Returns
    -------
    Path
        The target.

    Raises
    ------
    ModelError
        If `source` cannot be exported in this form, a required period is missing, floats cannot hold the model, an
        option does not belong to this form, or the name is not valid in C or already has a meaning there.
    FileFormatError
        If `target` is not a path, has another suffix, or cannot be written.

    Warns
    -----
    SourceOnlyWarning
        If an FMU holds sources only, because no C compiler is found, it fails, or the system is not Linux on x86-64.
    """
    written(source, target, number, name, period)
    return path_of(target)


def written(source: Source, target: PathLike, number: Number, name: str | None, period: float | None) -> list[Path]:
    """Write an export, see `export`, and return its files."""
    path = path_of(target)
    coupled = isinstance(source.model if isinstance(source, Compensator) else source, Stage)
    row = target_of(path, coupled=coupled)
    itself = isinstance(source, Actuator) and "kind" in row.options
    given = {"number": None if number == "double" else number, "name": name, "kind": "actuator" if itself else None}
    options: dict[str, Any] = {option: value for option, value in given.items() if value is not None}
    for option, value in options.items():
        if option not in row.options:
            raise ModelError(argument=option, got=repr(value), need=f"none for {row.words}; only C has one")
    files = row.write(_loop_of(source, period, ANY_VOLTAGE if itself else None), path, **options)
    return files or (row.files(path) if row.files is not None else [])


def _loop_of(source: Source, period: float | None, limits: tuple[float, float] | None) -> Compensator:
    """Return a compensator unchanged, or make one from a model; `limits` [V]: limits for an actuator."""
    if isinstance(source, Actuator | Stage):
        return Compensator(source, limits, period=period)
    if period is not None:
        raise ModelError(argument="period", got=repr(period), need="none, as a compensator already has one")
    return source
