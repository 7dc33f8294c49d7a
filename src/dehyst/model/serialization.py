"""Model files: an actuator's parts to JSON values and back, strictly and without loss."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from dehyst._errors import ModelError
from dehyst._io import OTHER_VERSION, VERSION, PathLike, read_json, write_json
from dehyst._types import Array
from dehyst._validation import number
from dehyst._views.fields import json_value
from dehyst.model.base import State
from dehyst.model.dynamics import DisplacementCreep, Dynamics, Thermal
from dehyst.model.elements import GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.identification import Identification

if TYPE_CHECKING:
    from dehyst.model.actuator import Actuator

FORMAT = "dehyst-actuator"
# Parts of one set of keys each, which are those of their fields in order; all but the spring may be missing.
_PARTS: dict[str, tuple[Callable[..., Any], tuple[str, ...]]] = {
    "spring": (Spring, ("displacement_m", "voltage_V")),
    "transformer": (Transformer, ("voltage_V", "drive_V")),
    "smooth": (SmoothSlip, ("length_m", "closing", "stiffness_V_per_m")),
    "displacement_creep": (DisplacementCreep, ("time_constants_s", "gains")),
    "thermal": (Thermal, ("gain_per_K", "offset_m_per_K", "reference_degC")),
    "dynamics": (Dynamics, ("frequency_Hz", "damping", "series_V_per_m")),
}
# Entries of a model file that are not the actuator's: two files of one actuator may differ in them.
DESCRIPTION = {"format", "version", "name", "provenance", "identification"}
_NUMBERS = {"slip", "state", "limits_V", "delay_s", "lag_s", "load_stiffness_N_per_m"}
_KEYS = DESCRIPTION | _PARTS.keys() | _NUMBERS
# Largest magnitudes in a file, far beyond those of any piezo actuator: a larger one was edited or damaged.
_LARGEST = {
    "stiffness_V_per_m": 1e20,
    "series_V_per_m": 1e20,
    "load_stiffness_N_per_m": 1e15,
    "gain_per_K": 1.0,
    "offset_m_per_K": 1e-3,
    "reference_degC": 1e3,
    "slew_rate_V_per_s": 1e11,
}


class JsonFile(ABC):
    """An object that is saved in a JSON file."""

    @abstractmethod
    def as_dict(self) -> dict[str, Any]:
        """Return JSON values in SI units; `from_dict` reads them back without loss."""

    @classmethod
    @abstractmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Rebuild from the `data` of `as_dict`, strictly; raise `ModelError` if a value or a key is impossible."""

    def __eq__(self, other: object) -> bool:
        return self is other or (type(other) is type(self) and self.as_dict() == other.as_dict())

    def __hash__(self) -> int:
        return hash((type(self).__name__, getattr(self, "name", "")))

    def save(self, path: PathLike) -> None:
        """Write the file (JSON) at `path`, completely or not at all; raise `FileFormatError` if that fails."""
        write_json(path, self.as_dict())

    @classmethod
    def load(cls, path: PathLike) -> Self:
        """Read the file at `path`, strictly.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is not JSON.
        ModelError
            If it is of another format or version, or holds impossible values.
        """
        data = read_json(path)
        try:
            return cls.from_dict(data)
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error


def as_dict(actuator: Actuator) -> dict[str, Any]:
    """Return the JSON values of an actuator in SI units; missing parts are null."""
    slip = actuator.slip
    knots = {"knots_m": slip.knots.tolist()} if isinstance(slip, GradedSlip) else {}
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": actuator.name,
        "slip": {"breakaway_m": slip.breakaway.tolist(), **knots, "stiffness_V_per_m": slip.stiffness.tolist()},
        **{name: _values(getattr(actuator, name), keys) for name, (_, keys) in _PARTS.items()},
        "load_stiffness_N_per_m": actuator.load_stiffness,
        "lag_s": actuator.lag,
        "state": state_dict(actuator.state),
        "limits_V": json_value(actuator.limits),
        "delay_s": actuator.delay,
        "identification": json_value(actuator.identification),
        "provenance": dict(actuator.provenance),
    }


def _values(part: Any, keys: tuple[str, ...]) -> dict[str, Any] | None:
    """Return the fields of a part, in order, as JSON values under these keys; None if the part is missing."""
    if part is None:
        return None
    return {key: json_value(getattr(part, field.name)) for key, field in zip(keys, fields(part), strict=True)}


def state_dict(state: State) -> dict[str, Any]:
    """Return the JSON values of a state."""
    motion = dict(zip(("displacement_m", "velocity_m_per_s"), state.motion.tolist(), strict=False)) or None
    return {
        "deformation_m": state.deformation,
        "carts_m": state.carts.tolist(),
        "smooth_m": state.smooth.tolist(),
        "displacement_creep_m": state.displacement_creep.tolist(),
        "motion": motion,
    }


