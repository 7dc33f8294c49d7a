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
        Names of the axes of a controller, unless they are in the address; default: its only axis. Those of a rig of
        your own must be the ones that it has; default: these.
    limits : (float, float) or sequence of (float, float), optional
        Allowed voltages [V], for all axes or for each; they are narrowed to the limits of the device.
    slew_rate : float or sequence of float, optional
        Largest abs(dv/dt) [V/s], for all axes or for each; a lower one of the device has priority.
    """
    options: _Options = {"limits": limits, "slew_rate": slew_rate}
    word, separator, rest = address.partition("://")
    forms = f"{', '.join(form for form, _ in SCHEMES.values())} or path/to/my_rig.py:make"
    if separator:
        if word.lower() not in SCHEMES:
            raise RigError(f"{address}: got an unknown kind of rig, {word!r}; need {forms}")
        if word.lower() == "pi":
            options["axes"] = axes
        elif axes is not None:
            raise RigError(f"{address}: cannot choose axes, or play several together; need {SCHEMES['pi'][0]}")
        _, opened = SCHEMES[word.lower()]
        return _checked(opened(rest, options), limits, slew_rate)
    path, separator, name = address.rpartition(":")
    if not (separator and path.endswith(".py") and name.isidentifier()):
        raise RigError(f"{address!r}: is not the address of a rig; need {forms}")
    rig = _checked(_custom(Path(path), name, options), limits, slew_rate)
    if axes is not None and tuple(axes) != rig.axes:
        rig.close()
        raise RigError(f"{address}: has the axes {', '.join(rig.axes)}, but {', '.join(axes)} were requested")
    return rig


def _checked(rig: AbstractRig, limits: AxisLimits, slew_rate: AxisSlewRates) -> AbstractRig:
    """Return the rig if the limits of its axes lie within the requested ones; raises RigError."""
    if getattr(rig, "axes", None) is None:
        raise RigError(f"{type(rig).__name__}: its __init__ does not call super().__init__(name, limits, ...)")
    for one, (bounds, rate) in zip(rig.rigs, bounds_of_axes(limits, slew_rate, len(rig.axes)), strict=True):
        low, high = bounds or (one.limits.low, one.limits.high)
        steepest = rate or one.slew_rate
        if low <= one.limits.low and one.limits.high <= high and one.slew_rate <= steepest:
            continue
        rig.close()
        raise RigError(
            f"{one.name}: allows {one.limits.words} and {one.slew_rate:.6g} V/s, but {low:g} to {high:g} V and "
            f"{steepest:.6g} V/s were requested; pass limits and slew_rate on to AbstractRig"
        )
    return rig


def _pi(rest: str, options: _Options) -> AbstractRig:
    from dehyst.instruments.pi import PORT, PiRig

    try:
        parts = urlsplit(f"//{rest}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise RigError(f"pi://{rest}: is not the address of a rig ({error}); need pi://host:port") from error
    path, axes = parts.path.strip("/"), options.pop("axes")
    if not host or parts.query or parts.fragment or "/" in path:
        raise RigError(f"pi://{rest}: need pi://host:port, or pi://host:port/axis")
    named = [name for name in path.split(",") if name]
    if axes is not None and named and list(axes) != named:
        raise RigError(f"pi://{rest}: names the axes {', '.join(named)}, but {', '.join(axes)} are requested; give one")
    return PiRig.connect(host, PORT if port is None else port, axis=list(axes or named) or None, **options)


def _epics(prefix: str, options: _Options) -> AbstractRig:
    from dehyst.instruments.epics import EpicsRig

    if not prefix:
        raise RigError("epics://: need the prefix of the process variables, as in epics://LAB:PIEZO")
    return EpicsRig.connect(prefix, **options)


def _sim(name: str, options: _Options) -> AbstractRig:
    from dehyst.instruments.simulated import SimulatedRig
    from dehyst.virtual import PlayActuator

    if name:
        raise RigError(argument="sim://", got=name, need="nothing after it")
    return SimulatedRig(PlayActuator(), **options)


# How each kind of address is written, and the function of the rest after ``://`` and of the options that opens it.
SCHEMES: dict[str, tuple[str, Callable[[str, _Options], AbstractRig]]] = {
    "pi": ("pi://host:port[/axis or /1,2,3]", _pi),
    "epics": ("epics://PREFIX", _epics),
    "sim": ("sim://", _sim),
}


def _custom(path: Path, name: str, options: _Options) -> AbstractRig:
    """Run a user's file, and call its function `name`."""
    if not path.is_file():
        raise RigError(f"{path}: the file does not exist; need one with a function that makes a rig")
    # As Python does for a script: modules in the same folder can be imported.
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
