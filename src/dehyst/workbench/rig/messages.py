"""Requests to the rig process, and the checks of their fields."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any

from dehyst._errors import RigError

Request = dict[str, Any]


def text(request: Request, name: str) -> str:
    """Return the field `name` of a `request`; raise `RigError` if it is not text."""
    value = request.get(name)
    if not isinstance(value, str) or not value:
        raise RigError(f"{request['do']}: got {name} {value!r}, need a text")
    return value


def path(request: Request, name: str) -> Path:
    """Return the field `name` of a `request` as a path; raise `RigError` if it is not text."""
    value = text(request, name)
    if "\0" in value:
        raise RigError(f"{request['do']}: {name} is not the name of a file")
    return Path(value)


def number(request: Request, name: str) -> float | None:
    """Return the field `name` of a `request`, which may be null; raise `RigError` if it is no number."""
    value = request.get(name)
    if value is None:
        return None
    with suppress(OverflowError):  # a whole number beyond all floats
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
    raise RigError(f"{request['do']}: got {name} {str(value)[:60]}, need a finite number")


def pair(request: Request, name: str) -> tuple[float, float] | None:
    """Return the field `name` of a `request`, two numbers or null; raise `RigError` if it is neither."""
    value = request.get(name)
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 2:
        raise RigError(f"{request['do']}: got {name} {str(value)[:60]}, need [lowest, highest]")
    low, high = (number({"do": request["do"], name: end}, name) for end in value)
    if low is None or high is None:
        raise RigError(f"{request['do']}: got {name} {value}, need two numbers")
    return low, high
