"""The baselines by name: those of this package, then those that other distributions add by entry points."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from dehyst._errors import DehystError, PluginError, Terminated
from dehyst.model import AbstractModel
from dehyst.records import Record

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

# A function of training records that returns the model, or raises an error that states why there is none.
Identification: TypeAlias = Callable[[Sequence[Record]], AbstractModel]


class PluginWarning(UserWarning):
    """A baseline of another distribution that cannot be used."""


class _Found(NamedTuple):
    """Baselines of other distributions, and for each name that cannot be used the reason."""

    added: dict[str, Identification]
    faults: dict[str, str]


class Registry(Mapping[str, Identification]):
    """The baselines of this package, then entry points of the group ``dehyst.baselines``, which cannot replace them.

    Entry points are loaded once: when a name that is not in `own` is looked up, or all names are listed. One that
    cannot be used gives a `PluginWarning`, and a `PluginError` if its name is looked up; the others work.

    `own`: baselines of this package by name. `reserved`: further names that no entry point may have.
    """

    def __init__(self, own: Mapping[str, Identification], reserved: Sequence[str]) -> None:
        self.own, self._taken = own, {name.casefold() for name in (*own, *reserved)}

    def __getitem__(self, name: str) -> Identification:
        if name in self.own:
            return self.own[name]
        if name in self._found.faults:
            raise PluginError(self._found.faults[name])
        return self._found.added[name]

    def __iter__(self) -> Iterator[str]:
        return iter([*self.own, *self._found.added])

    def __len__(self) -> int:
        return len(self.own) + len(self._found.added)

    @cached_property
    def _found(self) -> _Found:
        """The baselines of other distributions, which are loaded now."""
        from importlib.metadata import entry_points

        named: dict[str, list[EntryPoint]] = {}
        for point in entry_points(group="dehyst.baselines"):
            named.setdefault(point.name, []).append(point)
        found = _Found({}, {})
        for name, points in named.items():
            try:
                found.added[name] = self._loaded(name, points)
            except Terminated:
                raise
            except (Exception, SystemExit) as error:  # code of others may raise anything
                by = " and ".join(
                    f"{one.dist.name} {one.dist.version}" if one.dist else "an unknown package" for one in points
                )
                found.faults[name] = f"baseline '{name}' of {by} cannot be used: {error or type(error).__name__}"
                warnings.warn(found.faults[name], PluginWarning, stacklevel=2)
        return found

    def _loaded(self, name: str, points: Sequence[EntryPoint]) -> Identification:
        """Return the function of an entry point; raise what speaks against it."""
        if name.casefold() in self._taken:
            raise ValueError("the name is of a model of dehyst; its author must choose another")
        if len(points) > 1:
            raise ValueError("both have this name; uninstall one of them")
        fit = points[0].load()
        if not callable(fit):
            raise TypeError(f"got a {type(fit).__name__}, need a function of a list of records that returns a model")

        def fitted(records: Sequence[Record]) -> AbstractModel:
            try:
                model: AbstractModel = fit(records)
            except (DehystError, Terminated):
                raise
            except (Exception, SystemExit) as error:  # code of others may raise anything
                raise PluginError(
                    f"{name}: a plug-in raised {type(error).__name__}: {error}; report it to its author"
                ) from error
            return model

        return fitted
