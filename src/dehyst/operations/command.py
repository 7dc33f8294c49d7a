"""Operations as commands of click: the default of each parameter of a function declares an argument or option.

The function of a command gets a run and the values of its parameters, and returns a result. The command line and the
workbench give words, which click reads; see `perform`.
"""

from __future__ import annotations

import inspect
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from dehyst._errors import DehystError
from dehyst.operations import registry

Values = Mapping[str, Any]
# Returns why an option has no effect with the given values (without defaults); empty if it has an effect.
Condition = Callable[[Values], str]
# Returns the parameter of this name.
Declaration = Callable[[str], click.Parameter]
# The key of --columns for an argument of the library, and arguments that are parts of it.
_KEYS = {"time": "time=NAME", "sample_rate": "rate=HZ", "columns": "KEY=VALUE"}
_PARTS = ("axes", "rate", "decimal")
# Options of the command line, which are not given to the function.
HOUSE = {"force": "--force", "details": "--verbose", "as_json": "--json"}


class OperationError(DehystError, ValueError):
    """A parameter of an operation is missing, unknown, of the wrong kind, or without an effect."""


class Role(Enum):
    """Role of a path in an operation: read, written, a folder of several outputs, or an output that it continues.

    `perform` refuses outputs that exist; an operation itself checks those that it continues.
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
        # Click passes unknown options on to numbers, which may be negative.
        if isinstance(value, str) and value.startswith("--"):
            raise click.NoSuchOption(value.partition("=")[0], ctx=ctx)
        found = super().convert(value, param, ctx)
        if not math.isfinite(found):
            self.fail(f"got {value}, need a finite number", param, ctx)
        return found


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
        except DehystError as error:
            error.argument = "" if param is None or error.argument == param.name else error.argument
            self.fail(error.text(), param, ctx)


def beside(name: str) -> Condition:
    """Return the condition that another option is given."""
    return lambda given: "" if given.get(name) not in (None, ()) else f"without --{name}"


class ConditionalOption(click.Option):
    """An option that has an effect only under conditions."""

    def __init__(self, *names: Any, only: Sequence[Condition] = (), **settings: Any) -> None:
        super().__init__(*names, **settings)
        self.conditions = only


def argument(kind: Any = INPUT, **settings: Any) -> Any:
    """Return the declaration of an argument of a command."""
    return lambda name: click.Argument([name], type=kind, **{"required": True, **settings})


def option(text: str, kind: Any = None, *only: Condition, words: str = "", **settings: Any) -> Any:
    """Return the declaration of an option; `only`: its conditions, `words`: its names, by default the parameter's."""

    def declared(name: str) -> click.Option:
        names = [name, *(words.split() or [f"--{name.replace('_', '-')}"])]
        return ConditionalOption(names, help=text, type=kind, only=only, **settings)

    return declared


def number(text: str, *only: Condition, **settings: Any) -> Any:
    """Return the declaration of an option for a finite number."""
    return option(text, NUMBER, *only, **settings)


def pair(text: str, *only: Condition) -> Any:
    """Return the declaration of an option for two numbers, the lower one first."""
    return option(text, (NUMBER, NUMBER), *only, metavar="LOW HIGH")


def flag(text: str, *only: Condition, **settings: Any) -> Any:
    """Return the declaration of an option without a value."""
    return option(text, None, *only, **{"is_flag": True, "default": False, **settings})


def output(text: str, role: FilePath = OUTPUT, *only: Condition, **settings: Any) -> Any:
    """Return the declaration of the option for an output, by default a required file."""
    needed = not only and not settings
    return option(text, role, *only, words="-o --output", **{"required": needed, **settings})


REPORT: Any = option("Write a self-contained HTML page here.", PAGE)


