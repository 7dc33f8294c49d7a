"""Operations declared by functions: parameters from signatures, help from docstrings, conditions from annotations.

One declaration serves the command line (words), the workbench and files of options (JSON) and the documentation.
"""

from __future__ import annotations

import inspect
import json
import re
import sys
import tomllib
import types
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from dehyst._errors import DehystError
from dehyst._io import read_json, reading_errors

REQUIRED = inspect.Parameter.empty
# Characters of a text in JSON.
_LONGEST = 1000


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


Input = Annotated[Path, Role.INPUT]
Output = Annotated[Path, Role.OUTPUT]
Folder = Annotated[Path, Role.FOLDER]
Continued = Annotated[Path, Role.CONTINUED]
Values = Mapping[str, Any]


@dataclass(frozen=True)
class Only:
    """A condition on the given values; if it does not hold, the parameter has no effect.

    `words` follow "has no effect": "without --trajectory". Only given values count, not defaults.
    """

    holds: Callable[[Values], bool]
    words: str


def beside(*names: str) -> Only:
    """Return the condition that one of these parameters is given."""
    flags = " or ".join(map(flag, names))
    return Only(lambda given: any(given.get(name) not in (None, (), False) for name in names), f"without {flags}")


def one_of(name: str, choices: Collection[str]) -> Only:
    """Return the condition that a parameter has one of these values."""
    return Only(lambda given: given[name] in choices, f"without {' or '.join(choices)}")


@dataclass(frozen=True)
class Kind:
    """Kind of a parameter's values: how a value is read from a text, and shown.

    A type with a `parse` of its own has a text that `str` writes. `count`: number of words of one value. `several`:
    whether there may be any number of values, in a tuple.
    """

    type: Any
    metavar: str
    count: int = 1
    several: bool = False
    choices: tuple[str, ...] = ()
    role: Role | None = None

    @classmethod
    def of(cls, annotation: Any) -> Kind:
        """Return the kind of values of an annotation, ignoring conditions and None."""
        origin, arguments = get_origin(annotation), get_args(annotation)
        if origin in (Union, types.UnionType):
            return cls.of(next(one for one in arguments if one is not type(None)))
        if origin is Annotated:
            roles = [one for one in arguments[1:] if isinstance(one, Role)]
            kind = cls.of(arguments[0])
            return replace(kind, role=roles[0]) if roles else kind
        if origin is Literal:
            return cls(str, "|".join(arguments), choices=arguments)
        if origin is tuple and arguments[-1] is Ellipsis:
            return replace(cls.of(arguments[0]), several=True)
        if origin is tuple:
            return cls(arguments[0], "LOW HIGH" if arguments[0] is float else "N M", len(arguments))
        metavar = getattr(annotation, "metavar", _METAVARS.get(annotation, "TEXT"))
        return cls(annotation, metavar, getattr(annotation, "word_count", 1))

    def parse(self, text: str) -> Any:
        """Return the value of a word; raise ValueError that says what is needed."""
        if self.choices and text not in self.choices:
            raise ValueError(f"got {text!r}, need {' or '.join(self.choices)}")
        if self.type in (int, float):
            try:
                return self.type(text)
            except ValueError as error:
                raise ValueError(f"got {text!r}, need a {_NUMBERS[self.type]}") from error
        return self.type.parse(text) if hasattr(self.type, "parse") else self.type(text)

    def parse_words(self, words: Sequence[str]) -> Any:
        """Return the value of its words; raise ValueError that says what is needed."""
        if self.count > 1 and not hasattr(self.type, "parse"):
            return tuple(map(self.parse, words))
        return self.parse(" ".join(words))

    def of_json(self, value: Any) -> Any:
        """Return the value of a JSON value; raise ValueError that says what is needed."""
        if not self.several:
            return self._one(value)
        if not isinstance(value, list | tuple):
            raise ValueError("need a list")
        return tuple(map(self._one, value))

    def words(self, value: Any) -> list[str]:
        """Return the words of one value that `parse` reads."""
        if self.count > 1:
            return str(value).split() if hasattr(self.type, "parse") else list(map(_text, value))
        return [_text(value)]

    def _one(self, value: Any) -> Any:
        if isinstance(value, list | tuple) and hasattr(self.type, "parse"):
            value = (" " if self.count > 1 else ",").join(map(_text, value))
        elif self.count > 1 and not hasattr(self.type, "parse"):
            if not isinstance(value, list | tuple) or len(value) != self.count:
                raise ValueError(f"need {self.count} numbers")
            return tuple(map(replace(self, count=1)._one, value))
        if self.type is bool:
            if not isinstance(value, bool):
                raise ValueError(f"got {str(value)[:40]!r}, need true or false")
            return value
        if isinstance(value, int | float) and not isinstance(value, bool) and self.type not in (str, Path):
            if not abs(value) < 1e300 or (self.type is int and value != int(value)):
                raise ValueError(f"got {str(value)[:40]}, need a {_NUMBERS.get(self.type, 'finite number')}")
            return self.type(value) if self.type in _NUMBERS else self.parse(_text(value))
        if self.type in _NUMBERS:
            raise ValueError(f"got {str(value)[:40]!r}, need a {_NUMBERS[self.type]}")
        if not isinstance(value, str) or len(value) > _LONGEST or "\0" in value:
            raise ValueError(f"need a text of at most {_LONGEST} letters")
        return self.parse(value)


