"""Sentences of the library in the words of the command line: options for arguments, of scans micrometres too."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

# Arguments of the library that options of another name set.
_RENAMED = {"slew_rate": "slew"}
# A sentence that begins with one of these is about data, not about the option that names a column or a file.
_DATA = {"time", "voltage", "displacement", "model", "records", "trajectory", "report", "output"}
_TIME = re.compile(r"give time=[^;]*")
_ANYWAY = re.compile(r"; or pass extrapolate=True[^;]*")


class Option(NamedTuple):
    """An option of a command: its flag, and what it takes, as help texts show it; "" if nothing."""

    flag: str
    takes: str


def options_of(command: Any) -> dict[str, Option]:
    """The options of a click command, or of all commands of a group, by the argument that each sets."""
    found: dict[str, Option] = {}
    for inner in getattr(command, "commands", {}).values():
        found |= options_of(inner)
    for parameter in command.params:
        flags = [flag for flag in parameter.opts if flag.startswith("--")]
        takes = "" if getattr(parameter, "is_flag", False) else parameter.metavar or ""
        found[parameter.name] = Option(flags[0] if flags else str(parameter.human_readable_name), takes)
    return found | {name: found[other] for name, other in _RENAMED.items() if name not in found and other in found}


def worded_for(said: str, options: dict[str, Option]) -> str:
    """Write a sentence of the library with the options of a command for arguments.

    Arguments are found as `name=`, as the head of a sentence (`name: got ...`), and by an underscore in their name.
    """
    said = _ANYWAY.sub("", said)
    if {"time", "sample_rate"} <= options.keys():
        said = _TIME.sub("give a time column (--time NAME) or --sample-rate HZ", said)
    names = "|".join(sorted(map(re.escape, options), key=len, reverse=True))
    if not names:
        return said
    # A file may be called as an option is: only what is said of arguments goes on like this.
    said = re.sub(
        rf"^(?:{names})(?:, (?:{names}))*(?=: (?:got|need|method|it|takes|the (?!folder|file|key|number))\b)",
        lambda head: _head(head[0], options),
        said,
    )
    said = re.sub(
        rf"(\b(?:give|try|or|with) )?\b({names})=(\([^)]*\)|\"[^\"]*\"|'[^']*'|[-\w.]+)?( \[[^]]*\]| in Hz)?",
        lambda found: (found[1] or "") + _set(options[found[2]], found[3], bool(found[1])) + _rest(found[3], found[4]),
        said,
    )
    long = "|".join(name for name in options if "_" in name)
    return (
        re.sub(rf"(?<![\w./'\"-])({long})(?![\w/'\"]|\.\w)", lambda name: options[name[1]].flag, said) if long else said
    )


def _head(names: str, options: dict[str, Option]) -> str:
    return ", ".join(name if name in _DATA else options[name].flag for name in names.split(", "))


def _set(option: Option, value: str | None, asked: bool) -> str:
    """An option with its value, or with what it takes where a sentence asks for it."""
    if value is None or value.startswith("("):
        return f"{option.flag} {option.takes}" if option.takes and (asked or value) else option.flag
    if value == "True":
        return option.flag
    return f"{option.flag} {value.strip(chr(39))}"


def _rest(value: str | None, unit: str | None) -> str:
    """A unit is said by what an option takes already."""
    return "" if value is None else unit or ""


def in_words_of(command: Any, sentences: Iterable[str]) -> tuple[str, ...]:
    """Write sentences of the library in the words of a click command."""
    options = options_of(command)
    return tuple(worded_for(said, options) for said in sentences)


# Arguments of scans that are called otherwise on the command line.
_OTHERWISE = {"cycles": "start-up", "seconds": "edge", "slew_rate": "slew", "base": "present"}
_SAME = (
    "low",
    "high",
    "y_low",
    "y_high",
    "frequency",
    "turns",
    "speed",
    "acceleration",
    "rising",
    "rounding",
    "lines",
    "slow",
    "back",
    "revolutions",
    "constant",
    "ratio",
    "phase",
    "levels",
    "dwell",
    "shape",
    "sample_rate",
    "axis",
    "limits",
    "present",
    "approach",
    "tolerance",
)
_FLAGS = {name: f"--{name.replace('_', '-')}" for name in _SAME} | {
    name: f"--{flag}" for name, flag in _OTHERWISE.items()
}
_NAMES = "|".join(_FLAGS)
_NUMBER = r"-?\d[\d.]*(?:e[+-]?\d+)?"
_ENTRIES = (
    # Both units are told where either may be meant.
    (re.compile(rf"{_NUMBER} m/s(?:\^2)? \(({_NUMBER} um/s(?:\^2)?)\)"), r"\1"),
    (re.compile("give metres, such as 5e-6"), "give micrometres, such as 5"),
    (re.compile(r"give more cycles="), "give a larger --start-up"),
    (re.compile(r"limits=\([^)]*\)"), "--limits LOW HIGH"),
    (re.compile(rf"\b({_NAMES})=(?=\S)"), lambda found: f"{_FLAGS[found[1]]} "),
)
_LENGTHS = re.compile(rf"({_NUMBER})(?: and ({_NUMBER}))? m\b(?!/)")
_HEAD = re.compile(rf"^(?:{_NAMES})(?:, (?:{_NAMES}))*(?=:)")


def in_options(said: str) -> str:
    """Write a sentence of a scan with options for arguments, and micrometres for metres."""
    said = _HEAD.sub(lambda found: ", ".join(_FLAGS[name] for name in found[0].split(", ")), said)
    for pattern, words in _ENTRIES:
        said = pattern.sub(words, said)
    return _LENGTHS.sub(_micro, said)


@contextmanager
def said_in_options() -> Iterator[None]:
    """Raise errors again in the words of the command line."""
    from dehyst._errors import ModelError, RecordError

    try:
        yield
    except (ModelError, RecordError) as error:
        raise type(error)(in_options(str(error))) from error


def _micro(found: re.Match[str]) -> str:
    return " and ".join(f"{float(length) * 1e6:.6g}" for length in found.groups() if length) + " um"
