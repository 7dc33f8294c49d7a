"""A compensator or its actuator as an FMU: its description, C sources, and a binary for Linux x86-64."""

from __future__ import annotations

import hashlib
import io
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import uuid
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Literal, NamedTuple, TypeAlias
from xml.sax.saxutils import escape

from dehyst._errors import ModelError
from dehyst._io import write_atomically
from dehyst._version import __version__
from dehyst.control import Axis, Compensator, only_axis
from dehyst.exports.firmware import CONFIG, CORE
from dehyst.exports.model_header import ExportedStart, ModelText, config_header
from dehyst.exports.naming import printable, shipped

Kind: TypeAlias = Literal["compensator", "actuator"]

# Longest identifier; number of bytes of the model in a line.
_LONGEST, _A_LINE = 60, 24
# The only file to compile.
_SOURCE = "all.c"
# A fixed time for all files, so that the same model gives the same FMU.
_TIME = (1980, 1, 1, 0, 0, 0)
# Limits that no voltage reaches.
ANY_VOLTAGE = -1e300, 1e300
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-s")
_WRAPPER = ("fmu.h", "fmu.c", "fmi2.h", "fmi2.c")
_BINARIES = "binaries/linux64"
_VARIABLE = (
    '    <ScalarVariable description="{description}" name="{name}" valueReference="{reference}" '
    'causality="{causality}" {role}>\n      <{kind} />\n    </ScalarVariable>'
)


class SourceOnlyWarning(UserWarning):
    """An FMU was written without a binary: the importing program must compile it."""


class _NoBinaryError(Exception):
    """The reason why no binary could be built."""


def write_fmu(compensator: Compensator, path: Path, kind: Kind = "compensator") -> None:
    """Write an FMU of a compensator, or of its actuator, whose limits are then `ANY_VOLTAGE`; see `dehyst.export`."""
    axis = only_axis(compensator)
    if axis.actuator.thermal is not None:
        raise ModelError(
            "the actuator depends on temperature, for which an FMU has no input",
            hint="export it in C or WebAssembly, or leave out the part thermal and set the inputs gain and offset",
        )
    summary, variables = _interface(axis, kind)
    sources = _sources(axis, kind)
    digest = hashlib.sha256(f"2.0 {kind} {__version__}".encode())
    for name, text in sources.items():
        digest.update(f"\n{name} {len(text)}\n{text}".encode())
    token, given = f"{{{uuid.UUID(bytes=digest.digest()[:16])}}}", variables[1].name
    sources["fmu_model.h"] += f'#define FMU_TOKEN "{token}"\n#define FMU_INPUT_NAME "{given}"\n\n#endif\n'
    title, identifier = _names(axis.actuator.name, kind)
    texts = {"modelDescription.xml": _description(axis, title, identifier, token, summary, variables)}
    texts |= {f"sources/{name}": text for name, text in sources.items()}
    texts["documentation/licenses/license.txt"] = shipped("LICENSE")
    content = {name: text.encode() for name, text in texts.items()}
    try:
        content[f"{_BINARIES}/{identifier}.so"] = _compiled(sources)
    except _NoBinaryError as reason:
        warnings.warn(
            f"the FMU holds sources, but no binary: {reason}. Install gcc and export it again, or let the program that "
            "imports it compile it",
            SourceOnlyWarning,
            4,
        )
    write_atomically(path, _zipped(content))


def _sources(axis: Axis, kind: Kind) -> dict[str, str]:
    """Return the contents of `sources/`: the core, the FMI functions, and the model as a block of bytes."""
    block, text = axis.block(), ModelText(axis, "double")
    sizes = {
        "ACTUATOR": int(kind == "actuator"),
        "ROOM": text.room,
        "MEMORY": text.memory,
        "SNAPSHOT": text.snapshot,
    }
    macros = "".join(f"#define FMU_{name} {value}\n" for name, value in sizes.items())
    rows = ",\n".join(", ".join(map(str, block[i : i + _A_LINE])) for i in range(0, len(block), _A_LINE))
    units = ("dehyst.c", *(name for name in _WRAPPER if name.endswith(".c")))
    return {
        **{name: shipped(name) for name in (*CORE, *_WRAPPER)},
        CONFIG: config_header("double"),
        "fmu_block.h": f"static const unsigned char fmu_block[] = {{\n{rows}}};\n",
        "fmu_model.h": f"#ifndef FMU_MODEL_H\n#define FMU_MODEL_H\n\n{macros}",
        _SOURCE: shipped("fmu_all.c") + "".join(f'#include "{name}"\n' for name in units),
    }


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
        command = [*compiler.split(), *_FLAGS, _SOURCE, "-o", "fmu.so"]
        english = {**os.environ, "LC_ALL": "C"}
        try:
            done = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=300, env=english
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _NoBinaryError(f"{compiler} cannot be run ({error})") from error
        if done.returncode:
            lines = done.stderr.strip().splitlines() or [f"status {done.returncode}"]
            # A compiler prints places before it prints the error.
            errors = [line for line in lines if "error" in line.lower()]
            raise _NoBinaryError(f"{compiler} failed: {(errors or lines)[0]}")
        return (folder / "fmu.so").read_bytes()