_METAVARS = {float: "NUMBER", int: "N", Path: "FILE", bool: "true|false"}
_NUMBERS = {int: "whole number", float: "number"}


def _text(value: Any) -> str:
    return f"{value:.15g}" if isinstance(value, float) and float(f"{value:.15g}") == value else str(value)


@dataclass(frozen=True)
class Parameter:
    """A parameter of an operation.

    `positional`: an argument of the command line, otherwise an option. `rare`: only in a file of options. `texts`: its
    help for each choice of another parameter, if they differ.
    """

    name: str
    kind: Kind
    default: Any
    help: str = ""
    positional: bool = False
    rare: bool = False
    conditions: tuple[Only, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)

    def of_choice(self, given: Values) -> Parameter | None:
        """Return the parameter as its choice has it, `given` one value or none; None if it has no effect then."""
        if not all(one.holds(given) for one in self.conditions):
            return None
        text = next((self.texts[value] for value in given.values() if value in self.texts), self.help)
        return replace(self, help=text)

    @property
    def required(self) -> bool:
        """Whether the parameter has no default."""
        return self.default is REQUIRED

    @property
    def flag(self) -> str:
        """The option, or the name of the argument."""
        return self.name.upper() if self.positional else flag(self.name, off=self.default is True)

    @property
    def whole_help(self) -> str:
        """Its help with the default."""
        plain = self.default in (REQUIRED, None, ()) or isinstance(self.default, bool)
        known = plain or "default" in self.help or not _text(self.default)
        return self.help if known else f"{self.help}  [default: {_text(self.default)}]"

    def words(self, value: Any) -> list[str]:
        """Return a value as words of a command line."""
        if self.kind.type is bool:
            return [] if value is None else [flag(self.name, off=not value)]
        values = list(value) if self.kind.several else [value]
        words = [self.kind.words(one) for one in values]
        if self.positional:
            return [word for one in words for word in one]
        return [word for one in words for word in (flag(self.name), *one)]


def flag(name: str, *, off: bool = False) -> str:
    """Return the option that sets a parameter, or switches it off."""
    return f"--{'no-' if off else ''}{name.replace('_', '-')}"


def _declared(function: Callable[..., Any], name: str, text: str, **more: Any) -> Parameter:
    """Return a parameter of a function from its signature, with this help."""
    one = inspect.signature(function).parameters[name]
    annotation = one.annotation
    if isinstance(annotation, str):
        annotation = eval(annotation, vars(sys.modules[function.__module__]))
    conditions = tuple(each for each in get_args(annotation)[1:] if isinstance(each, Only))
    kind = Kind.of(annotation)
    return Parameter(name, kind, one.default, text or getattr(kind.type, "about", ""), conditions=conditions, **more)


