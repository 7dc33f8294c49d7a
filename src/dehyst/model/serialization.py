"""Model files: an actuator's parts to JSON values and back, strictly and without loss."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst._validation import number
from dehyst.model.base import State
from dehyst.model.dynamics import Creep, Dynamics
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.identification import Identification

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

FORMAT = "dehyst-actuator"
VERSION = 3
# The keys of a part's fields, in their order.
_SPRING = ("displacement_m", "voltage_V")
_PARTS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "transformer": (Transformer, ("voltage_V", "drive_V")),
    "creep": (Creep, ("time_constants_s", "stiffness_V_per_m")),
    "smooth": (SmoothSlip, ("length_m", "closing", "stiffness_V_per_m")),
    "dynamics": (Dynamics, ("frequency_rad_per_s", "damping", "series_V_per_m")),
}
_PLAIN = {"format", "version", "name", "slip", "spring", "state", "limits", "delay_s", "provenance"}
# Entries of a model file that are not the actuator's: two files of one actuator may differ in them.
DESCRIPTION = {"format", "version", "name", "provenance", "identification"}
# Of the limits; one of them may be missing.
_LIMITS = ("voltage_V", "recorded_slew_rate_V_per_s")
_KEYS = _PLAIN | _PARTS.keys() | {"load_stiffness_N_per_m", "lag_s", "identification"}


def as_dict(actuator: Actuator) -> dict[str, Any]:
    """Return the JSON values of an actuator in SI units; missing parts are null."""
    slip = actuator.slip
    elements: dict[str, Any] = {"breakaway_m": slip.breakaway.tolist()}
    if isinstance(slip, GradedSlip):
        elements["knots_m"] = slip.knots.tolist()
    elements["stiffness_V_per_m"] = slip.stiffness.tolist()
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": actuator.name,
        "slip": elements,
        "spring": _values(actuator.spring, _SPRING),
        **{name: _values(getattr(actuator, name), keys) for name, (_, keys) in _PARTS.items()},
        "load_stiffness_N_per_m": actuator.load_stiffness,
        "lag_s": actuator.lag,
        "state": state_dict(actuator.state),
        "limits": _limits_dict(actuator),
        "delay_s": actuator.delay,
        "identification": None if actuator.identification is None else actuator.identification.as_dict(),
        "provenance": dict(actuator.provenance),
    }


def _limits_dict(actuator: Actuator) -> dict[str, Any] | None:
    """Return the voltages and the speed of the records, as far as they are known."""
    voltage = None if actuator.limits is None else list(actuator.limits)
    given = zip(_LIMITS, (voltage, actuator.recorded_slew_rate), strict=True)
    return {key: value for key, value in given if value is not None} or None


def _values(part: Any, keys: tuple[str, ...]) -> dict[str, Any] | None:
    """Return the fields of a part, in order, as JSON values under these keys; None without the part."""
    if part is None:
        return None
    values = [getattr(part, field.name) for field in fields(part)]
    plain = [value.tolist() if isinstance(value, np.ndarray) else value for value in values]
    return dict(zip(keys, plain, strict=True))


def state_dict(state: State) -> dict[str, Any]:
    """Return the JSON values of a state."""
    return {
        "displacement_m": state.displacement,
        "carts_m": state.carts.tolist(),
        "creep_m": state.creep.tolist(),
        "smooth_m": state.smooth.tolist(),
        "motion": None
        if not state.motion.size
        else {"displacement_m": float(state.motion[0]), "velocity_m_per_s": float(state.motion[1])},
    }


def parts(data: Mapping[str, Any]) -> dict[str, Any]:
    """Read the arguments of `Actuator`, by name.

    Version 1 has Maxwell-slip elements and a spring only; versions 1 and 2 hold the `Identification` among the entries
    of "provenance".

    Raise `ModelError` if the format or version differs, a key is unknown or missing, or a number is impossible.
    """
    version = data.get("version")
    if data.get("format") != FORMAT or type(version) is not int or version not in (1, 2, VERSION):
        raise ModelError(
            f"got format {data.get('format')!r} version {version!r}, need {FORMAT!r} version 1, 2 or {VERSION}"
        )
    demand_keys(data, {1: _PLAIN, 2: _KEYS - {"identification"}}.get(version, _KEYS), "model")
    if not isinstance(data["name"], str) or not isinstance(data["provenance"], Mapping):
        raise ModelError("model: name must be text and provenance an object")
    spring = _part(data, "spring", set(_SPRING))
    known = set(_LIMITS) & set(data["limits"]) if isinstance(data["limits"], Mapping) else set()
    given = {} if data["limits"] is None else _part(data, "limits", known or set(_LIMITS[:1]))
    limits, slew_rate = (given.get(key) for key in _LIMITS)
    plain = {
        "slip": _slip(data, graded=version > 1),
        "spring": Spring(*_columns(spring, "spring", *_SPRING)),
        "limits": None if limits is None else _pair(limits),
        "recorded_slew_rate": None if slew_rate is None else number(slew_rate, _LIMITS[1]),
        "delay": number(data["delay_s"], "delay_s"),
        "name": data["name"],
        "provenance": data["provenance"],
        "identification": _identification(data),
    }
    return {**plain, "state": _state(data, set())} if version == 1 else {**plain, **_further_parts(data)}


def _identification(data: Mapping[str, Any]) -> Identification | None:
    if "identification" not in data:
        return Identification.from_entries(data["provenance"])
    if data["identification"] is None:
        return None
    return Identification.from_dict(_part(data, "identification", set(Identification().as_dict())))


def _further_parts(data: Mapping[str, Any]) -> dict[str, Any]:
    stiffness = data["load_stiffness_N_per_m"]
    parts: dict[str, Any] = {
        "state": state(data),
        "lag": number(data["lag_s"], "lag_s"),
        "load_stiffness": None if stiffness is None else number(stiffness, "load_stiffness_N_per_m"),
    }
    for name, (kind, keys) in _PARTS.items():
        if data[name] is not None:
            part, read = _part(data, name, set(keys)), number if kind is Dynamics else numbers
            parts[name] = kind(*(read(part[key], f"{name}.{key}") for key in keys))
    return parts


def _slip(data: Mapping[str, Any], *, graded: bool) -> MaxwellSlip | GradedSlip:
    keys, slip = {"breakaway_m", "stiffness_V_per_m"}, data["slip"]
    if not (graded and isinstance(slip, Mapping) and "knots_m" in slip):
        return MaxwellSlip(*_columns(_part(data, "slip", keys), "slip", "breakaway_m", "stiffness_V_per_m"))
    slip = _part(data, "slip", keys | {"knots_m"})
    rho, knots = _columns(slip, "slip", "breakaway_m", "knots_m")
    rows, where = slip["stiffness_V_per_m"], "slip.stiffness_V_per_m"
    if not isinstance(rows, list) or len(rows) != rho.size:
        raise ModelError(f"{where}: need a list of {rho.size} lists of numbers, one for an element")
    table = [numbers(row, f"{where}[{i}]") for i, row in enumerate(rows)]
    if any(row.size != knots.size - 1 for row in table):
        raise ModelError(f"{where}: got rows of {[row.size for row in table]} numbers, need {knots.size - 1} in each")
    return GradedSlip(rho, knots, np.array(table).reshape(rho.size, knots.size - 1))


def state(data: Mapping[str, Any]) -> State:
    """Read the entry "state", strictly.

    Raise `ModelError` if a key is unknown or missing, or a number is impossible.
    """
    return _state(data, {"creep_m", "smooth_m", "motion"})


def _state(data: Mapping[str, Any], more: set[str]) -> State:
    state = _part(data, "state", {"displacement_m", "carts_m"} | more)
    w, carts = number(state["displacement_m"], "state.displacement_m"), numbers(state["carts_m"], "state.carts_m")
    if not more:
        return State(w, carts)
    motion: tuple[float, ...] = ()
    if state["motion"] is not None:
        part = _part(state, "motion", {"displacement_m", "velocity_m_per_s"})
        motion = tuple(number(part[key], f"motion.{key}") for key in ("displacement_m", "velocity_m_per_s"))
    creep, smooth = _columns(state, "state", "creep_m", "smooth_m")
    return State(w, carts, creep, motion, smooth)


def demand_keys(data: Mapping[str, Any], needed: set[str], where: str) -> None:
    """Raise `ModelError` at unknown and missing keys."""
    missing, unknown = sorted(needed - set(data)), sorted(set(data) - needed)
    if missing or unknown:
        raise ModelError(f"{where}: missing keys {missing}, unknown keys {unknown}; need exactly {sorted(needed)}")


def _part(data: Mapping[str, Any], key: str, needed: set[str]) -> Mapping[str, Any]:
    part = data[key]
    if not isinstance(part, Mapping):
        raise ModelError(f"model: {key} must be an object with keys {sorted(needed)}, got {type(part).__name__}")
    demand_keys(part, needed, key)
    return part


def _columns(part: Mapping[str, Any], where: str, *keys: str) -> list[Array]:
    return [numbers(part[key], f"{where}.{key}") for key in keys]


def numbers(values: Any, where: str) -> Array:
    """Return a list of finite numbers as an array; raise `ModelError` otherwise."""
    if not isinstance(values, list):
        raise ModelError(f"{where}: got {type(values).__name__}, need a list of numbers")
    return np.array([number(value, f"{where}[{i}]") for i, value in enumerate(values)], dtype=np.float64)


def _pair(values: Any) -> tuple[float, float]:
    if not isinstance(values, list) or len(values) != 2:
        raise ModelError(f"limits.voltage_V: got {values!r}, need two numbers")
    return number(values[0], "limits.voltage_V"), number(values[1], "limits.voltage_V")
