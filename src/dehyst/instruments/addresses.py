"""Open a rig by its address, as given on a command line."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import urlsplit

from dehyst._errors import DehystError, RigError, Terminated
from dehyst.instruments.base import AbstractRig
from dehyst.instruments.output import AxisLimits, AxisSlewRates, bounds_of_axes

_Options: TypeAlias = dict[str, Any]


def open_rig(
    address: str, axes: Sequence[str] | None = None, *, limits: AxisLimits = None, slew_rate: AxisSlewRates = None
) -> AbstractRig:
    """Open the rig at an address, with one axis or several that move together.

    Raise `RigError` if the address is not valid or names other axes, or no instrument with these axes answers there;
    `MissingExtraError` if a required package is not installed.

    Parameters
    ----------
    address : str
        ``pi://host:port``, ``pi://host:port/axis`` or ``pi://host:port/1,2,3``: a PI controller (GCS 2.0 over TCP).
        ``epics://PREFIX``: process variables with this prefix.
        ``sim://``: a virtual actuator, without a link, as fast as it computes.
        ``path/to/my_rig.py:make``: your own; `make` is called with `limits` and `slew_rate` and returns an
        `AbstractRig`.
    axes : sequence of str, optional
        Names of the axes of a controller, unless they are in the address; default: its only axis. For your own rig they
        must be the axes that it has, which are the default.
    limits : (float, float) or sequence of (float, float), optional
        Allowed voltages [V], for all axes or for each; they are narrowed to the limits of the device.
    slew_rate : float or sequence of float, optional
        Largest abs(dv/dt) [V/s], for all axes or for each; a lower one of the device has priority.
    """
    options: _Options = {"limits": limits, "slew_rate": slew_rate}
    word, separator, rest = address.partition("://")
    kind = SCHEMES.get(word.lower())
    if separator and kind is None:
        raise RigError(f"{address}: got an unknown kind of rig, {word!r}; need {_FORMS}")
    if separator and axes is not None and kind != SCHEMES["pi"]:
        raise RigError(f"{address}: cannot choose axes, or play several together; need {SCHEMES['pi'][0]}")
    rig = _custom(address, options) if kind is None else kind[1](rest, axes, options)
    if getattr(rig, "axes", None) is None:
        raise RigError(f"{type(rig).__name__}: its __init__ does not call super().__init__(name, limits, ...)")
    try:
        if axes is not None and tuple(axes) != rig.axes:
            raise RigError(f"{address}: has the axes {', '.join(rig.axes)}, but {', '.join(axes)} were requested")
        _demand_limits(rig, limits, slew_rate)
    except RigError:
        rig.close()
        raise
    return rig


def _demand_limits(rig: AbstractRig, limits: AxisLimits, slew_rate: AxisSlewRates) -> None:
    """Raise RigError unless the limits of each axis lie within the requested ones."""
    asked = bounds_of_axes(limits, slew_rate, len(rig.axes))
    for part, (bounds, rate) in zip(rig.rigs, asked, strict=True):
        low, high = bounds or (part.limits.low, part.limits.high)
        steepest = rate or part.slew_rate
        if not (low <= part.limits.low and part.limits.high <= high and part.slew_rate <= steepest):
            raise RigError(
                f"{part.name}: allows {part.limits.words} and {part.slew_rate:.6g} V/s, but {low:g} to {high:g} V and "
                f"{steepest:.6g} V/s were requested; pass limits and slew_rate on to AbstractRig"
            )


def _pi(rest: str, axes: Sequence[str] | None, options: _Options) -> AbstractRig:
    from dehyst.instruments.pi import PORT, PiRig

    try:
        parts = urlsplit(f"//{rest}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise RigError(f"pi://{rest}: is not the address of a rig ({error}); need pi://host:port") from error
    path = parts.path.strip("/")
    if not host or parts.query or parts.fragment or "/" in path:
        raise RigError(f"pi://{rest}: need pi://host:port, or pi://host:port/axis")
    named = [name for name in path.split(",") if name] or list(axes or ())
    return PiRig.connect(host, PORT if port is None else port, axis=named or None, **options)


def _epics(prefix: str, _: Sequence[str] | None, options: _Options) -> AbstractRig:
    from dehyst.instruments.epics import EpicsRig

    if not prefix:
        raise RigError("epics://: need the prefix of the process variables, as in epics://LAB:PIEZO")
    return EpicsRig.connect(prefix, **options)


def _sim(name: str, _: Sequence[str] | None, options: _Options) -> AbstractRig:
    from dehyst.instruments.simulated import SimulatedRig
    from dehyst.virtual import PlayActuator

    if name:
        raise RigError(argument="sim://", got=name, need="nothing after it")
    return SimulatedRig(PlayActuator(), **options)


# Each kind of address: how it is written, and the function that opens it by the text after ``://``, axes and options.
SCHEMES: dict[str, tuple[str, Callable[[str, Sequence[str] | None, _Options], AbstractRig]]] = {
    "pi": ("pi://host:port[/axis or /1,2,3]", _pi),
    "epics": ("epics://PREFIX", _epics),
    "sim": ("sim://", _sim),
}
_FORMS = f"{', '.join(form for form, _ in SCHEMES.values())} or path/to/my_rig.py:make"


def _custom(address: str, options: _Options) -> AbstractRig:
    """Run a user's file, and call its function."""
    place, separator, name = address.rpartition(":")
    if not (separator and place.endswith(".py") and name.isidentifier()):
        raise RigError(f"{address!r}: is not the address of a rig; need {_FORMS}")
    path = Path(place)
    if not path.is_file():
        raise RigError(f"{path}: the file does not exist; need one with a function that makes a rig")
    # Modules in the same folder can be imported, like in a script of Python.
    if (folder := str(path.resolve().parent)) not in sys.path:
        sys.path.insert(0, folder)
    try:
        make = runpy.run_path(str(path), run_name=path.stem).get(name)
        if not callable(make):
            raise RigError(
                f"{path}: has no function {name!r}; need one that takes limits and slew_rate and returns a rig"
            )
        rig = make(**options)
    except (DehystError, Terminated):
        raise
    except (Exception, SystemExit) as error:  # code of others may raise anything
        raise RigError(
            f"{path}:{name}: raised {type(error).__name__}: {error}; dehyst calls it with limits and slew_rate"
        ) from error
    if not isinstance(rig, AbstractRig):
        raise RigError(f"{path}:{name}: returned a {type(rig).__name__}, need an AbstractRig (see dehyst.instruments)")
    return rig
