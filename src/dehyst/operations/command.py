"""Operations as commands of click: roles of paths, kinds of values, and options that are refused without an effect.

The function of a command gets a run and the values of its parameters, and returns a result. The command line and the
workbench give words, which click reads; see `perform`.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from dehyst._errors import DehystError
from dehyst.operations import registry

Values = Mapping[str, Any]
Decorator = Callable[[Callable[..., Any]], Callable[..., Any]]
# A larger number is none.
_HUGE = 1e300
# Options of the command line, which are not given to the function.
HOUSE = {"force": "--force", "details": "--verbose", "as_json": "--json"}


class OperationError(DehystError, ValueError):
    """A parameter of an operation is missing, unknown, of the wrong kind, or without an effect."""


class Role(Enum):
    """Role of a path in an operation: read, written, a folder of several outputs, or an output that it continues.

    `perform` refuses outputs that exist; an operation looks itself at those that it continues.
    """

    INPUT = "input"
    OUTPUT = "output"
    FOLDER = "folder"
    CONTINUED = "continued"


class FilePath(click.Path):
    """A path with a role; `suffix`: that of its only format."""

    def __init__(self, role: Role, suffix: str = "") -> None:
        super().__init__(path_type=Path)
        self.role, self.suffix, self.name = role, suffix, "file"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a path."""
        if "\0" in str(value):
            self.fail("a name cannot hold the character 0", param, ctx)
        if self.suffix and Path(value).suffix.lower() != self.suffix:
            self.fail(f"got '{value}', need a name that ends in {self.suffix}", param, ctx)
        return super().convert(value, param, ctx)


INPUT, OUTPUT, FOLDER, CONTINUED = map(FilePath, Role)
PAGE = FilePath(Role.OUTPUT, ".html")


class _Number(click.types.FloatParamType):
    name = "number"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        # Click leaves unknown options to numbers, which may be negative.
        if isinstance(value, str) and value.startswith("--"):
            raise click.NoSuchOption(value.partition("=")[0], ctx=ctx)
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"got {value}, need a finite number", param, ctx)
        return number


NUMBER = _Number()


class Parsed(click.ParamType):  # type: ignore[type-arg]
    """Values of a class that reads them from a text by its method `parse`."""

    def __init__(self, kind: Any) -> None:
        self.kind, self.name = kind, kind.__name__.lower()

    def get_metavar(self, param: click.Parameter, ctx: click.Context) -> str:
        """Return the form of the text."""
        return str(self.kind.metavar)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the value of a text."""
        if not isinstance(value, str):
            return value
        try:
            return self.kind.parse(value)
        except (ValueError, DehystError) as error:
            self.fail(str(error), param, ctx)


@dataclass(frozen=True)
class Only:
    """A condition on the given values; if it does not hold, the option has no effect and is refused.

    `words` follow "has no effect": "without --trajectory". Only given values count, not defaults.
    """

    holds: Callable[[Values], bool]
    words: str


def beside(name: str) -> Only:
    """Return the condition that another option is given."""
    return Only(lambda given: given.get(name) not in (None, ()), f"without --{name}")


class ConditionalOption(click.Option):
    """An option that has an effect only under conditions."""

    def __init__(self, *names: Any, only: Only | tuple[Only, ...] = (), **settings: Any) -> None:
        super().__init__(*names, **settings)
        self.conditions = (only,) if isinstance(only, Only) else only


option = partial(click.option, cls=ConditionalOption)
number = partial(option, type=NUMBER)
integer = partial(option, type=int)
page = partial(option, "--report", type=PAGE, help="Write a self-contained HTML page here.")


def output(text: str, role: FilePath = OUTPUT, **settings: Any) -> Decorator:
    """Return the option for an output, by default a file that is needed."""
    return option("-o", "--output", type=role, help=text, **{"required": not settings, **settings})


class OperationCommand(click.Command):
    """The command of an operation; the object of its context runs it.

    `details`: whether its result has more lines than the answer. `returns`: whether it has a JSON result.
    """

    def __init__(self, name: str | None, *, details: bool = False, returns: bool = True, **settings: Any) -> None:
        numbers = any(isinstance(each, click.Argument) and each.type is NUMBER for each in settings["params"])
        context = {"show_default": True, "ignore_unknown_options": numbers}
        super().__init__(name, context_settings=context, **settings)
        self.short_help = " ".join((self.help or "").partition("\n\n")[0].split())
        shown = {
            "force": ("Replace files that exist.", self.writes),
            "details": ("Print all that was found.", details),
            "as_json": ("Print JSON for a program.", returns),
        }
        self.params += [
            click.Option([HOUSE[own], own], is_flag=True, help=text) for own, (text, has) in shown.items() if has
        ]

    @property
    def writes(self) -> bool:
        """Whether the operation writes files."""
        roles = {parameter.type.role for parameter in self.params if isinstance(parameter.type, FilePath)}
        return bool(roles & {Role.OUTPUT, Role.FOLDER, Role.CONTINUED})

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words; an option that takes files takes all names up to the next option."""
        ctx.meta["words"] = [*args]
        many = {name for parameter in self.params for name in parameter.opts if _takes_files(parameter)}
        spread, inside = list[str](), ""
        for word in args:
            if inside and not word.startswith("-") and spread[-1] != inside:
                spread.append(inside)
            inside = word if word in many else inside if not word.startswith("-") else ""
            spread.append(word)
        return super().parse_args(ctx, spread)

    def invoke(self, ctx: click.Context) -> Any:
        """Let the object of the context run the operation."""
        return ctx.obj(ctx)


