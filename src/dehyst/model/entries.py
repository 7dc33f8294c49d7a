"""Entries of a model: the description of an entry states how its value is checked and its key in a model file.

A part, a state or an actuator is a dataclass whose fields are made by `entry`. Its constructor and its file go through
the same checks. A file is read strictly; saving and loading lose nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, Field, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._io import VERSION, PathLike, read_json, write_json
from dehyst._types import Array
from dehyst._validation import Numbers, keep
from dehyst._views.fields import json_value
from dehyst._views.lines import brief

_OTHER_VERSION = "identify the records again, or read the file with the version of dehyst that wrote it"
# A reader takes a value of Python or of a file, and its name in messages; it returns the checked value of the entry.
Reader = Callable[[Any, str], Any]
if TYPE_CHECKING:

    class Numeric:
        """Type of an entry that holds an array; the constructor accepts any `ArrayLike`."""

        def __get__(self, owner: Any, kind: Any = None) -> Array: ...
        def __set__(self, owner: Any, value: ArrayLike) -> None: ...


def entry(key: str, read: Reader, default: Any = MISSING, factory: Any = MISSING) -> Any:
    """Return a dataclass field with its `key` in a file, which includes the unit, and the reader of its value."""
    given = {"default": default} if factory is MISSING else {"default_factory": factory}
    return field(**given, metadata={"key": key, "read": read})


def instance(*kinds: type, optional: bool = False, need: str = "") -> Reader:
    """Return a reader that accepts an object of one of the `kinds`, or the JSON values of such an object.

    `optional`: None is allowed. `need`: the kinds in words, by default their names.
    """

    def read(value: Any, where: str) -> Any:
        if isinstance(value, kinds) or (value is None and optional):
            return value
        own = [kind for kind in kinds if issubclass(kind, Entries) and isinstance(value, Mapping)]
        if own:
            return next((kind for kind in own if set(kind._keys()) == set(value)), own[0]).from_dict(value)
        needed = need or f"an object of {' or '.join(kind.__name__ for kind in kinds)}"
        raise ModelError(argument=where, got=f"{type(value).__name__} {value!r:.40}", need=needed)

    return read


text = instance(str, need="text")
flag = instance(bool, need="true or false")
mapping = instance(Mapping, need="an object with keys")


class Entries:
    """An object that is made of entries.

    `_part`: its name in an actuator, in a model file and in messages. `_head`: format and version of its file, if it
    has one. `_order`: names of the entries in the order of the file, if this differs from the order of the fields.
    """

    _part: ClassVar[str] = ""
    _head: ClassVar[Mapping[str, Any]] = {}
    _order: ClassVar[str] = ""

    __repr__ = brief

    def __post_init__(self) -> None:
        for entry in _described(type(self)):
            where = f"{self._part} {entry.name}".strip()
            keep(self, **{entry.name: entry.metadata["read"](getattr(self, entry.name), where)})
        self._demand_together()

    def _demand_together(self) -> None:
        """Raise `ModelError` if entries do not fit each other."""

    def _demand_one_size(self) -> None:
        """Raise `ModelError` unless all arrays have the same number of numbers."""
        sizes = {entry.name: getattr(self, entry.name).size for entry in _described(type(self))}
        if len(set(sizes.values())) > 1:
            got = ", ".join(f"{size} {name}" for name, size in sizes.items())
            raise ModelError(argument=self._part, got=got, need="the same number of each")

    @classmethod
    def _keys(cls) -> dict[str, str]:
        """Return the field name of each key in a file, in the order of the file."""
        keys = {entry.name: entry.metadata["key"] for entry in _described(cls)}
        return {keys[name]: name for name in cls._order.split() or keys}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values in SI units; `from_dict` reads them back without loss."""
        return {**self._head, **{key: json_value(getattr(self, name)) for key, name in self._keys().items()}}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Rebuild from the `data` of `as_dict`, strictly.

        Raise `ModelError` if the format or version differs, a key is unknown or missing, or a value is impossible.
        """
        where = cls._part or cls.__name__.lower()
        if cls._head:
            demand_format(data, cls._head["format"])
        demand_keys(data, {*cls._head, *cls._keys()}, where)
        made = cls(**{name: data[key] for key, name in cls._keys().items()})
        for key, value in made.as_dict().items():
            if not _same(data[key], value):
                need = "the value as `save` writes it: no number for true or false, no entry left to a default"
                raise ModelError(argument=f"{where}.{key}", got=f"{data[key]!r:.60}", need=need)
        for entry in _described(cls):
            key, read = entry.metadata["key"], entry.metadata["read"]
            if isinstance(read, Numbers):
                _demand_plausible(read, getattr(made, entry.name), f"{cls._part}.{key}" if cls._part else key)
        return made


def _described(kind: type) -> list[Field[Any]]:
    return [entry for entry in fields(kind) if entry.metadata]


def _demand_plausible(read: Numbers, found: Any, where: str) -> None:
    """Raise `ModelError` for numbers in a file that no piezo actuator has."""
    size = float(np.abs(0.0 if found is None else found).max(initial=0.0))
    if size > read.plausible:
        need = f"{read.plausible:g} at most in magnitude, far beyond any piezo actuator"
        raise ModelError(argument=where, got=f"{size:.6g}", need=need, hint="correct the file, or identify again")


def _same(given: Any, written: Any) -> bool:
    """Return whether two JSON values are equal; 1 equals 1.0, but not true."""
    if isinstance(given, list) and isinstance(written, list):
        return len(given) == len(written) and all(map(_same, given, written))
    return bool(given == written) and isinstance(given, bool) == isinstance(written, bool)


class JsonFile(Entries):
    """An object that is saved in a JSON file."""

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


def texts(value: object, where: str) -> tuple[str, ...]:
    """Return texts as a tuple; raise `ModelError` for anything else."""
    if not isinstance(value, list | tuple):
        raise ModelError(argument=where, got=repr(value), need="a list of text")
    return tuple(text(word, where) for word in value)


def demand_format(data: Mapping[str, Any], name: str) -> None:
    """Raise `ModelError` if JSON values have another format than `name`, another version, or are no object."""
    if not isinstance(data, Mapping):
        raise ModelError(got=type(data).__name__, need=f"an object of the format {name!r}")
    kind, found = data.get("format"), data.get("version")
    if kind != name or type(found) is not int or found != VERSION:
        got, need = f"format {kind!r} version {found!r}", f"{name!r} version {VERSION}"
        hint = _OTHER_VERSION if kind == name else "give the name of such a file"
        raise ModelError(got=got, need=need, hint=hint)


def demand_keys(data: Mapping[str, Any], needed: set[str], where: str) -> None:
    """Raise `ModelError` if JSON values are no object, or at unknown and missing keys."""
    missing, unknown = sorted(needed - set(mapping(data, where))), sorted(set(data) - needed)
    if missing or unknown:
        got = f"missing entries {missing}, unknown entries {unknown}"
        raise ModelError(argument=where, got=got, need="neither", hint=_OTHER_VERSION)
