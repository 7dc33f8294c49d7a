"""JSON values of an object, from a list of keys."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np


def json_values(owner: object, keys: str) -> dict[str, Any]:
    """Return attributes of an `owner` as JSON values.

    `keys`: names with blanks between them. "key=attribute" takes the value from an attribute with another name, and
    "key=outer.inner" from an attribute of an attribute (None if the outer one is None).
    """
    found = {}
    for entry in keys.split():
        key, _, name = entry.partition("=")
        value: Any = owner
        for part in (name or key).split("."):
            value = None if value is None else getattr(value, part)
        found[key] = json_value(value)
    return found


def json_value(value: Any) -> Any:
    """Return a value for JSON: arrays and tuples as lists, members of an enumeration by name, objects as dicts.

    Objects need a method `as_dict`.
    """
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if hasattr(value, "as_dict"):
        return value.as_dict()
    if isinstance(value, Mapping):
        return {str(key): json_value(entry) for key, entry in value.items()}
    return [json_value(entry) for entry in value] if isinstance(value, tuple | list) else value