def merged(
    functions: Mapping[str, Callable[..., Any]], *, by: str = "kind", leave: Collection[str] = ()
) -> list[Parameter]:
    """Return the keywords of several functions; each has an effect only if parameter `by` selects its function."""
    found: dict[str, dict[str, Parameter]] = {}
    for word, function in functions.items():
        texts = documented(function)
        for name, one in inspect.signature(function).parameters.items():
            if one.kind is inspect.Parameter.KEYWORD_ONLY and name not in leave:
                found.setdefault(name, {})[word] = _declared(function, name, texts.get(name, ""))
    return [_joined(by, owners) for owners in found.values()]


def _joined(by: str, owners: Mapping[str, Parameter]) -> Parameter:
    """Merge parameters of several functions with the same name into one."""
    first, *others = owners.values()
    same = all(one.default == first.default for one in others)
    texts: dict[str, list[str]] = {}
    for word, one in owners.items():
        texts.setdefault(one.help if same else one.whole_help, []).append(word)
    text = " ".join(f"{', '.join(words)}: {text}" for text, words in texts.items())
    default = first.default if same and not first.required else None
    own = {word: one.whole_help for word, one in owners.items()}
    return replace(first, default=default, help=text, conditions=(one_of(by, owners),), texts=own)


# Of a parameter in a running text: "`steps`: number of tops." or "`lowest` [V]: the last one."
_INLINE = re.compile(r"(?:^|(?<=\. ))`(\w+)`( \[[^\]]+\])?[:,] (.+?\.)(?=$| `| Raise )")


def documented(thing: Any) -> dict[str, str]:
    """Return the texts of the parameters in a docstring, each as one line without markup."""
    text, _, rest = (inspect.getdoc(thing) or "").partition("Parameters\n----------\n")
    inline = _INLINE.findall(" ".join(text.split()))
    found = {name: f"{words[:1].upper()}{words[1:-1]}{unit or ''}." for name, unit, words in inline}
    for entry in re.split(r"\n(?=\S)", re.split(r"\n\n?\w[\w ]*\n-{3,}\n", rest)[0]):
        head, _, body = entry.partition("\n")
        found |= dict.fromkeys((name.strip() for name in head.partition(" : ")[0].split(",")), " ".join(body.split()))
    return {name: re.sub(r"`{1,2}", "", words) for name, words in found.items()}


