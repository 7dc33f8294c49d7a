"""A compensator or its actuator as an FMU: its description, C sources, and a binary for Linux x86-64."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import shutil
import sys
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Literal, NamedTuple, TypeAlias, get_args
from xml.etree import ElementTree

from dehyst._errors import FileFormatError, ModelError
from dehyst._io import PathLike, demand_alike, path_of, write_atomically
from dehyst._version import __version__
from dehyst.control import Compensator
from dehyst.exports.firmware import SOURCES, code
from dehyst.exports.footprint import run
from dehyst.exports.model_header import ExportedStart, demand_compensator
from dehyst.exports.naming import printable, shipped

Version: TypeAlias = Literal["2.0", "3.0"]
Kind: TypeAlias = Literal["compensator", "actuator"]

_UNITS = {"s": {"s": 1}, "m": {"m": 1}, "V": {"kg": 1, "m": 2, "s": -3, "A": -1}}
_LONGEST = 60

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
        state = compensator.initial_state
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


class Variable(NamedTuple):
    """A variable of an FMU; its index in the list is its value reference. Without a unit it is an integer."""

    name: str
    causality: Literal["independent", "input", "output"]
    unit: str
    description: str
    start: float | None = None
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Description:
    """An FMU of a compensator, or of its actuator.

    Attributes
    ----------
    version, kind : str
        As in `export_fmu`.
    name, identifier : str
        The actuator's and the kind, as text and as a name in C.
    summary : str
        A sentence or two.
    period : float
        Seconds; 0: it does not depend on time.
    variables : tuple of Variable
    """

    version: Version
    kind: Kind
    name: str
    identifier: str
    summary: str
    period: float
    variables: tuple[Variable, ...]

    @classmethod
    def of(cls, compensator: Compensator, version: Version, kind: Kind) -> Description:
        """Describe it as it was when made or last reset."""
        period, words = compensator.period or 0.0, printable(compensator.actuator.name)
        pace = f"One step every {period!r} s." if period else "It does not depend on time: any step is one sample."
        make = _compensator if kind == "compensator" else _actuator
        summary, variables = make(compensator, words)
        slug = re.sub(r"\W+", "_", words, flags=re.ASCII).strip("_")[:_LONGEST] or "piezo"
        twice = slug == kind
        return cls(
            version,
            kind,
            words if twice else f"{words}, {kind}",
            f"dehyst_{slug}" if twice else f"dehyst_{slug}_{kind}",
            f"{summary} {pace}",
            period,
            (Variable("time", "independent", "s", "Simulation time"), *variables),
        )

    @property
    def outputs(self) -> tuple[int, ...]:
        """Value references of the outputs."""
        return tuple(i for i, variable in enumerate(self.variables) if variable.causality == "output")

    def xml(self, token: str, source: str) -> str:
        """Text of `modelDescription.xml`.

        `token`: GUID or instantiation token. `source`: the file to compile.
        """
        root = ElementTree.Element(
            "fmiModelDescription",
            {
                "fmiVersion": self.version,
                "modelName": self.name,
                "guid" if self.version == "2.0" else "instantiationToken": token,
                "description": self.summary,
                "generationTool": f"dehyst {__version__}",
                "variableNamingConvention": "flat",
            },
        )
        if self.version == "2.0":
            _fill_2(root, self, source)
        else:
            _fill_3(root, self)
        return _text(root)

    def build_xml(self, source: str) -> str:
        """Text of FMI 3.0's `sources/buildDescription.xml`."""
        root = ElementTree.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
        configuration = _add(root, "BuildConfiguration", modelIdentifier=self.identifier)
        files = _add(configuration, "SourceFileSet", language="C99")
        _add(files, "SourceFile", name=source)
        return _text(root)

    def page(self) -> str:
        """Return the HTML page."""
        rows = [
            f"<tr><td>{variable.name}</td><td>{variable.causality}</td><td>{variable.unit}</td><td>{escape(variable.description)}</td></tr>"
            for variable in self.variables
        ]
        head = (
            '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
            f"<title>{escape(self.name)}</title></head><body>\n"
            f"<h1>{escape(self.name)}</h1>\n<p>{escape(self.summary)}</p>"
        )
        columns = "<table><tr><th>variable</th><th></th><th>unit</th><th></th></tr>"
        end = f"</table>\n<p>Made by dehyst {__version__}; its licence is in licenses/.</p></body></html>\n"
        return "\n".join([head, columns, *rows, end])


