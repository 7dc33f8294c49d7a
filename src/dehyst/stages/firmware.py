"""The compensator of a stage as a folder of C: the core that Python runs, and the numbers of all axes."""

from __future__ import annotations

import re
from itertools import permutations
from pathlib import Path
from string import Template

import numpy as np

from dehyst._errors import ModelError
from dehyst._io import PathLike, path_of
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.control import Compensator
from dehyst.exports import Exported
from dehyst.exports.firmware import CONFIG, CORE, bytes_table, fill_folder, footprints_of, write_files
from dehyst.exports.model_header import NUMBERS, SIZES, config_header, numbers, size_macros
from dehyst.exports.naming import demand_name, in_comment, printable, text_of
from dehyst.exports.shipped import shipped
from dehyst.exports.start import ExportedStart
from dehyst.stages.compensator import NEAR, StageCompensator, looped
from dehyst.stages.golden import stage_golden_trace, stage_trace_header

STAGE_NAME = "stage"
_AXES, _MEMBERS = "/* axes */\n", "/* members */\n"
_IDENTIFIER = re.compile(r"[A-Za-z0-9]\w{0,15}", re.ASCII)
_CALL = re.compile(r"\bpiezo_(\w+)")
# Carts [m] of one state, but for rounding.
_SAME = 1e-13
_UNASKED = "not asked for"


def stage_code(compensator: StageCompensator, name: str = STAGE_NAME) -> dict[str, str]:
    """Return the C files of the compensator of a stage by name, as `export_stage` writes them.

    Raise `ModelError` if it is no StageCompensator, or the name is no name in C or has a meaning there.
    """
    if not isinstance(compensator, StageCompensator):
        raise ModelError(f"compensator: got {type(compensator).__name__}, need a StageCompensator, made from the stage")
    demand_name(name)
    loops, types = compensator.compensators, [f"{name}_{label}" for label in _labels(compensator)]
    title = f"/* The stage '{in_comment(compensator.stage.name)}', made by dehyst {__version__}. Units: V, m, s. */\n"
    header, source = (text_of(shipped(file), name) for file in ("stage.h", "stage.c"))
    macros = text_of(f"#define MODEL_AXES {len(loops)}\n#define MODEL_PERIOD {compensator.period or 0.0!r}\n", name)
    members = [f"    {kind} axis{j};\n" for j, kind in enumerate(types)]
    largest = max(2 * one.start().carts.size + one.start().strains.size + one.tables()["tap"].size for one in loops)
    spare = f"    dehyst_real spare[{largest}]; /* to try where a clamped voltage leads */\n"
    header = header.replace(SIZES, macros).replace(_MEMBERS, "".join(members) + spare)
    header = header.replace(_AXES, "".join(_axis_header(one, kind) for one, kind in zip(loops, types, strict=True)))
    bodies = "".join(_axis_source(one, kind) for one, kind in zip(loops, types, strict=True))
    source = source.replace(_AXES, bodies).replace(NUMBERS, text_of(_tables(compensator, types), name))
    files = {f"{name}.c": title + source, f"{name}.h": title + header}
    return files | {file: shipped(file) for file in CORE} | {CONFIG: config_header("double")}


def export_stage(
    compensator: StageCompensator,
    directory: PathLike,
    *,
    force: bool = False,
    name: str = STAGE_NAME,
    measure: bool = True,
) -> Exported:
    """Write the compensator of a stage as C: the whole folder, or nothing.

    Six files go into a firmware: the core, `dehyst.c` and three headers, byte for byte the one that Python runs; the
    stage, stage.c and stage.h, with the coupling matrix, the numbers of each axis and the calls. Beside them are a
    golden trace that ``make check`` replays, and a README.

    Parameters
    ----------
    compensator : StageCompensator
        The export has the states in which it was made or last reset. It does not change.
    directory : path
        A new or an empty folder.
    force : bool, optional
        Replace an earlier export. A folder with other files is always refused.
    name : str, optional
        Name in C of the type and the calls; the files of the stage are then NAME.c and NAME.h.
    measure : bool, optional
        Compile the export to measure bytes, which takes seconds.

    Raises
    ------
    ModelError
        If it is no StageCompensator, or the name is no name in C or has a meaning there.
    FileFormatError
        If it is no path, the folder holds other files, or it cannot be written.
    """
    folder = path_of(directory)
    files = stage_code(compensator, name)
    trace = stage_golden_trace(compensator)
    files |= {
        "check.c": text_of(shipped("stage_check.c"), name),
        "Makefile": text_of(shipped("Makefile"), name),
        "LICENSE": shipped("LICENSE"),
        "trace.h": stage_trace_header(trace),
    }

    def fill(draft: Path) -> Exported:
        write_files(draft, files)
        footprints, unmeasured = footprints_of(draft, "double") if measure else ({}, _UNASKED)
        result = Exported(folder, footprints, None, unmeasured)
        write_files(draft, {"README.md": _readme(compensator, result, len(trace.rows), name)})
        return result

    return fill_folder(folder, fill, force)


def _labels(compensator: StageCompensator) -> list[str]:
    """Return the names of the axes for C; their numbers, from 1, where one is no part of a name, or taken."""
    axes = compensator.stage.axes
    lower = [axis.lower() for axis in axes]
    taken = {"axes", "period", *_CALL.findall(shipped("stage.h"))}
    # The calls of an axis are its name, an underscore and more.
    alike = any(one == other or one.startswith(f"{other}_") for one, other in permutations(lower, 2))
    if all(map(_IDENTIFIER.fullmatch, axes)) and not alike and not taken & set(lower):
        return list(axes)
    return [str(number) for number in range(1, len(axes) + 1)]


