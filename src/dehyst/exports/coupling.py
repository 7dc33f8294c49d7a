"""The compensator of several coupled axes as C: the sources of each axis, and what coupling adds to them."""

from __future__ import annotations

import re
from itertools import permutations

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import StageCompensator
from dehyst.exports.model_header import NUMBERS, SIZES, numbers, size_macros
from dehyst.exports.naming import shipped, text_of

_AXES, _MEMBERS = "/* axes */\n", "/* members */\n"
_IDENTIFIER = re.compile(r"[A-Za-z0-9]\w{0,15}", re.ASCII)
_CALL = re.compile(r"\bpiezo_(\w+)")


def coupled_sources(compensator: StageCompensator, name: str) -> tuple[str, str]:
    """Return the text of `NAME.c` and `NAME.h`, without their first lines."""
    for axis, loop in zip(compensator.stage.axes, compensator.compensators, strict=True):
        if loop.actuator.displacement_creep is not None:
            raise ModelError(
                f"axis {axis} has creep in displacement, which an export of coupled axes does not compute",
                hint="export each axis alone, or identify it without",
            )
    loops, types = compensator.compensators, [f"{name}_{label}" for label in labels(compensator)]
    header, source = (text_of(shipped(file), name) for file in ("stage.h", "stage.c"))
    macros = text_of(f"#define MODEL_AXES {len(loops)}\n#define MODEL_PERIOD {compensator.period or 0.0!r}\n", name)
    members = [f"    {kind} axis{j};\n" for j, kind in enumerate(types)]
    largest = max(2 * one.start().carts.size + one.start().strains.size + one.tables()["tap"].size for one in loops)
    spare = f"    dehyst_real spare[{largest}]; /* to try where a clamped voltage leads */\n"
    header = header.replace(SIZES, macros).replace(_MEMBERS, "".join(members) + spare)
    # Of the files of one axis, what comes after their headers and include guards.
    each = [shipped(file).rpartition("#include")[2].partition("\n")[2] for file in ("piezo.h", "piezo.c")]
    heads, bodies = "", ""
    for one, kind in zip(loops, types, strict=True):
        sized = each[0].rpartition("#endif")[0].replace(SIZES, size_macros(one, "double"))
        heads += text_of(sized.strip("\n") + "\n\n", kind)
        bodies += text_of(each[1].replace(NUMBERS, numbers(one, "double")).strip("\n") + "\n\n", kind)
    source = source.replace(_AXES, bodies).replace(NUMBERS, _tables(compensator, name, types))
    return source, header.replace(_AXES, heads)


def labels(compensator: StageCompensator) -> list[str]:
    """Return the names of the axes for C; their numbers, from 1, where one is no part of a name, or taken."""
    axes = compensator.stage.axes
    lower = [axis.lower() for axis in axes]
    taken = {"axes", "period", *_CALL.findall(shipped("stage.h"))}
    # The calls of an axis are its name, an underscore and more.
    alike = any(one == other or one.startswith(f"{other}_") for one, other in permutations(lower, 2))
    if all(map(_IDENTIFIER.fullmatch, axes)) and not alike and not taken & set(lower):
        return list(axes)
    return [str(number) for number in range(1, len(axes) + 1)]


def _tables(compensator: StageCompensator, name: str, types: list[str]) -> str:
    """Return the matrices, and what leads from the number of an axis to its numbers and its loop."""
    stage, count, axes = compensator.stage, len(types), text_of("MODEL_AXES", name)

    def cases(line: str, *, last: str) -> str:
        rows = [f"    case {j}: {line.format(j=j, kind=kind)}\n" for j, kind in enumerate(types[:-1])]
        return "".join([*rows, f"    default: {last.format(j=count - 1, kind=types[-1])}\n"])

    loop = "return &p->axis{j}.loop;"
    memory = "return p->axis{j}.memory;"
    moved = "return p->axis{j}.loop.w;"
    begins = "".join(
        f"    if (status == DEHYST_OK) status = {kind}_begin(&p->axis{j});\n" for j, kind in enumerate(types)
    )
    return f"""{_matrix("decoupling", stage.decoupling, axes)}
{_matrix("coupling", stage.coupling, axes)}
static const dehyst_model *const models[{axes}] = {{{", ".join(f"&{kind}_model" for kind in types)}}};

dehyst_loop *{name}_loop({name} *p, int axis)
{{
    switch (axis) {{
{cases(loop, last=loop)}    }}
}}

static dehyst_real *memory_of({name} *p, int axis)
{{
    switch (axis) {{
{cases(memory, last=memory)}    }}
}}

static dehyst_real moved_by(const {name} *p, int axis)
{{
    switch (axis) {{
{cases(moved, last=moved)}    }}
}}

dehyst_status {name}_begin({name} *p)
{{
    dehyst_status status = DEHYST_OK;
    int j;
{begins}    for (j = 0; j < {axes}; j++) p->clamped[j] = 0;
    return status;
}}
"""


def _matrix(name: str, table: Array, axes: str) -> str:
    rows = ",\n    ".join("{" + ", ".join(value.hex() for value in row) + "}" for row in table.tolist())
    return f"static const dehyst_real {name}[{axes}][{axes}] = {{\n    {rows}}};"
