"""The numbers of a compensator as C: the parts of `piezo.c` and `piezo.h` that depend on the model, and its start."""

from __future__ import annotations

from collections.abc import Mapping
from string import Template
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from dehyst._errors import ModelError
from dehyst._native import EMPTY
from dehyst._types import Array
from dehyst.control import Axis
from dehyst.exports.naming import shipped
from dehyst.model import NEAR, Actuator, State, looped

Number: TypeAlias = Literal["double", "float"]
Tables: TypeAlias = Mapping[str, Array]

# The model, with the members of `dehyst_model` in their order.
_MODEL = Template("""\
static const dehyst_model piezo_model = {{{
    {$elements, $slip, 0, 0, 0, 0},
    {$knots, $spring}},
  {$grades, $graded},
  {$bends, $transformer},
  {$bends, $inverse},
  $inertia, $series,
  {$smooth, $lengths}},
 {{$phi},
  {$before},
  {$after}},
 {$output, $behind, $rests},
 $limits,
 $taps, $tap,
 $amplifier,
 $stiffness,
 {$start, $memory},
 $period, $ahead, ${id}ul, ${shape}ul};""")
_TEMPERATURE_DECLARED = """\
/* Set gain and offset of the displacement for a temperature [degC], between two periods. Before the first call the
 * reference temperature applies. If it does not return DEHYST_OK, nothing changes. */
dehyst_status piezo_temperature(piezo *p, dehyst_real degrees);
"""
# Gain 1/K, offset m/K and reference give the same bits as `Thermal.scale` in Python.
_TEMPERATURE_DEFINED = """
dehyst_status piezo_temperature(piezo *p, dehyst_real degrees)
{
    const dehyst_real kelvins = degrees - piezo_thermal[2];
    return dehyst_loop_scale(&p->loop, 1 + piezo_thermal[0] * kelvins, piezo_thermal[1] * kelvins);
}
"""
_A_LINE = 4
# Tables whose numbers are single members of the model, not arrays.
_SCALARS = ("loop", "inertia", "transition", "output")
# Bytes before the numbers of a block.
_HEADER = 64
# Cart positions [m] that differ by less are equal: the difference is rounding.
_SAME_CARTS = 1e-13
_LARGEST = float(np.finfo(np.float64).max)
# Tables that must strictly increase or be positive, with their contents in words for messages.
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
    """The exported initial state: its displacement [m], its voltage [V], and a sentence on how to reach it."""

    displacement: float
    voltage: float
    way: str

    @classmethod
    def of(cls, axis: Axis) -> ExportedStart:
        """Return the initial state of an axis, at its construction or last reset."""
        actuator, (low, high), asked = axis.actuator, axis.limits, axis.given
        # A state slightly beyond the limits is reached in the same way.
        held = axis.held(asked)
        near = abs(actuator.voltage(asked) - held) <= NEAR * (high - low)
        return cls(
            actuator.displacement(axis.start), held, _way(actuator, asked if near else axis.start, held, axis.limits)
        )

    @property
    def words(self) -> str:
        """Displacement and voltage."""
        return f"{self.displacement * 1e6:.5g} um, {self.voltage:.5g} V"


def _way(actuator: Actuator, state: State, voltage: float, limits: tuple[float, float]) -> str:
    """Describe the slow voltage that leads to the state; the text holds no times."""
    strain, most = state.deformation - state.carts, actuator.slip.breakaway
    end = f"{voltage:.5g} V"
    rest = " and wait until creep has come to rest" if actuator.displacement_creep is not None else ""
    if np.allclose(strain, most, rtol=1e-9, atol=0):
        return f"raise the voltage slowly from its lowest, never back, to {end}{rest}"
    if np.allclose(strain, -most, rtol=1e-9, atol=0):
        return f"lower the voltage slowly from its highest, never back, to {end}{rest}"
    if not strain.any():
        return f"swing the voltage about {end} with decreasing amplitude until it rests there{rest}"
    low, high = limits
    for limit, rising in ((low, False), (high, True)):
        near = abs(voltage - limit) <= NEAR * (high - low)
        if near and np.allclose(looped(actuator, limits, rising=rising).carts, state.carts, rtol=0, atol=_SAME_CARTS):
            return f"swing the voltage slowly between {low:.5g} and {high:.5g} V, twice, and end at {limit:.5g} V{rest}"
    return f"play the voltages that lead to this state, for instance a homing; the last voltage is {end}"


