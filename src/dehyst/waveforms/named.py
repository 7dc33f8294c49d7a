"""Scans by name, from options in micrometres and degrees, as their fields declare them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from dehyst._errors import RecordError
from dehyst.waveforms.one_axis import Steps, Triangle
from dehyst.waveforms.scan import Scan, between, options_of
from dehyst.waveforms.two_axes import Lissajous, Raster, Spiral


class ScanKind(NamedTuple):
    """A named scan: its class, its required and optional options, and whether it is a figure."""

    scan: Callable[..., Scan]
    needs: tuple[str, ...]
    may: tuple[str, ...]
    figure: bool

    @property
    def takes(self) -> tuple[str, ...]:
        """All options of the scan."""
        return (*self.needs, *self.may)


_SCANS = Triangle, Raster, Spiral, Lissajous, Steps
OPTIONS = {name: option for scan in _SCANS for name, option in options_of(scan).items()}
# By name a figure has ranges, from which its middle and its size follow.
_SIZES = ("centre", "radius", "amplitude", "sample_rate")
for _name in _SIZES:
    del OPTIONS[_name]


def _kind(scan: type[Scan]) -> ScanKind:
    options = options_of(scan)
    own = [name for name in options if name not in _SIZES]
    needs = tuple(name for name in own if not hasattr(scan, name))
    may = tuple(name for name in own if name not in needs)
    figure = "centre" in options
    return ScanKind(scan, ("low", "high") * figure + needs, ("y_low", "y_high") * figure + may, figure)


SCANS = {scan.__name__.lower(): _kind(scan) for scan in _SCANS}


def scan_of(kind: str, options: Mapping[str, Any], sample_rate: float | None) -> Scan:
    """Return the scan of a `kind`, a name in `SCANS`, with these options.

    Parameters
    ----------
    options : mapping
        Values by name, as `OPTIONS` declares them: lengths in micrometres, the phase in degrees, levels as numbers.
    sample_rate : float, optional
        [Hz].

    Raises
    ------
    RecordError
        An option is missing, does not belong to the scan, or is impossible.
    """
    scan = SCANS[kind]
    if missing := [name for name in scan.needs if name not in options]:
        raise RecordError(argument=", ".join(missing), got=f"none for a {kind}", need=", ".join(scan.needs))
    if foreign := [name for name in options if name not in scan.takes]:
        got = f"{options[foreign[0]]!r} for a {kind}, which takes {', '.join(scan.takes)}"
        raise RecordError(argument=foreign[0], got=got)
    given = {name: OPTIONS[name].in_si(value) for name, value in options.items()}
    if scan.figure:
        x = between(given.pop("low"), given.pop("high"))
        y = between(given.pop("y_low", x[0]), given.pop("y_high", x[1]), ("y_low", "y_high"))
        (x_middle, a), (y_middle, b) = ((0.5 * (low + high), 0.5 * (high - low)) for low, high in (x, y))
        given["centre"] = x_middle, y_middle
        if scan.scan is Lissajous:
            given["amplitude"] = a, b
        elif abs(a - b) <= 1e-9 * a:
            given["radius"] = a
        else:
            raise RecordError(
                f"got a range of {2e6 * b:.6g} um, but x has {2e6 * a:.6g} um, and a spiral is round",
                argument="y_low, y_high",
                hint="give equal ranges",
            )
    return scan.scan(**given, sample_rate=sample_rate)