class OperationCommand(click.Command):
    """The command of an operation; the object of its context runs it.

    `details`: whether its result has more lines than the answer. `returns`: whether it has a JSON result.
    """

    def __init__(self, name: str | None, *, details: bool = False, returns: bool = True, **settings: Any) -> None:
        numbers = any(isinstance(each, click.Argument) and each.type is NUMBER for each in settings["params"])
        context = {"show_default": True, "ignore_unknown_options": numbers}
        super().__init__(name, context_settings=context, **settings)
        self.short_help = " ".join((self.help or "").partition("\n\n")[0].split())
        roles = {each.type.role for each in self.params if isinstance(each.type, FilePath)}
        shown = {
            "force": ("Replace files that exist.", bool(roles - {Role.INPUT})),
            "details": ("Print all that was found.", details),
            "as_json": ("Print JSON for a program.", returns),
        }
        self.params += [
            click.Option([HOUSE[own], own], is_flag=True, help=text) for own, (text, has) in shown.items() if has
        ]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the words, and keep them for `command_of`; refuse an option that is given twice and counts once."""
        ctx.meta["words"] = [*args]
        order = [] if ctx.resilient_parsing else self.make_parser(ctx).parse_args([*args])[2]
        for each in {*order}:
            if order.count(each) > 1 and not getattr(each, "multiple", each.is_eager):
                names = "/".join((*each.opts, *each.secondary_opts))
                raise click.BadParameter(f"got {names} twice, need it once", ctx, each)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Let the object of the context run the operation."""
        return ctx.obj(ctx)


def command(
    name: str, more: Mapping[str, Declaration] | None = None, group: click.Group | None = None, **settings: Any
) -> Callable[[Callable[..., Any]], OperationCommand]:
    """Return a decorator that makes a command of a function, whose defaults declare its parameters.

    `more`: further parameters by name, of a function that takes any. `group`: the command of which this one is a kind.
    """

    def made(function: Callable[..., Any]) -> OperationCommand:
        given = inspect.signature(function).parameters.items()
        declared = {key: each.default for key, each in given if each.default is not each.empty} | {**(more or {})}
        params = [declaration(key) for key, declaration in declared.items()]
        found = OperationCommand(name, callback=function, params=params, help=inspect.getdoc(function), **settings)
        if group is not None:
            group.add_command(found)
        return found

    return made


# A command of several kinds, each with options of its own.
kinds = partial(click.Group, no_args_is_help=True, subcommand_metavar="KIND ...")


def argument_of(error: click.UsageError) -> str:
    """Return the name of the parameter with a wrong value in a command; empty if it is not known."""
    parameter, name = getattr(error, "param", None), getattr(error, "option_name", "")
    return str(parameter.name) if parameter is not None else name.lstrip("-").replace("-", "_")


def hint_of(error: click.ClickException) -> str:
    """Return what to try after words that click refuses: what the option takes, or the usage of the command."""
    ctx, parameter = getattr(error, "ctx", None), getattr(error, "param", None)
    record = parameter.get_help_record(ctx) if parameter and ctx else None
    return ": ".join(record) if record and record[1] else ctx.get_usage() if ctx else ""


def error_text(ctx: click.Context, error: DehystError) -> str:
    """Return the message of an error with options in the place of the library's arguments."""
    parameters = {parameter.name: parameter for parameter in ctx.command.params}

    def named(argument: str) -> str:
        parameter = parameters.get(argument)
        if parameter is None:
            return "--columns" if argument in _PARTS and "columns" in parameters else HOUSE.get(argument, argument)
        off = parameter.secondary_opts if ctx.params.get(argument) is False else []
        return argument.upper() if isinstance(parameter, click.Argument) else (off or parameter.opts)[-1]

    def way(argument: str) -> str:
        parameter = parameters.get(argument)
        if isinstance(parameter, click.Option):
            return named(argument) if parameter.is_flag else f"{named(argument)} {parameter.make_metavar(ctx)}"
        key = _KEYS.get(argument)
        return f"--columns {key}" if key and "columns" in parameters else named(argument) if parameter else ""

    given = ctx.params.get(error.argument)
    if isinstance(given, float) and re.fullmatch(r"[-+.e\d]+", error.got):
        error.got = f"{given:g}" if float(error.got) == given else f"{given:g}, which is {error.got} in SI units"
    return error.text(named, way)


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
        elif Role.INPUT in roles and parameter.name == "columns" and value and value.join is not None:
            # Columns may name a second file, which is read too.
            yield Path(value.join)


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
        said = error.format_message() if getattr(error, "param", None) is None else error.message or "need a value"
        raise OperationError(said, argument=argument_of(error) or name) from error
