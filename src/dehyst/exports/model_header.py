"""The numbers of a compensator as C: what `piezo.c` and `piezo.h` hold of a model, and where its memory begins."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst.control import Compensator
from dehyst.model import Actuator, State
from dehyst.model.states import NEAR, looped

Number: TypeAlias = Literal["double", "float"]
Tables: TypeAlias = Mapping[str, Array]

# Lines of the templates in whose place the generated text comes.
SIZES, NUMBERS = "/* sizes */\n", "/* numbers */\n"
_A_LINE = 4
# Bytes before the numbers of a block.
_HEADER = 64
# Slider positions [m] of one state, but for rounding.
_SAME = 1e-13
_LARGEST = float(np.finfo(np.float64).max)
# Tables that must strictly increase or be positive, and what they hold, for messages.
_INCREASING = {
    "rho": "breakaway elongations",
    "knot": "displacements of the spring's knots",
    "value": "voltages of the spring's knots",
    "grade_knot": "knots of the graded elements",
    "tau_voltage": "voltages of the transformer",
    "tau_drive": "drives of the transformer",
}
_POSITIVE = {
    "rho": "breakaway elongation",
    "slope": "slope of the spring",
    "tau_slope": "slope of the transformer",
    "tau_inverse": "slope of the transformer's inverse",
    "length": "length of a smooth element",
}


class ExportedStart(NamedTuple):
    """Displacement [m] and voltage [V] of the memory at the start, and the way there as a sentence."""

    displacement: float
    voltage: float
    way: str

    @classmethod
    def of(cls, compensator: Compensator) -> ExportedStart:
        """Return the start of a loop like this one, as it was made or last reset."""
        loop, actuator = compensator.clone(), compensator.actuator
        state, (low, high), asked = loop.state, loop.limits, loop.initial_state
        place = float(state.motion[0]) if state.motion.size else state.displacement
        # A little beyond the limits, the requested state has the same way.
        near = abs(actuator.voltage(asked) - loop.voltage) <= NEAR * (high - low)
        return cls(place, loop.voltage, _way(actuator, asked if near else state, loop.voltage, loop.limits))

    @property
    def words(self) -> str:
        """Displacement and voltage."""
        return f"{self.displacement * 1e6:.6g} um, {self.voltage:.6g} V"


def _way(actuator: Actuator, state: State, voltage: float, limits: tuple[float, float]) -> str:
    """Describe how the voltage leads to the state; slowly, because the words have no time in them."""
    strain, most = state.displacement - state.carts, actuator.slip.breakaway
    end = f"{voltage:.6g} V"
    rest = " and wait until creep has come to rest" if actuator.creep is not None else ""
    if np.allclose(strain, most, rtol=1e-9, atol=0):
        return f"raise the voltage slowly from its lowest, never back, to {end}{rest}"
    if np.allclose(strain, -most, rtol=1e-9, atol=0):
        return f"lower the voltage slowly from its highest, never back, to {end}{rest}"
    if not strain.any():
        return f"swing the voltage about {end}, each swing smaller than the one before, until it rests there{rest}"
    low, high = limits
    for limit, rising in ((low, False), (high, True)):
        near = abs(voltage - limit) <= NEAR * (high - low)
        if near and np.allclose(looped(actuator, limits, rising=rising).carts, state.carts, rtol=0, atol=_SAME):
            return f"swing the voltage slowly between {low:.6g} and {high:.6g} V, twice, and end at {limit:.6g} V{rest}"
    return f"play the voltages that lead to this state, for instance a homing, down to the last one, {end}"


def demand_compensator(value: object) -> None:
    """Refuse anything but a Compensator.

    Raises
    ------
    ModelError
    """
    if not isinstance(value, Compensator):
        raise ModelError(
            f"compensator: got {type(value).__name__}, need a Compensator; pass Compensator(actuator, limits), made "
            "from the actuator"
        )


class Sizes(NamedTuple):
    """Sizes of a loop: elements, spring's knots, grades, transformer's knots, creep branches, smooth elements, taps."""

    elements: int
    knots: int
    grades: int
    bends: int
    branches: int
    smooth: int
    taps: int

    @classmethod
    def of(cls, tables: Tables) -> Sizes:
        """Read them from the tables of a compensator."""
        grades = max(tables["grade_knot"].size - 1, 0)
        names = ("tau_voltage", "creep", "length", "tap")
        return cls(tables["rho"].size, tables["knot"].size, grades, *(tables[name].size for name in names))

    def room(self, block: bytes) -> int:
        """Return how many numbers a block of these sizes and the tables that the core computes have."""
        graded = self.grades + (self.elements + 1) * (self.grades + 1) if self.grades else 0
        return (len(block) - _HEADER) // 8 + self.knots + 2 * self.bends + graded


def config_header(number: Number) -> str:
    """Return `dehyst_config.h`, which says in one place what number type the core and the model have."""
    return f"""/* The choices of a build, which every file of it includes. */
