"""The path of a scan as the page draws it while its options are typed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from dehyst._types import Array
from dehyst.waveforms.named import scan_of
from dehyst.workbench.requests import RequestError, number_of, scan_words

_WHOLE = ("lines", "back", "revolutions", "cycles")
_MICRO = 1e6
# Samples that a page draws.
_MOST_SAMPLES = 2_000_000


def scan_columns(scan: Any, rate: Any) -> tuple[Array, Array]:
    """Return time [s] and displacement [um] of a scan that was requested, sampled at a rate [Hz].

    Raises
    ------
    RequestError
        The request is no scan, or has too many samples.
    RecordError
        The scan is impossible.
    """
    scan_words(scan, rate)
    hertz = number_of(rate, "rate")
    given = {name: _value(name, value) for name, value in scan.items() if value is not None and value != ""}
    kind, axis, cycles = (given.pop(name, default) for name, default in (("kind", ""), ("axis", "x"), ("cycles", 1)))
    try:
        path = scan_of(kind, given, hertz).path(axis)
    except (TypeError, KeyError) as error:
        raise RequestError(f"scan: {kind} with {', '.join(given)} lacks an option, or has one too many") from error
    if len(path) * cycles > _MOST_SAMPLES:
        raise RequestError(
            f"rate: {hertz:g} Hz gives {len(path) * cycles} samples, need {_MOST_SAMPLES} at most to draw them; give "
            "a lower rate"
        )
    whole = path.repeated(cycles) if path.periodic else path
    return np.arange(len(whole)) / hertz, whole.displacement * _MICRO


def requested(text: str) -> Mapping[str, Any]:
    """Return the request in a query's JSON."""
    import json

    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise RequestError(f"scan: the request is no JSON ({error})") from error
    if not isinstance(value, dict):
        raise RequestError("scan: the request is no JSON object")
    return value


def _value(name: str, value: Any) -> Any:
    if name == "levels":
        return ",".join(f"{number_of(one, name):.12g}" for one in value)
    if name == "ratio":
        return tuple(int(number_of(one, name)) for one in value)
    return int(value) if name in _WHOLE else value
