"""What a scan or a wave table says, in the words of the command line: options, micrometres."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager

# Arguments that are called otherwise on the command line.
_OTHERWISE = {"cycles": "start-up", "seconds": "edge", "slew_rate": "slew", "base": "present"}
_SAME = ("low", "high", "y_low", "y_high", "frequency", "turns", "speed", "acceleration", "rising", "rounding", "lines",
         "slow", "back", "revolutions", "constant", "ratio", "phase", "levels", "dwell", "shape", "sample_rate", "axis",
         "limits", "present", "approach", "tolerance")  # fmt: skip
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
    """Write a sentence with options for arguments, and micrometres for metres."""
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