def config_header(number: Number) -> str:
    """Return `dehyst_config.h`, which sets the number type of core and model."""
    return shipped("dehyst_config.h").replace("DEHYST_REAL double", f"DEHYST_REAL {number}")


class ModelText:
    """The numbers of an `axis` as C text of a `number` type. Floats are rounded once, limits inward.

    Raise `ModelError` if numbers that must differ round to the same float, or a float cannot hold a number.
    """

    def __init__(self, axis: Axis, number: Number) -> None:
        self._axis, self._number = axis, number
        self._start, self._tables = axis.core_start, axis.loop.tables()
        if number == "float":
            self._tables["loop"] = _inward(self._tables["loop"])
            _demand_float(self._tables)

    @property
    def memory(self) -> int:
        """Count of numbers in the memory of a loop."""
        return 2 * self._start.carts.size + self._start.strains.size + self._tables["tap"].size

    @property
    def snapshot(self) -> int:
        """Size of a snapshot of this memory [bytes]."""
        return 40 + 8 * (11 + self.memory - self._start.carts.size)

    @property
    def room(self) -> int:
        """Count of numbers in a block of these sizes, with the tables that the core computes."""
        tables, elements = self._tables, self._tables["rho"].size
        grades = max(tables["grade_knot"].size - 1, 0)
        computed = tables["knot"].size + 2 * tables["tau_voltage"].size
        computed += grades + (elements + 1) * (grades + 1) if grades else 0
        return (len(self._axis.block()) - _HEADER) // 8 + computed

    def macros(self) -> str:
        """Return the macros that `piezo.h` begins with."""
        tables, axis = self._tables, self._axis
        low, high = tables["loop"][:2].tolist()
        return f"""\
#define PIEZO_ELEMENTS {tables["rho"].size}
#define PIEZO_SMOOTH {tables["length"].size}
#define PIEZO_OUTPUT {tables["output_gain"].size}
#define PIEZO_TAPS {tables["tap"].size}
/* Count of numbers that dehyst_model_load needs for another block of these sizes. */
#define PIEZO_ROOM {self.room}

/* Seconds between steps; 0: this model does not depend on time. */
#define PIEZO_PERIOD {self._decimal(axis.period or 0.0)}
/* Number of samples by which a displacement is given before its time. */
#define PIEZO_AHEAD {axis.preview[1]}
#define PIEZO_LOW {self._decimal(low)} /* V */
#define PIEZO_HIGH {self._decimal(high)} /* V */
"""

    def numbers(self) -> str:
        """Return the constants of `piezo.c`: every number that a step reads, and the start."""
        start = self._start
        elongation, crept = np.split(start.strains, [self._tables["length"].size])
        # A step reads these tables; it does not read kappa of graded elements, nor a slope after the last knot.
        arrays = {name: self._tables[name] for name in self._tables if name not in _SCALARS}
        if arrays["grade_knot"].size:
            arrays["kappa"] = EMPTY
        for name in ("tau_slope", "tau_inverse"):
            arrays[name] = arrays[name][:-1]
        arrays |= {"cart": start.carts, "elongation": elongation, "crept": crept}
        begin = ExportedStart.of(self._axis)
        comment = f"/* The start, at {begin.words}. To bring the actuator there:\n * {begin.way}. */"
        texts = [self._array(name, values) for name, values in arrays.items() if values.size]
        return "\n".join([*texts, comment, self._model(arrays), ""])

    def temperature(self) -> tuple[str, str]:
        """Return declaration and definition of the call that takes a temperature; empty without the part `thermal`."""
        thermal = self._axis.actuator.thermal
        if thermal is None:
            return "", ""
        numbers = np.array([thermal.gain, thermal.offset, thermal.reference])
        return _TEMPERATURE_DECLARED, f"\n{self._array('thermal', numbers)}\n{_TEMPERATURE_DEFINED}"

    def _model(self, arrays: Tables) -> str:
        tables, start, axis, some = self._tables, self._start, self._axis, self._some
        inertia, transition = tables["inertia"], tables["transition"]
        moves = transition if transition.size else np.zeros(8)
        low, high, change, *amplifier, stiffness = tables["loop"].tolist()
        motion = start.motion if start.motion.size else np.array([start.w, 0.0])
        model_id, shape = axis.ids()

        def at(*names: str) -> str:
            return ", ".join(f"piezo_{name}" if arrays[name].size else "0" for name in names)

        return _MODEL.substitute(
            elements=tables["rho"].size,
            slip=at("rho", "kappa"),
            knots=tables["knot"].size,
            spring=at("knot", "value", "slope"),
            grades=max(tables["grade_knot"].size - 1, 0),
            graded=at("grade_knot", "grade_value", "grade_slope"),
            bends=tables["tau_voltage"].size,
            transformer=at("tau_voltage", "tau_drive", "tau_slope"),
            inverse=at("tau_drive", "tau_voltage", "tau_inverse"),
            inertia=int(inertia.size > 0),
            series=some(inertia) if inertia.size else "0, 0",
            smooth=tables["length"].size,
            lengths=at("length", "back", "smooth"),
            phi=some(moves[:4]),
            before=some(moves[4:6]),
            after=some(moves[6:]),
            output=tables["output_gain"].size,
            behind=at("output_gain", "output_decay", "output_rise"),
            rests=some(tables["output"]),
            limits=some(np.array([low, high, change])),
            taps=tables["tap"].size,
            tap=at("tap"),
            amplifier=some(np.array(amplifier)),
            stiffness=self._one(stiffness),
            start=some(np.array([start.w, *motion])),
            memory=at("cart", "elongation", "crept"),
            period=self._one(axis.period or 0.0),
            ahead=axis.preview[1],
            id=model_id,
            shape=shape,
        )

    def _one(self, value: float) -> str:
        """Return a number in hexadecimal, so that no bit is lost; for places that only C reads."""
        if value == _LARGEST:
            return "DEHYST_LARGEST"
        return float(value).hex() if self._number == "double" else f"{float(np.float32(value)).hex()}f"

    def _some(self, values: Array) -> str:
        return ", ".join(map(self._one, values.tolist()))

    def _array(self, name: str, values: Array) -> str:
        body = ",\n    ".join(self._some(values[i : i + _A_LINE]) for i in range(0, values.size, _A_LINE))
        return f"static const dehyst_real piezo_{name}[{values.size}] = {{\n    {body}}};"

    def _decimal(self, value: float) -> str:
        """Return the shortest decimal that rounds to the same number; every version of C++ reads it."""
        return repr(float(value)) if self._number == "double" else f"{np.float32(value)!s}f"


