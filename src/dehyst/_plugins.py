"""A registry with one row a member, to which other distributions add theirs by entry points.

The group ``dehyst.baselines`` adds rival models. The name of an entry point is the name of the row.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from dehyst._errors import DehystError, PluginError, Terminated
from dehyst._version import __version__

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Row = TypeVar("Row")


class PluginWarning(UserWarning):
    """A plug-in that cannot be used."""


class Plugin(NamedTuple):
    """A plug-in: its name, the distributions that bring it with their versions, and why it cannot be used, if so."""

    name: str
    by: tuple[str, ...]
    fault: str = ""


@contextmanager
def plugin_errors(what: str) -> Iterator[None]:
    """Raise what the code of a plug-in raises, unless it is an error of dehyst, as a `PluginError`."""
    try:
        yield
    except (DehystError, Terminated):
        raise
    except (Exception, SystemExit) as error:  # code of others may raise anything
        raise PluginError(
            f"{what}: a plug-in raised {type(error).__name__}: {error}; report it to its author"
        ) from error


class Registry(Mapping[str, Row], Generic[Row]):
    """The rows of this package, then those of plug-ins, which cannot replace them.

    Plug-ins are imported once: when a name that is not in `own` is looked up, or all names are listed. One that cannot
    be used gives a `PluginWarning`, and a `PluginError` if its name is looked up; the others work.

    Parameters
    ----------
    group : str
        Entry points of the group ``dehyst.GROUP`` are its plug-ins.
    own : Mapping
        Rows of this package by name.
    accept : callable
        Returns the row for a name and the object of a plug-in; raises TypeError or ValueError if these do not fit.
    """

    def __init__(self, group: str, own: Mapping[str, Row], accept: Callable[[str, Any], Row]) -> None:
        self.group, self.own, self._accept = group, own, accept
        self._added: dict[str, Row] = {}

    def __getitem__(self, name: str) -> Row:
        if name in self.own:
            return self.own[name]
        for plugin in self.plugins:
            if plugin.name == name and plugin.fault:
                raise PluginError(plugin.fault)
        return self._added[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self.own, *(plugin.name for plugin in self.plugins if not plugin.fault)])

    def __len__(self) -> int:
        return len(list(iter(self)))

    @cached_property
    def plugins(self) -> tuple[Plugin, ...]:
        """All plug-ins, those too that cannot be used; they are imported now."""
        from importlib.metadata import entry_points

        named: dict[str, list[EntryPoint]] = {}
        for point in entry_points(group=f"dehyst.{self.group}"):
            named.setdefault(point.name, []).append(point)
        found = tuple(self._loaded(name, points) for name, points in named.items())
        for plugin in found:
            if plugin.fault:
                warnings.warn(plugin.fault, PluginWarning, stacklevel=2)
        return found

    def _loaded(self, name: str, points: list[EntryPoint]) -> Plugin:
        by = tuple(f"{one.dist.name} {one.dist.version}" if one.dist else "an unknown package" for one in points)
        fault = ""
        if name in self.own:
            fault = f"the name belongs to dehyst {__version__} itself; its author must choose another"
        elif len(points) > 1:
            fault = "both have this name; uninstall one of them"
        else:
            try:
                self._added[name] = self._accept(name, points[0].load())
            except Terminated:
                raise
            except (Exception, SystemExit) as error:  # code of others may raise anything
                fault = f"{type(error).__name__}: {error}; update or uninstall it"
        where = f"plug-in '{name}' ({self.group}) of {' and '.join(by)}"
        return Plugin(name, by, f"{where} cannot be used: {fault}" if fault else "")
