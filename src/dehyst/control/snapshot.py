"""The whole memory of a compensator's loop, as a value and a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

from dehyst._errors import ModelError
from dehyst._io.drafts import PathLike
from dehyst._io.json_files import read_json, write_json
from dehyst._types import Array
from dehyst._validation import keep, vector
from dehyst.model import Actuator, State, serialization

FORMAT = "dehyst-loop"
VERSION = 1
# Range of the core's counts on every machine.
_MOST = 2**31
# Entries of a model file on which a loop does not depend.
_FREE = {"name", "provenance", "limits", "state"}


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The memory of a loop between two steps.

    Attributes
    ----------
    key : str
        Digest of the actuator's numbers, the period and the preview: the snapshot fits no other loop.
    state : State
        State of the actuator.
    rest : (6 + M,) array
        The remaining memory: the last voltage, the output of the amplifier, its two inputs before, the push and the
        velocity of the mass, and the displacements fed, newest first.
    counts : (int, int, int)
        Numbers of samples limited, slewed and refused.
    """

    key: str
    state: State
    rest: Array
    counts: tuple[int, int, int]

    def __post_init__(self) -> None:
        if not isinstance(self.state, State):
            raise ModelError(f"snapshot: got a state of type {type(self.state).__name__}, need a State")
        keep(self, rest=vector(self.rest, "snapshot: rest"))
        counts = self.counts
        whole = isinstance(counts, Sequence) and [type(n) for n in counts] == [int] * 3
        if not whole or not all(0 <= n < _MOST for n in counts):
            raise ModelError(f"snapshot: counts: got {counts!r}, need three whole numbers below {_MOST}")
        keep(self, counts=tuple(counts))

    def save(self, path: PathLike) -> None:
        """Write the snapshot to `path` as JSON, completely or not at all.

        Raise `FileFormatError` if it cannot be written.
        """
        head = {"format": FORMAT, "version": VERSION, "key": self.key}
        memory = {"rest": self.rest.tolist(), "counts": list(self.counts)}
        write_json(path, {**head, "state": serialization.state_dict(self.state), **memory})

    @classmethod
    def load(cls, path: PathLike) -> Snapshot:
        """Read a snapshot from `path`, strictly and without loss.

        Raises
        ------
        FileFormatError
            If the file cannot be read or is not JSON.
        ModelError
            If it is not a snapshot of this version.
        """
        data = read_json(path)
        if data.get("format") != FORMAT or type(data.get("version")) is not int or data["version"] != VERSION:
            raise ModelError(
                f"{path}: got format {data.get('format')!r} version {data.get('version')!r}, need {FORMAT!r} {VERSION}"
            )
        serialization.demand_keys(data, {"format", "version", "key", "state", "rest", "counts"}, "snapshot")
        try:
            rest = serialization.numbers(data["rest"], "rest")
            return cls(str(data["key"]), serialization.state(data), rest, data["counts"])
        except ModelError as error:
            raise ModelError(f"{path}: {error}") from error


def key_of(actuator: Actuator, period: float | None, preview: bool) -> str:
    """Return the digest that a snapshot of a loop has as its key."""
    numbers = {name: value for name, value in actuator.as_dict().items() if name not in _FREE}
    text = json.dumps([numbers, period, preview], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