def _inward(loop: Array) -> Array:
    """Return the numbers of a loop with limits and largest change rounded inward, so that no voltage exceeds them."""

    def below(value: float) -> float:
        rounded = np.float32(value)
        return float(rounded if float(rounded) <= value else np.nextafter(rounded, np.float32(-np.inf)))

    low, high, change, *rest = loop.tolist()
    inward = [-below(-low), below(high), change if change == _LARGEST else below(change)]
    if inward[0] >= inward[1] or inward[2] <= 0:
        raise ModelError(
            f"float: no number lies within the limits {low!r} to {high!r} V or the slew rate; export double"
        )
    return np.array([*inward, *rest])


def _demand_float(tables: Tables) -> None:
    """Raise `ModelError` for a model that single precision would change."""
    for name, values in tables.items():
        with np.errstate(over="ignore", under="ignore"):
            rounded = values.astype(np.float32)
        if not np.isfinite(rounded[values != _LARGEST]).all():
            raise ModelError(f"float: cannot hold {np.abs(values).max():.3g}, a number of {name}; export double")
        if name in _INCREASING and (np.diff(rounded) <= 0).any():
            i = int(np.argmax(np.diff(rounded) <= 0))
            pair = f"{float(values[i])!r} and {float(values[i + 1])!r}"
            raise ModelError(
                f"float: the {_INCREASING[name]} {pair} round to one number, need two; export double, or "
                "identify with fewer"
            )
        if name in _POSITIVE and (rounded <= 0).any() and (values > 0).all():
            raise ModelError(f"float: a {_POSITIVE[name]}, {values.min():.3g}, is 0 when rounded; export double")
    kept = tables["output_decay"]
    decay = kept.astype(np.float32)
    if ((decay == 1) & (kept < 1)).any():
        raise ModelError(
            "float: creep is too slow for this period and would never relax: the decay of a strain in one step, "
            f"{float(kept.max())!r}, rounds to 1; export double, or give a longer period"
        )
