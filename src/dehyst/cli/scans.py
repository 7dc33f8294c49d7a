"""Named scans on the command line: their options, in micrometres, and the scan that they define."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from dehyst.waveforms.named import OPTIONS, SCANS, scan_of
from dehyst.waveforms.scan import ScanOption

if TYPE_CHECKING:
    from dehyst.waveforms import Scan

NAMES = tuple(OPTIONS)
_METAVARS = {"pair": "P Q", "numbers": "UM,UM,..."}


def scan_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options of all named scans."""
    for name, option in reversed(OPTIONS.items()):
        command = _click_option(name, option)(command)
    return click.option("--scan", type=click.Choice(list(SCANS)), help="A named path instead of a file.")(command)


def _click_option(name: str, option: ScanOption) -> Callable[..., Any]:
    kind, default, metavar = option.kind, option.default, "N" if option.kind is int else option.unit.upper()
    accepted: Any = {"pair": (int, int), "numbers": str}.get(kind, kind) if isinstance(kind, str) else kind
    if isinstance(kind, tuple):
        accepted, default, metavar = click.Choice(kind), kind[0], ""
    elif isinstance(kind, str):
        metavar = _METAVARS[kind]
    words = f"{option.help}.{f'  [default: {default}]' if default else ''}"
    return click.option(_flag(name), type=accepted, metavar=metavar or None, help=words)


def named_scan(kind: str, sample_rate: float | None, options: dict[str, Any]) -> Scan:
    """Return the scan that the options define.

    Raise `RecordError` if an option is missing, does not belong to this scan, or is impossible.
    """
    from dehyst._errors import RecordError

    given = {name: value for name, value in options.items() if name in OPTIONS and value is not None}
    try:
        given |= {"levels": [float(level) for level in given["levels"].split(",")]} if "levels" in given else {}
    except ValueError as error:
        hint = "give displacements in um with commas, such as 0,10,20"
        raise RecordError(str(error), argument="levels", hint=hint) from error
    return scan_of(kind, given, sample_rate, written=_flag)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"
