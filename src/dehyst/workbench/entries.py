"""What a workbench holds: records, models, voltages and jobs, as the page and the state file show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

_T = TypeVar("_T", bound="RecordEntry | ModelEntry | VoltageEntry")


@dataclass
class RecordEntry:
    """A record: an uploaded `source`, and the `file` in which it is in SI units once it is ready.

    `columns` are the names of the file's, none if it is no table. `options` are those with which it was read; `hint`
    those that may help to read it.
    """

    id: str
    name: str
    source: str
    file: str = ""
    status: str = "reading"
    error: str | None = None
    hint: dict[str, Any] | None = None
    columns: list[str] = field(default_factory=list)
    options: dict[str, Any] = field(default_factory=dict)
    samples: int = 0
    seconds: float = 0.0
    rate_hz: float = 0.0
    voltage: list[float] = field(default_factory=list)
    displacement_um: list[float] = field(default_factory=list)
    noise_nm: float = 0.0
    words: list[str] = field(default_factory=list)


@dataclass
class ModelEntry:
    """A model: which records it is from, and what is known of it.

    `rig` names the instrument of a calibrated model, which has no records of the list, and no `seconds` of its own.
    `table` has an entry a record: role, largest and RMS error [% of the stroke].
    """

    id: str
    name: str
    file: str
    train: list[str] = field(default_factory=list)
    validate: list[str] = field(default_factory=list)
    rig: str = ""
    report: str = ""
    options: dict[str, Any] = field(default_factory=dict)
    status: str = "identifying"
    progress: str = ""
    seconds: float | None = 0.0
    provisional: bool = False
    early: bool = False
    error: str | None = None
    verdict: dict[str, Any] | None = None
    summary: list[str] = field(default_factory=list)
    table: list[dict[str, Any]] = field(default_factory=list)
    range_v: list[float] = field(default_factory=list)
    range_um: list[float] = field(default_factory=list)
    slew_v_per_s: float | None = None
    band_percent: float | None = None
    insight: dict[str, Any] | None = None

    @property
    def fit(self) -> str:
        """The file of the fit's numbers."""
        return self.file.removesuffix(".json") + ".fit.json"

    @property
    def traces(self) -> str:
        """The file of its traces."""
        return self.file.removesuffix(".json") + ".npz"


@dataclass
class VoltageEntry:
    """A voltage that follows a path with a model, and what to know of it in `words`."""

    id: str
    name: str
    file: str
    model: str
    samples: int = 0
    seconds: float = 0.0
    range_v: list[float] = field(default_factory=list)
    clamped: int = 0
    words: list[str] = field(default_factory=list)


@dataclass
class JobEntry:
    """A running or ended command."""

    id: str
    kind: str
    subject: str
    words: str
    status: str = "running"
    progress: str = ""
    error: str | None = None


def restored(kind: type[_T], saved: Mapping[str, Any]) -> _T:
    """Return an entry from a state file; what it does not know is left out."""
    known = {one.name for one in fields(kind)}
    return kind(**{name: value for name, value in saved.items() if name in known})
