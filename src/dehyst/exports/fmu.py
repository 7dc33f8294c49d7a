"""A compensator or its actuator as an FMU: C sources, and a binary for Linux x86-64."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import shutil
import sys
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import get_args

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import PathLike, demand_alike, path_of, write_atomically
from dehyst._version import __version__
from dehyst.control import Compensator
from dehyst.exports.firmware import SOURCES, code
from dehyst.exports.fmu_description import Description, Kind, Version
from dehyst.exports.footprint import run
from dehyst.exports.model_header import demand_compensator
from dehyst.exports.naming import shipped

_WRAPPERS = {"2.0": ("fmi2.h", "fmi2.c"), "3.0": ("fmi3.h", "fmi3.c", "fmi3_absent.c")}
_BINARY = {"2.0": "binaries/linux64", "3.0": "binaries/x86_64-linux"}
_SOURCE = "all.c"
# Not Python's file times: the same model gives the same file.
_TIME = (1980, 1, 1, 0, 0, 0)
# Limits that no voltage meets.
_NONE = -1e300, 1e300
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-s")


class SourceOnlyWarning(UserWarning):
    """An FMU was written without a binary: the importing program must compile it."""


class _NoBinaryError(Exception):
    """The reason why no binary could be built."""


def export_fmu(
    compensator: Compensator,
    path: PathLike,
    version: Version = "3.0",
    kind: Kind = "compensator",
) -> None:
    """Write an FMU for co-simulation, which starts from the state in which the compensator was made or last reset.

    Its step is the compensator's period, or a whole multiple of it, over which the input is held; without a period any
    step is one sample. An input at the beginning of a step takes effect by its end, when the output may be read.

    Parameters
    ----------
    compensator : Compensator
    path : path
        Ends in .fmu.
    version : {"3.0", "2.0"}, optional
        Version of FMI.
    kind : {"compensator", "actuator"}, optional
        Displacement [m] in and voltage [V] out, with the numbers of clamped samples; or the virtual actuator, voltage
        in and displacement out, without limits.

    Raises
    ------
    ModelError
        If it is no Compensator, the version or the kind is none of these, or it lacks a period that it needs.
    FileFormatError
        If the file cannot be written, or its name does not end in .fmu.

    Warns
    -----
    SourceOnlyWarning
        If there is no C compiler, it fails, or this is not Linux on x86-64: the FMU then holds sources only.
    """
    demand_compensator(compensator)
    for name, value, known in (("version", version, get_args(Version)), ("kind", kind, get_args(Kind))):
        if value not in known:
            raise ModelError(argument=name, got=repr(value), need=" or ".join(map(repr, known)))
    if path_of(path).suffix != ".fmu":
        raise FileFormatError(f"{path}: the name of an FMU ends in .fmu; change it")
    demand_alike(path)
    if kind == "actuator":
        # The same actuator in the same state, for any voltage.
        state = compensator.asked_start
        compensator = Compensator(compensator.actuator, _NONE, period=compensator.period, state=state)
    description = Description.of(compensator, version, kind)
    sources = _sources(compensator, version)
    token = _token(sources, version, kind)
    sources["fmu_model.h"] = _model(token, description)
    texts = {"modelDescription.xml": description.xml(token, _SOURCE)}
    texts |= {f"sources/{name}": text for name, text in sources.items()}
    if version == "3.0":
        texts["sources/buildDescription.xml"] = description.build_xml(_SOURCE)
    texts |= {"documentation/index.html": description.page(), "documentation/licenses/license.txt": shipped("LICENSE")}
    content = {name: text.encode() for name, text in texts.items()}
    try:
        content[f"{_BINARY[version]}/{description.identifier}.so"] = _compiled(sources)
    except _NoBinaryError as reason:
        warnings.warn(
            f"the FMU holds sources, but no binary: {reason}. Install gcc and export it again, or let the program that "
            "imports it compile it",
            SourceOnlyWarning,
            2,
        )
    write_atomically(path, _zipped(content))


def _sources(compensator: Compensator, version: Version) -> dict[str, str]:
    """Return the contents of `sources/`, without the file that holds the token."""
    wrapper = ("fmu.h", "fmu.c", *_WRAPPERS[version])
    units = (*SOURCES, *(name for name in wrapper if name.endswith(".c")))
    every = shipped("fmu_all.c") + "".join(f'#include "{name}"\n' for name in units)
    return {**code(compensator), **{name: shipped(name) for name in wrapper}, _SOURCE: every}


def _token(sources: Mapping[str, str], version: Version, kind: Kind) -> str:
    digest = hashlib.sha256(f"{version} {kind} {__version__}".encode())
    for name, text in sources.items():
        digest.update(f"\n{name} {len(text)}\n{text}".encode())
    return f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}"


def _model(token: str, description: Description) -> str:
    """Return the text of `fmu_model.h`."""
    name = next(variable.name for variable in description.variables if variable.causality == "input")
    return (
        "#ifndef FMU_MODEL_H\n#define FMU_MODEL_H\n\n"
        f"#define FMU_ACTUATOR {int(description.kind == 'actuator')}\n"
        f'#define FMU_TOKEN "{token}"\n#define FMU_INPUT_NAME "{name}"\n\n#endif\n'
    )


def _compiled(sources: Mapping[str, str]) -> bytes:
    """Compile the shared library."""
    compiler = os.environ.get("CC") or next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    if not sys.platform.startswith("linux") or platform.machine() != "x86_64":
        raise _NoBinaryError("binaries are built on Linux x86-64 only")
    if compiler is None:
        raise _NoBinaryError("no C compiler is installed")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, text in sources.items():
            (folder / file).write_text(text, encoding="utf-8")
        try:
            run([*compiler.split(), *_FLAGS, _SOURCE, "-o", "fmu.so"], folder)
        except FileFormatError as error:
            raise _NoBinaryError(str(error)) from error
        return (folder / "fmu.so").read_bytes()


def _zipped(content: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, _TIME)
            # The description shows at the file's beginning which program wrote it.
            stored = name == "modelDescription.xml"
            entry.compress_type, entry.create_system = zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED, 3
            entry.external_attr = (0o100755 if name.endswith(".so") else 0o100644) << 16
            archive.writestr(entry, data)
    return stream.getvalue()