@dataclass(frozen=True, eq=False)
class Operation:
    """A function from files to files, with the declaration of its parameters.

    `name`: word of its command. `summary`, `help`: first and further sentences of its help.
    `details`: whether its result has more lines than the answer. `returns`: whether it has a JSON result.
    """

    name: str
    function: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    summary: str
    help: str
    details: bool = False
    returns: bool = True

    def parameter(self, name: str) -> Parameter | None:
        """Return a parameter by name; None if there is no such parameter."""
        return next((one for one in self.parameters if one.name == name), None)

    @property
    def rare(self) -> tuple[Parameter, ...]:
        """The parameters that files of options may hold."""
        return tuple(one for one in self.parameters if one.rare)

    @property
    def writes(self) -> bool:
        """Whether the operation writes files."""
        return any(one.kind.role in (Role.OUTPUT, Role.FOLDER, Role.CONTINUED) for one in self.parameters)

    @property
    def defaults(self) -> dict[str, Any]:
        """The defaults of the parameters by name."""
        return {one.name: one.default for one in self.parameters if not one.required}

    def paths(self, values: Values, *roles: Role) -> Iterator[Path]:
        """Yield the paths among the values that have one of these roles."""
        for one in self.parameters:
            value = values.get(one.name)
            if one.kind.role in roles and value is not None:
                yield from value if one.kind.several else (value,)
            elif Role.INPUT in roles:
                # Values such as columns name files that are read too.
                yield from getattr(value, "files", ())

    def of_json(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values of JSON parameters; raise OperationError if one is unknown, missing or of a wrong kind."""
        if missing := [one.name for one in self.parameters if one.required and one.name not in given]:
            raise OperationError(argument=missing[0], got="none", need=f"one for {self.name}")
        return _of_json(self.name, self.parameters, {name: one for name, one in given.items() if one is not None})

    def options_in(self, text: str) -> dict[str, Any]:
        """Return the rare parameters in a file of options, JSON or TOML, or in JSON itself.

        Raises
        ------
        OperationError
            If the file cannot be read, or holds something else.
        """
        if text.lstrip().startswith(("{", "[", '"')):
            try:
                given = json.loads(text)
            except ValueError as error:
                raise OperationError(argument="options", got=f"no JSON ({error})", need="an object") from error
            if not isinstance(given, dict):
                raise OperationError(argument="options", got=text, need="an object, as {NAME: VALUE}, or a file of one")
        elif text.endswith(".toml"):
            with reading_errors(Path(text), "TOML"):
                given = tomllib.loads(Path(text).read_text(encoding="utf-8"))
        else:
            given = read_json(text)
        return _of_json("options", self.rare, given)

    def check(self, values: Values) -> None:
        """Raise OperationError if a parameter has no effect with the given values."""
        for one in self.parameters:
            broken = [each for each in one.conditions if one.name in values and not each.holds(values)]
            if broken:
                raise OperationError(f"has no effect {broken[0].words}", argument=one.name, hint="leave it out")

    def command(self, values: Values) -> list[str]:
        """Return the words of the equivalent command."""
        given = [one for one in self.parameters if one.name in values]
        words = ["dehyst", *self.name.split()]
        for one in sorted(given, key=lambda one: not one.positional):
            words += [] if one.rare else one.words(values[one.name])
        if rare := {one.name: values[one.name] for one in given if one.rare}:
            words += ["--options", json.dumps(rare, default=str)]
        return words


def _of_json(what: str, known: Sequence[Parameter], given: Mapping[str, Any]) -> dict[str, Any]:
    names = {one.name: one for one in known}
    values = {}
    for name, value in given.items():
        if name not in names:
            raise OperationError(argument=what, got=f"{name!r}", need=f"some of {', '.join(names)}")
        try:
            values[name] = names[name].kind.of_json(value)
        except ValueError as error:
            raise OperationError(str(error), argument=name) from error
    return values


def operation(
    library: Callable[..., Any] | None = None,
    *,
    name: str = "",
    take: Sequence[str] = (),
    rare: Collection[str] = (),
    more: Iterable[Parameter] = (),
    details: bool = False,
    returns: bool = True,
) -> Callable[[Callable[..., Any]], Operation]:
    """Declare an operation.

    Parameters
    ----------
    library : callable, optional
        Function of the library whose docstring provides missing help of parameters.
    name : str, optional
        Words of its command; by default the function's name.
    take : sequence of str, optional
        Names of the library function's parameters that the operation adopts unchanged.
    rare : collection of str, optional
        Names of the parameters that only files of options may hold.
    more : iterable of Parameter, optional
        Further parameters, passed as keywords.
    details, returns : bool
        As in `Operation`.
    """

    def declared(function: Callable[..., Any]) -> Operation:
        own, known = documented(function), documented(library)
        signature = list(inspect.signature(function).parameters.values())[1:]
        found = [
            _declared(
                function,
                one.name,
                own.get(one.name) or known.get(one.name, ""),
                positional=one.kind is not inspect.Parameter.KEYWORD_ONLY,
            )
            for one in signature
            if one.kind is not inspect.Parameter.VAR_KEYWORD
        ]
        taken = [] if library is None else [_declared(library, name, own.get(name) or known[name]) for name in take]
        parameters = tuple(replace(one, rare=one.name in rare) for one in (*found, *taken, *more))
        text = inspect.cleandoc(function.__doc__ or "").partition("\n\nParameters\n---")[0]
        summary, _, rest = text.partition("\n\n")
        return Operation(name or function.__name__, function, parameters, summary, rest, details, returns)

    return declared