def _compensator(compensator: Compensator, name: str) -> tuple[str, tuple[Variable, ...]]:
    (low, high), ahead = compensator.limits, compensator.samples_ahead
    when = f"in {ahead} steps" if ahead else "at the end of the step"
    summary = f"Voltage, {low!r} V to {high!r} V, that makes the actuator '{name}' follow a displacement."
    if compensator.slew_rate is not None:
        summary += f" Slew rate at most {compensator.slew_rate!r} V/s."
    y = ExportedStart.of(compensator).displacement
    return summary, (
        Variable("displacement", "input", "m", f"Displacement wanted {when}", y),
        Variable("voltage", "output", "V", "Voltage to be reached at the end of the step", range=(low, high)),
        Variable("limited", "output", "", "Samples whose voltage was cut at a limit"),
        Variable("slewed", "output", "", "Samples whose voltage was held back by the slew rate"),
    )


def _actuator(compensator: Compensator, name: str) -> tuple[str, tuple[Variable, ...]]:
    v = ExportedStart.of(compensator).voltage
    return f"The actuator '{name}': displacement that a voltage causes.", (
        Variable("voltage", "input", "V", "Voltage reached at the end of a step's first period, then held", v),
        Variable("displacement", "output", "m", "Displacement"),
    )


def _fill_2(root: ElementTree.Element, description: Description, source: str) -> None:
    features = {"canHandleVariableCommunicationStepSize": _flag(not description.period)}
    features |= dict.fromkeys(
        ("canNotUseMemoryManagementFunctions", "canGetAndSetFMUstate", "canSerializeFMUstate"), "true"
    )
    interface = _add(root, "CoSimulation", modelIdentifier=description.identifier, **features)
    _add(_add(interface, "SourceFiles"), "File", name=source)
    _fill_common(root, description)
    variables = _add(root, "ModelVariables")
    for reference, variable in enumerate(description.variables):
        attributes = {"name": variable.name, "valueReference": str(reference)} | _roles(variable)
        scalar = _add(variables, "ScalarVariable", description=variable.description, **attributes)
        if variable.unit:
            _add(scalar, "Real", unit=variable.unit, **_numbers(variable))
        else:
            _add(scalar, "Integer")
    structure = _add(root, "ModelStructure")
    for part in ("Outputs", "InitialUnknowns"):
        unknowns = _add(structure, part)
        for reference in description.outputs:
            _add(unknowns, "Unknown", index=str(reference + 1), dependencies="")


def _fill_3(root: ElementTree.Element, description: Description) -> None:
    features = {"canHandleVariableCommunicationStepSize": _flag(not description.period)}
    features |= dict.fromkeys(("canGetAndSetFMUState", "canSerializeFMUState"), "true")
    if description.period:
        features["fixedInternalStepSize"] = repr(description.period)
    _add(root, "CoSimulation", modelIdentifier=description.identifier, **features)
    _fill_common(root, description)
    variables = _add(root, "ModelVariables")
    for reference, variable in enumerate(description.variables):
        attributes = {"name": variable.name, "valueReference": str(reference)} | _roles(variable)
        if variable.unit:
            attributes |= {"unit": variable.unit} | _numbers(variable)
        _add(variables, "Float64" if variable.unit else "UInt64", description=variable.description, **attributes)
    structure = _add(root, "ModelStructure")
    for part in ("Output", "InitialUnknown"):
        for reference in description.outputs:
            _add(structure, part, valueReference=str(reference), dependencies="")


def _fill_common(root: ElementTree.Element, description: Description) -> None:
    units = _add(root, "UnitDefinitions")
    for name, base in _UNITS.items():
        exponents = {symbol: str(power) for symbol, power in base.items()}
        _add(_add(units, "Unit", name=name), "BaseUnit", **exponents)
    categories = _add(root, "LogCategories")
    _add(categories, "Category", name="logStatusError", description="What was refused, and why")
    _add(categories, "Category", name="logStatusWarning", description="The first sample that is clamped")
    step = {"stepSize": repr(description.period)} if description.period else {}
    _add(root, "DefaultExperiment", startTime="0", **step)


def _roles(variable: Variable) -> dict[str, str]:
    roles = {"causality": variable.causality, "variability": "continuous" if variable.unit else "discrete"}
    return roles | {"initial": "calculated"} if variable.causality == "output" else roles


def _numbers(variable: Variable) -> dict[str, str]:
    numbers = {} if variable.range is None else {"min": repr(variable.range[0]), "max": repr(variable.range[1])}
    return numbers if variable.start is None else numbers | {"start": repr(variable.start)}


def _add(parent: ElementTree.Element, tag: str, **attributes: str) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, attributes)


def _flag(value: bool) -> str:
    return "true" if value else "false"


def _text(root: ElementTree.Element) -> str:
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"