#ifndef DEHYST_CONFIG_H
#define DEHYST_CONFIG_H

/* The number type: double or float. */
#define DEHYST_REAL {number}

#endif
"""


def size_macros(compensator: Compensator, number: Number) -> str:
    """Return the macros that `piezo.h` begins with."""
    tables = _tables(compensator, number)
    sizes, (low, high) = Sizes.of(tables), tables["loop"][:2].tolist()
    spell = _Spelling(number).plain
    lines = [
        f"#define MODEL_ELEMENTS {sizes.elements}",
        f"#define MODEL_BRANCHES {sizes.branches}",
        f"#define MODEL_SMOOTH {sizes.smooth}",
        f"#define MODEL_TAPS {sizes.taps}",
        "/* Numbers that dehyst_model_load needs for another block of these sizes. */",
        f"#define MODEL_ROOM {sizes.room(compensator.model_block())}",
        "",
        "/* Seconds between steps; 0: this model does not depend on time. */",
        f"#define MODEL_PERIOD {spell(compensator.period or 0.0)}",
        "/* A displacement is to be given so many samples before its time. */",
        f"#define MODEL_AHEAD {compensator.samples_ahead}",
        f"#define MODEL_LOW {spell(low)} /* V */",
        f"#define MODEL_HIGH {spell(high)} /* V */",
        "",
    ]
    return "\n".join(lines)


def numbers(compensator: Compensator, number: Number) -> str:
    """Return the constants of `piezo.c`: every number that a step reads, and the state that it starts from.

    Raise `ModelError` if numbers that must differ are one float, or a float cannot hold one of them.
    """
    tables = _tables(compensator, number)
    if number == "float":
        _demand_float(tables)
    spell, start, branches = _Spelling(number), compensator.start(), tables["creep"].size
    memory = {"cart": start.carts, "strain": start.strains[:branches], "elongation": start.strains[branches:]}
    used = {**_used(tables), **memory}
    arrays = [spell.array(name, values) for name, values in used.items() if values.size]
    begin = ExportedStart.of(compensator)
    comment = f"/* The start, at {begin.words}. To bring the actuator there:\n * {begin.way}. */"
    return "\n".join([*arrays, comment, _model(compensator, tables, used, spell), ""])


class _Spelling:
    """Numbers as C text: hexadecimal where only C reads them, so that no bit is lost."""

    def __init__(self, number: Number) -> None:
        self.number = number

    def one(self, value: float) -> str:
        if value == _LARGEST:
            return "DEHYST_LARGEST"
        return float(value).hex() if self.number == "double" else f"{float(np.float32(value)).hex()}f"

    def plain(self, value: float) -> str:
        """Return the shortest decimal that is rounded to the same number, which every C++ reads."""
        return repr(float(value)) if self.number == "double" else f"{np.float32(value)!s}f"

    def some(self, values: Array) -> str:
        return ", ".join(self.one(value) for value in values.tolist())

    def array(self, name: str, values: Array) -> str:
        rows = [self.some(values[i : i + _A_LINE]) for i in range(0, values.size, _A_LINE)]
        body = ",\n    ".join(rows)
        return f"static const dehyst_real piezo_{name}[{values.size}] = {{\n    {body}}};"


def _tables(compensator: Compensator, number: Number) -> Tables:
    """Return the tables; for floats with limits and largest change rounded inward, so that no voltage leaves them."""
    tables = compensator.tables()
    if number == "double":
        return tables
    low, high, change, *rest = tables["loop"].tolist()
    inward = [-_below(-low), _below(high), change if change == _LARGEST else _below(change)]
    if inward[0] >= inward[1] or inward[2] <= 0:
        raise ModelError(
            f"float: no number lies within the limits {low!r} to {high!r} V or the slew rate; export double"
        )
    return {**tables, "loop": np.array([*inward, *rest])}


def _below(value: float) -> float:
    """Return the largest float that is not above a double."""
    rounded = np.float32(value)
    return float(rounded if float(rounded) <= value else np.nextafter(rounded, np.float32(-np.inf)))


def _used(tables: Tables) -> dict[str, Array]:
    """Select the arrays that a loop reads: not kappa with graded elements, and one slope less than knots."""
    arrays = {name: values for name, values in tables.items() if name not in ("loop", "inertia", "transition")}
    if tables["grade_knot"].size:
        arrays["kappa"] = EMPTY
    for name in ("tau_slope", "tau_inverse"):
        arrays[name] = arrays[name][:-1]
    return arrays


def _model(compensator: Compensator, tables: Tables, used: Tables, spell: _Spelling) -> str:
    """Return the constant `piezo_model`, with the members of `dehyst_model` in their order."""
    sizes, start = Sizes.of(tables), compensator.start()
    motion = start.motion if start.motion.size else np.array([start.w, 0.0])

    def at(*names: str) -> str:
        return ", ".join(f"piezo_{name}" if used[name].size else "0" for name in names)

    inertia, step = tables["inertia"], tables["transition"]
    series = spell.some(inertia) if inertia.size else "0, 0"
    moves = step if step.size else np.zeros(8)
    low, high, change, *amplifier, stiffness = tables["loop"].tolist()
    model_id, shape = compensator.model_ids()
    rows = [
        "{{{",
        f"    {{{sizes.elements}, {at('rho', 'kappa')}, 0, 0, 0, 0}},",
        f"    {{{sizes.knots}, {at('knot', 'value', 'slope')}}}}},",
        f"  {{{sizes.grades}, {at('grade_knot', 'grade_value', 'grade_slope')}}},",
        f"  {{{sizes.bends}, {at('tau_voltage', 'tau_drive', 'tau_slope')}}},",
        f"  {{{sizes.bends}, {at('tau_drive', 'tau_voltage', 'tau_inverse')}}},",
        f"  {sizes.branches}, {at('creep')},",
        f"  {int(inertia.size > 0)}, {series},",
        f"  {{{sizes.smooth}, {at('length', 'back', 'smooth')}}}}},",
        f" {{{at('decay', 'gain')},",
        f"  {{{{{spell.some(moves[:4])}}},",
        f"   {{{spell.some(moves[4:6])}}},",
        f"   {{{spell.some(moves[6:])}}}}}}},",
        f" {spell.one(low)}, {spell.one(high)}, {spell.one(change)},",
        f" {sizes.taps}, {at('tap')},",
        f" {spell.some(np.array(amplifier))},",
        f" {spell.one(stiffness)},",
        f" {{{spell.some(np.array([start.w, *motion]))}, {at('cart', 'strain', 'elongation')}}},",
        f" {spell.one(compensator.period or 0.0)}, {compensator.samples_ahead}, {model_id}ul, {shape}ul}};",
    ]
    return "static const dehyst_model piezo_model = " + "\n".join(rows)


def _demand_float(tables: Tables) -> None:
    """Refuse a model that single precision would change."""
    for name, values in tables.items():
        with np.errstate(over="ignore", under="ignore"):
            rounded = values.astype(np.float32)
        if not np.isfinite(rounded[values != _LARGEST]).all():
            raise ModelError(f"float: a number of {name} is too large, {np.abs(values).max():.3g}; export double")
        if name in _INCREASING and (np.diff(rounded) <= 0).any():
            i = int(np.argmax(np.diff(rounded) <= 0))
            pair = f"{float(values[i])!r} and {float(values[i + 1])!r}"
            raise ModelError(
                f"float: the {_INCREASING[name]} {pair} are one number when rounded, need two; export double, or "
                "identify with fewer"
            )
        if name in _POSITIVE and (rounded <= 0).any() and (values > 0).all():
            raise ModelError(f"float: a {_POSITIVE[name]}, {values.min():.3g}, is 0 when rounded; export double")
    kept, decay = tables["decay"], tables["decay"].astype(np.float32)
    if ((decay == 1) & (kept < 1)).any():
        raise ModelError(
            "float: creep is so slow beside the period that it would never relax: the decay of a strain in one step, "
            f"{float(kept.max())!r}, is 1 when rounded; export double, or give a longer period"
        )