def _axis_header(compensator: Compensator, kind: str) -> str:
    """Return sizes, type and calls of one axis."""
    _, _, text = shipped("piezo.h").partition('#include "dehyst.h"\n')
    body = text.rpartition("#endif")[0].replace(SIZES, size_macros(compensator, "double"))
    return text_of(body.strip("\n") + "\n\n", kind)


def _axis_source(compensator: Compensator, kind: str) -> str:
    """Return numbers and calls of one axis."""
    _, _, text = shipped("piezo.c").partition('#include "dehyst_model.h"\n')
    text = text.replace(NUMBERS, numbers(compensator, "double"))
    return text_of(text.strip("\n") + "\n\n", kind)


def _tables(compensator: StageCompensator, types: list[str]) -> str:
    """Return the matrices, and what leads from the number of an axis to its numbers and its loop."""
    stage, count = compensator.stage, len(types)

    def cases(line: str, *, last: str) -> str:
        rows = [f"    case {j}: {line.format(j=j, kind=kind)}\n" for j, kind in enumerate(types[:-1])]
        return "".join([*rows, f"    default: {last.format(j=count - 1, kind=types[-1])}\n"])

    loop = "return &p->axis{j}.loop;"
    memory = "return p->axis{j}.memory;"
    moved = "return p->axis{j}.loop.w;"
    begins = "".join(
        f"    if (status == DEHYST_OK) status = {kind}_begin(&p->axis{j});\n" for j, kind in enumerate(types)
    )
    return f"""{_matrix("decoupling", stage.decoupling)}
{_matrix("coupling", stage.coupling)}
static const dehyst_model *const models[MODEL_AXES] = {{{", ".join(f"&{kind}_model" for kind in types)}}};

dehyst_loop *piezo_loop(piezo *p, int axis)
{{
    switch (axis) {{
{cases(loop, last=loop)}    }}
}}

static dehyst_real *memory_of(piezo *p, int axis)
{{
    switch (axis) {{
{cases(memory, last=memory)}    }}
}}

/* Return where a voltage on offer leads: it is committed on a copy, number by number, which needs no library. */
static dehyst_real reached_by(piezo *p, int axis, dehyst_real voltage)
{{
    const dehyst_loop *from = piezo_loop(p, axis);
    const dehyst_real *numbers = memory_of(p, axis);
    const unsigned long size = dehyst_memory_size(models[axis]);
    dehyst_loop loop;
    unsigned long i;
    loop.w = from->w;
    loop.y = from->y;
    loop.rate = from->rate;
    loop.input = from->input;
    loop.sent = from->sent;
    loop.acting = from->acting;
    loop.intended[0] = from->intended[0];
    loop.intended[1] = from->intended[1];
    loop.wanted = from->wanted;
    loop.target = from->target;
    loop.candidate = from->candidate;
    loop.voltage = from->voltage;
    loop.offer = from->offer;
    loop.segment = from->segment;
    loop.half = from->half;
    loop.limited = loop.slewed = loop.refused = 0;
    for (i = 0; i < size; i++) p->spare[i] = numbers[i];
    dehyst_loop_commit(models[axis], &loop, p->spare, voltage);
    return loop.w;
}}

static dehyst_real moved_by(const piezo *p, int axis)
{{
    switch (axis) {{
{cases(moved, last=moved)}    }}
}}

dehyst_status piezo_begin(piezo *p)
{{
    dehyst_status status = DEHYST_OK;
    int j;
{begins}    for (j = 0; j < MODEL_AXES; j++) p->clamped[j] = 0;
    return status;
}}
"""


def _matrix(name: str, table: Array) -> str:
    rows = ",\n    ".join("{" + ", ".join(value.hex() for value in row) + "}" for row in table.tolist())
    return f"static const dehyst_real {name}[MODEL_AXES][MODEL_AXES] = {{\n    {rows}}};"


def _way(loop: Compensator) -> str:
    """Return how to bring an actuator to a start that loops between the limits lead to; empty if it is another."""
    begin, actuator = loop.afresh(), loop.actuator
    state, (low, high) = begin.state, loop.limits
    # A motion that lets every element slide needs no loop: its words are shorter.
    slid = np.allclose(np.abs(state.displacement - state.carts), actuator.slip.breakaway, rtol=1e-9, atol=0)
    for end, rising in ((low, False), (high, True)) if not slid else ():
        other, near = looped(actuator, loop.limits, rising=rising), NEAR * (high - low)
        if abs(begin.voltage - end) <= near and np.allclose(other.carts, state.carts, rtol=0, atol=_SAME):
            rest = "; wait until creep has come to rest" if actuator.creep is not None else ""
            return f"swing the voltage slowly between {low:.6g} and {high:.6g} V, twice, and end at {end:.6g} V{rest}"
    return ""


def _readme(compensator: StageCompensator, result: Exported, rows: int, name: str) -> str:
    table = []
    parts = zip(compensator.stage.axes, compensator.compensators, strict=True)
    for axis, loop in parts:
        low, high = loop.limits
        slew = "not limited" if loop.slew_rate is None else f"{loop.slew_rate:.9g} V/s"
        start = ExportedStart.of(loop)
        table.append(f"| {axis} | {low:.9g} to {high:.9g} | {slew} | {start.words}: {_way(loop) or start.way} |")
    text = text_of(shipped("stage_README.md"), name)
    return Template(text).substitute(
        name=printable(compensator.stage.name),
        count=len(table),
        version=__version__,
        every="a sample" if compensator.period is None else f"every {compensator.period:.9g} s",
        axes=", ".join(compensator.stage.axes),
        table="\n".join(table),
        example=f"{name}_{_labels(compensator)[0]}_step",
        bytes=text_of(bytes_table(result.footprints, result.unmeasured), name),
        rows=rows,
    )