class Kinds(click.Group):
    """A command with a command for each kind."""

    command_class = OperationCommand


command = partial(click.command, cls=OperationCommand)


def argument_of(error: click.UsageError) -> str:
    """Return the name of the parameter that words of a command do not give as it must be; empty if it is not known."""
    parameter, name = getattr(error, "param", None), getattr(error, "option_name", "")
    return str(parameter.name) if parameter is not None else name.lstrip("-").replace("-", "_")


def _takes_files(parameter: click.Parameter) -> bool:
    return isinstance(parameter, click.Option) and parameter.multiple and isinstance(parameter.type, FilePath)


def given_in(ctx: click.Context) -> dict[str, Any]:
    """Return the values that were given, without defaults."""
    defaults = (ParameterSource.DEFAULT, ParameterSource.DEFAULT_MAP)
    return {name: value for name, value in ctx.params.items() if ctx.get_parameter_source(name) not in defaults}


def paths_in(ctx: click.Context, *roles: Role) -> Iterator[Path]:
    """Yield the paths among the values that have one of these roles."""
    for parameter in ctx.command.params:
        value = ctx.params.get(parameter.name or "")
        if isinstance(parameter.type, FilePath) and parameter.type.role in roles and value is not None:
            yield from value if isinstance(value, tuple) else (value,)
        elif Role.INPUT in roles:
            # Values such as columns name files that are read too.
            yield from getattr(value, "files", ())


def command_of(ctx: click.Context, **replaced: str) -> str:
    """Return the command as it was given, with other values of the `replaced` options."""
    left, words = [*ctx.meta["words"]], ctx.command_path.split()
    while left:
        word = left.pop(0)
        name, equals, _ = word.partition("=")
        if name.removeprefix("--") in replaced:
            left = left if equals else left[1:]
        elif word not in HOUSE.values():
            words.append(word)
    return shlex.join([*words, *(word for name, text in replaced.items() for word in (f"--{name}", text))])


def words_of(name: str, values: dict[str, Any]) -> list[str]:
    """Return the words of an operation with these values by name; `kind` selects one of several kinds.

    Raise OperationError if there is no such operation, kind or parameter.
    """
    given = {key: value for key, value in values.items() if value is not None}
    command, head = registry.find(name), [name]
    if isinstance(command, click.Group):
        head.append(str(given.pop("kind", "")))
        if head[1] not in command.commands:
            raise OperationError(argument="kind", got=repr(head[1]), need=f"one of {', '.join(command.commands)}")
        command = command.commands[head[1]]
    known = {parameter.name: parameter for parameter in command.params}
    if unknown := [key for key in given if key not in known]:
        raise OperationError(
            argument=unknown[0], got=f"it for {name}", need=f"some of {', '.join(filter(None, known))}"
        )
    options = list[str]()
    for key, value in given.items():
        parameter = known[key]
        several = parameter.nargs == -1 or (isinstance(parameter, click.Option) and parameter.multiple)
        for each in value if several else [value]:
            parts = each if isinstance(each, list | tuple) else [each]
            if any(isinstance(part, int | float) and not abs(part) < _HUGE for part in parts):
                raise OperationError(argument=key, got="a number that is not finite", need="a finite number")
            texts = [*map(str, parts)]
            texts = [",".join(texts)] if parameter.nargs == 1 else texts
            if isinstance(parameter, click.Option) and parameter.is_flag:
                options += parameter.opts if each else parameter.secondary_opts
            elif isinstance(parameter, click.Option):
                options += [parameter.opts[-1], *texts]
            else:
                head += texts
    return [*head, *options]


def context_of(words: Sequence[str]) -> click.Context:
    """Return the context of an operation that is given as words; raise OperationError if they cannot be understood."""
    command, name, left = registry.find(words[0]), words[0], [*words[1:]]
    parent = click.Context(click.Group("dehyst"), info_name="dehyst")
    try:
        if isinstance(command, click.Group):
            parent = click.Context(command, parent=parent, info_name=name)
            name, command, left = command.resolve_command(parent, left)  # type: ignore[assignment]
        return command.make_context(name, left, parent=parent)
    except click.UsageError as error:
        raise OperationError(error.format_message(), argument=argument_of(error) or words[0]) from error
