"""Rigs by their addresses, as they are given on a command line."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import urlsplit

from dehyst._errors import DehystError, RigError
from dehyst.instruments.base import AbstractRig

_Asked = dict[str, Any]
_FORMS = (
    "pi://host:port[/axis], epics://PREFIX, sim://play (or creep, preisach, boucwen, /path/to/model.json), "
    "ni://Dev1/ao0,ai0?gain=10&scale=5 or path/to/my_rig.py:make"
)


def open_rig(address: str, *, limits: tuple[float, float] | None = None, slew_rate: float | None = None) -> AbstractRig:
    """Open the rig at an address.

    Parameters
    ----------
    address : str
        ``pi://host:port`` or ``pi://host:port/axis``: a PI controller (GCS 2.0 over TCP).
        ``epics://PREFIX``: process variables that begin so.
        ``sim://play``, ``creep``, ``preisach``, ``boucwen`` or ``sim:///path/to/model.json``: a virtual one, without
        a link, as fast as it computes.
        ``ni://Dev1/ao0,ai0?gain=10&scale=5``: a data acquisition card; not tried on hardware.
        ``path/to/my_rig.py:make``: your own; `make` is called with `limits` and `slew_rate` and returns an
        `AbstractRig`.
    limits : (float, float), optional
        Voltages to allow [V]; what the device does not allow is left out.
    slew_rate : float, optional
        Largest abs(dv/dt) [V/s]; the device's where that is lower.

    Raises
    ------
    RigError
        If the address is none, or there is nothing at it.
    MissingExtraError
        If a package is needed that is not installed.
    """
    asked: _Asked = {"limits": limits, "slew_rate": slew_rate}
    scheme, separator, rest = address.partition("://")
    if separator:
        if scheme.lower() not in _OPENERS:
            raise RigError(f"{address}: there is no kind of rig called {scheme!r}; need {_FORMS}")
        return _kept(_OPENERS[scheme.lower()](rest, asked), asked)
    path, separator, name = address.rpartition(":")
    if not (separator and path.endswith(".py") and name.isidentifier()):
        raise RigError(f"{address!r}: is no address of a rig; need {_FORMS}")
    return _kept(_own(Path(path), name, asked), asked)


def _kept(rig: AbstractRig, asked: _Asked) -> AbstractRig:
    """The rig, if it keeps to what was asked; raises RigError."""
    kept = getattr(rig, "limits", None)
    if kept is None:
        raise RigError(f"{type(rig).__name__}: its __init__ does not call super().__init__(name, limits, ...)")
    limits, slew_rate = asked["limits"] or (kept.low, kept.high), asked["slew_rate"] or rig.slew_rate
    if limits[0] <= kept.low and kept.high <= limits[1] and rig.slew_rate <= slew_rate:
        return rig
    rig.close()
    raise RigError(
        f"{rig.name}: allows itself {kept.words} and {rig.slew_rate:.6g} V/s, but {limits[0]:g} to {limits[1]:g} V and "
        f"{slew_rate:.6g} V/s were asked for; pass limits= and slew_rate= on to AbstractRig"
    )


def _pi(rest: str, asked: _Asked) -> AbstractRig:
    from dehyst.instruments.pi import PORT, PiRig

    try:
        parts = urlsplit(f"//{rest}")
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise RigError(f"pi://{rest}: is no address of a rig ({error}); need pi://host:port") from error
    axis = parts.path.strip("/") or None
    if not host or parts.query or parts.fragment or (axis and "/" in axis):
        raise RigError(f"pi://{rest}: need pi://host:port, or pi://host:port/axis")
    return PiRig.connect(host, PORT if port is None else port, axis=axis, **asked)


def _epics(prefix: str, asked: _Asked) -> AbstractRig:
    if not prefix:
        raise RigError("epics://: need the prefix of process variables, as in epics://LAB:PIEZO")
    from dehyst.instruments.epics import EpicsRig

    # The colon between prefix and name is added there.
    return EpicsRig.connect(prefix.removesuffix(":"), **asked)


def _sim(name: str, asked: _Asked) -> AbstractRig:
    if not name:
        raise RigError("sim://: need play, creep, preisach, boucwen or /path/to/model.json behind it")
    from dehyst.instruments.simulated import SimulatedRig
    from dehyst.virtual.modelled import virtual_actuator

    return SimulatedRig(virtual_actuator(name), **asked)


def _ni(rest: str, asked: _Asked) -> AbstractRig:
    from dehyst.instruments.nidaqmx import NiRig

    return NiRig.of(f"ni://{rest}", **asked)


def _own(path: Path, name: str, asked: _Asked) -> AbstractRig:
    """Run somebody's file, and what it calls `name`."""
    make = getattr(_module(path), name, None)
    if not callable(make):
        raise RigError(f"{path}: has no function {name!r}; need one that takes limits= and slew_rate= and gives a rig")
    try:
        rig = make(**asked)
    except DehystError:
        raise
    # Their code may raise anything.
    except Exception as error:
        raise RigError(
            f"{path}:{name}: {type(error).__name__}: {error}; it is called with limits= and slew_rate="
        ) from error
    if not isinstance(rig, AbstractRig):
        raise RigError(f"{path}:{name}: gave a {type(rig).__name__}, need an AbstractRig (see dehyst.instruments)")
    return rig


def _module(path: Path) -> ModuleType:
    if not path.is_file():
        raise RigError(f"{path}: there is no such file; need one with a function that makes a rig")
    module = ModuleType(path.stem)
    module.__file__ = str(path)
    # Dataclasses and pickle look for it there; a module of the same name is not replaced.
    sys.modules.setdefault(path.stem, module)
    # As Python does with a script: what lies beside it can be imported.
    if (folder := str(path.resolve().parent)) not in sys.path:
        sys.path.insert(0, folder)
    try:
        # Not by way of a cache: somebody who edits it and tries again means what it says now.
        exec(compile(path.read_bytes(), path, "exec"), module.__dict__)
    except Exception as error:
        raise RigError(f"{path}: {type(error).__name__}: {error}") from error
    return module


_OPENERS: dict[str, Callable[[str, _Asked], AbstractRig]] = {
    "pi": _pi,
    "epics": _epics,
    "sim": _sim,
    "ni": _ni,
}