def parts(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of `Actuator` by name from JSON values.

    Raise `ModelError` if the format or version differs, a key is unknown or missing, or a number is impossible.
    """
    demand_format(data, FORMAT)
    demand_keys(data, _KEYS, "model")
    if not isinstance(data["name"], str) or not isinstance(data["provenance"], Mapping):
        raise ModelError("model: name must be text and provenance an object")
    found: dict[str, Any] = {"name": data["name"], "provenance": data["provenance"]}
    found["slip"] = _slip(data)
    for name, (kind, keys) in _PARTS.items():
        if name == "spring" or data[name] is not None:
            part, read = _part(data, name, set(keys)), number if kind in (Dynamics, Thermal) else numbers
            found[name] = kind(*(read(part[key], f"{name}.{key}") for key in keys))
    found["lag"] = number(data["lag_s"], "lag_s")
    found["load_stiffness"] = _or_none(number, data["load_stiffness_N_per_m"], "load_stiffness_N_per_m")
    if data["identification"] is not None:
        entries = _part(data, "identification", set(Identification.keys()))
        found["identification"] = Identification.from_dict(entries)
    found["limits"] = _or_none(_pair, data["limits_V"], "limits_V")
    found |= {"delay": number(data["delay_s"], "delay_s"), "state": state(data)}
    for where in ("", "identification", *_PARTS, "slip"):
        _demand_plausible(where, data.get(where) if where else data)
    return found


def _demand_plausible(where: str, values: Mapping[str, Any] | None) -> None:
    """Raise `ModelError` for a number of a part that no piezo actuator has; the values are known to be numbers."""
    for key in _LARGEST.keys() & (values or {}).keys():
        given, most = values[key], _LARGEST[key]  # type: ignore[index]
        rows = np.concatenate(given) if given and isinstance(given, list) and isinstance(given[0], list) else given
        sizes = np.abs(np.atleast_1d(np.asarray(0.0 if rows is None else rows, dtype=np.float64)))
        if sizes.max(initial=0.0) > most:
            raise ModelError(
                argument=f"{where}.{key}" if where else key,
                got=f"{sizes.max():.6g}",
                need=f"{most:g} at most in magnitude, far beyond any piezo actuator",
                hint="correct the file, or identify again",
            )


def _slip(data: Mapping[str, Any]) -> MaxwellSlip | GradedSlip:
    keys, given, where = {"breakaway_m", "stiffness_V_per_m"}, data["slip"], "slip.stiffness_V_per_m"
    graded = isinstance(given, Mapping) and "knots_m" in given
    slip = _part(data, "slip", keys | {"knots_m"} if graded else keys)
    rho, rows = numbers(slip["breakaway_m"], "slip.breakaway_m"), slip["stiffness_V_per_m"]
    if not graded:
        return MaxwellSlip(rho, numbers(rows, where))
    knots = numbers(slip["knots_m"], "slip.knots_m")
    if not isinstance(rows, list) or len(rows) != rho.size:
        raise ModelError(f"{where}: need a list of {rho.size} lists of numbers, one for an element")
    table = [numbers(row, f"{where}[{i}]") for i, row in enumerate(rows)]
    if any(row.size != knots.size - 1 for row in table):
        raise ModelError(f"{where}: got rows of {[row.size for row in table]} numbers, need {knots.size - 1} in each")
    return GradedSlip(rho, knots, np.array(table).reshape(rho.size, knots.size - 1))


def state(data: Mapping[str, Any]) -> State:
    """Read the entry "state" of a model file, strictly.

    Raise `ModelError` if a key is unknown or missing, or a number is impossible.
    """
    rows = ("carts_m", "smooth_m", "displacement_creep_m")
    given = _part(data, "state", {"deformation_m", *rows, "motion"})
    found = {key.removesuffix("_m"): numbers(given[key], f"state.{key}") for key in rows}
    if given["motion"] is not None:
        keys = ("displacement_m", "velocity_m_per_s")
        part = _part(given, "motion", set(keys))
        found["motion"] = np.array([number(part[key], f"motion.{key}") for key in keys])
    return State(number(given["deformation_m"], "state.deformation_m"), **found)


def demand_format(data: Mapping[str, Any], name: str) -> None:
    """Raise `ModelError` if JSON values have another format than `name`, another version, or are no object."""
    if not isinstance(data, Mapping):
        raise ModelError(got=type(data).__name__, need=f"an object of the format {name!r}")
    kind, found = data.get("format"), data.get("version")
    if kind != name or type(found) is not int or found != VERSION:
        raise ModelError(
            got=f"format {kind!r} version {found!r}",
            need=f"{name!r} version {VERSION}",
            hint=OTHER_VERSION if kind == name else "",
        )


def demand_keys(data: Mapping[str, Any], needed: set[str], where: str) -> None:
    """Raise `ModelError` at unknown and missing keys."""
    missing, unknown = sorted(needed - set(data)), sorted(set(data) - needed)
    if missing or unknown:
        found = f"{where}: missing keys {missing}, unknown keys {unknown}; need exactly {sorted(needed)}"
        raise ModelError(found, hint=OTHER_VERSION)


def _part(data: Mapping[str, Any], key: str, needed: set[str]) -> Mapping[str, Any]:
    part = data[key]
    if not isinstance(part, Mapping):
        raise ModelError(f"model: {key} must be an object with keys {sorted(needed)}, got {type(part).__name__}")
    demand_keys(part, needed, key)
    return part


def numbers(values: Any, where: str) -> Array:
    """Return a list of finite numbers as an array; raise `ModelError` otherwise."""
    if not isinstance(values, list):
        raise ModelError(f"{where}: got {type(values).__name__}, need a list of numbers")
    return np.array([number(value, f"{where}[{i}]") for i, value in enumerate(values)], dtype=np.float64)


def _pair(values: Any, where: str) -> tuple[float, float]:
    if not isinstance(values, list) or len(values) != 2:
        raise ModelError(f"{where}: got {values!r}, need two numbers")
    return number(values[0], where), number(values[1], where)


def _or_none(read: Callable[[Any, str], Any], value: Any, where: str) -> Any:
    return None if value is None else read(value, where)
