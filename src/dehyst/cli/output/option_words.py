"""Sentences of the library in the words of the command line: options for arguments."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, NamedTuple

# Arguments of the library that an option of another name sets.
_RENAMED = {"slew_rate": "slew"}
# A sentence that begins with one of these is about data, not about an option that names a column or a file.
_DATA = {"time", "voltage", "displacement", "model", "records", "trajectory", "report", "output"}
_TIME = re.compile(r"give time=[^;]*")
_ANYWAY = re.compile(r"; or pass extrapolate=True[^;]*")


class Option(NamedTuple):
    """An option of a command: its flag, and its value as help texts show it; "" if it takes none."""

    flag: str
    takes: str


def options_of(command: Any) -> dict[str, Option]:
    """Return the options of a click command, or of all commands of a group, by the argument that each sets."""
    options: dict[str, Option] = {}
    for inner in getattr(command, "commands", {}).values():
        options |= options_of(inner)
    for parameter in command.params:
        flags = [flag for flag in parameter.opts if flag.startswith("--")]
        takes = "" if getattr(parameter, "is_flag", False) else parameter.metavar or ""
        options[parameter.name] = Option(flags[0] if flags else str(parameter.human_readable_name), takes)
    renamed = {argument: name for argument, name in _RENAMED.items() if argument not in options and name in options}
    return options | {argument: options[name] for argument, name in renamed.items()}


def worded_for(sentence: str, options: dict[str, Option]) -> str:
    """Write a sentence of the library with the options of a command for arguments.

    Arguments are found as `name=`, as the head of a sentence (`name: got ...`), and by an underscore in their name.
    """
    sentence = _ANYWAY.sub("", sentence)
    if {"time", "sample_rate"} <= options.keys():
        sentence = _TIME.sub("give a time column (--time NAME) or --sample-rate HZ", sentence)
    names = "|".join(sorted(map(re.escape, options), key=len, reverse=True))
    if not names:
        return sentence
    # A file may have the name of an option: only messages about arguments continue like this.
    sentence = re.sub(
        rf"^(?:{names})(?:, (?:{names}))*(?=: (?:got|need|method|it|takes|the (?!folder|file|key|number))\b)",
        lambda head: _head(head[0], options),
        sentence,
    )
    sentence = re.sub(
        rf"(\b(?:give|try|or|with) )?\b({names})=(\([^)]*\)|\"[^\"]*\"|'[^']*'|[-\w.]+)?( \[[^]]*\]| in Hz)?",
        lambda match: (match[1] or "") + _set(options[match[2]], match[3], bool(match[1])) + _unit(match[3], match[4]),
        sentence,
    )
    long = "|".join(name for name in options if "_" in name)
    if not long:
        return sentence
    return re.sub(rf"(?<![\w./'\"-])({long})(?![\w/'\"]|\.\w)", lambda name: options[name[1]].flag, sentence)


def _head(names: str, options: dict[str, Option]) -> str:
    return ", ".join(name if name in _DATA else options[name].flag for name in names.split(", "))


def _set(option: Option, value: str | None, asked: bool) -> str:
    """Return an option with its value, or with the name of its value where a sentence asks for it."""
    if value is None or value.startswith("("):
        return f"{option.flag} {option.takes}" if option.takes and (asked or value) else option.flag
    if value == "True":
        return option.flag
    return f"{option.flag} {value.strip(chr(39))}"


def _unit(value: str | None, unit: str | None) -> str:
    """Return the unit of a value; the name of a missing value contains its unit."""
    return "" if value is None else unit or ""


def in_words_of(command: Any, sentences: Iterable[str]) -> tuple[str, ...]:
    """Write sentences of the library in the words of a click command."""
    options = options_of(command)
    return tuple(worded_for(sentence, options) for sentence in sentences)