def _zipped(content: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in content.items():
            entry = zipfile.ZipInfo(name, _TIME)
            # The description is stored uncompressed at the start of the file: it shows which program wrote it.
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


def _interface(axis: Axis, kind: Kind) -> tuple[str, list[Variable]]:
    """Return the description of an FMU in one or two sentences, and its variables: time, inputs and outputs."""
    words, begin = printable(axis.actuator.name), ExportedStart.of(axis)
    period, (low, high), ahead = axis.period, axis.limits, axis.preview[1]
    scaling = (
        Variable("gain", "input", "1", "Factor on the displacement, for another temperature or an aged actuator", 1.0),
        Variable("offset", "input", "m", "Added to the displacement", 0.0),
    )
    time = Variable("time", "independent", "s", "Simulation time")
    pace = f" One step every {period!r} s." if period else " It does not depend on time: any step is one sample."
    if kind == "actuator":
        reached = "Voltage reached at the end of a step's first period, then held"
        return f"The actuator '{words}': displacement that a voltage causes.{pace}", [
            time,
            Variable("voltage", "input", "V", reached, begin.voltage),
            Variable("displacement", "output", "m", "Displacement"),
            *scaling,
        ]
    summary = f"Voltage, {low!r} V to {high!r} V, that makes the actuator '{words}' follow a displacement."
    if axis.slew_rate is not None:
        summary += f" Slew rate at most {axis.slew_rate!r} V/s."
    wanted = f"Displacement wanted {f'in {ahead} steps' if ahead else 'at the end of the step'}"
    return summary + pace, [
        time,
        Variable("displacement", "input", "m", wanted, begin.displacement),
        Variable("voltage", "output", "V", "Voltage to be reached at the end of the step", range=(low, high)),
        *scaling,
        Variable("limited", "output", "", "Samples whose voltage was clamped by a limit"),
        Variable("slewed", "output", "", "Samples whose voltage was slewed"),
    ]


def _names(actuator: str, kind: Kind) -> tuple[str, str]:
    """Return the name of an actuator and the kind, as text and as a name in C."""
    words = printable(actuator)
    slug = re.sub(r"\W+", "_", words, flags=re.ASCII).strip("_")[:_LONGEST] or "piezo"
    return (words, f"dehyst_{slug}") if slug == kind else (f"{words}, {kind}", f"dehyst_{slug}_{kind}")


def _description(axis: Axis, title: str, identifier: str, token: str, summary: str, variables: list[Variable]) -> str:
    """Return the text of `modelDescription.xml`; `token` is the GUID."""
    listed, outputs = [], []
    for reference, variable in enumerate(variables):
        role = f'variability="{"continuous" if variable.unit else "discrete"}"'
        real = f'Real unit="{variable.unit}"'
        if variable.range is not None:
            real += f' min="{variable.range[0]!r}" max="{variable.range[1]!r}"'
        if variable.start is not None:
            real += f' start="{variable.start!r}"'
        if variable.causality == "output":
            role += ' initial="calculated"'
            outputs.append(f'      <Unknown index="{reference + 1}" dependencies="" />')
        kind = real if variable.unit else "Integer"
        listed.append(_VARIABLE.format(**variable._asdict(), reference=reference, role=role, kind=kind))
    period = axis.period
    quoted = {'"': "&quot;"}
    return Template(shipped("modelDescription.xml")).substitute(
        name=escape(title, quoted),
        token=token,
        summary=escape(summary, quoted),
        program=__version__,
        identifier=identifier,
        any_step="false" if period else "true",
        step=f' stepSize="{period!r}"' if period else "",
        variables="\n".join(listed),
        outputs="\n".join(outputs),
    )
