"""The options of a run over a fleet: what every task needs to know, as JSON."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from dehyst._errors import IdentifyError
from dehyst._version import __version__

STRUCTURES = ("plain", "auto")


@dataclass(frozen=True)
class FleetOptions:
    """How every record is identified.

    Parameters
    ----------
    structure : str
        "plain": Maxwell-slip elements and a spring. "auto": parts selected by cross-validation, as `dehyst.identify`.
    elements : int, optional
        Number of slip elements of the plain class.
    norm : str
    drift : bool
    delay : float, optional
        Lag of the displacement [s]; default: estimated from each record.
    time, voltage, displacement, voltage_scale, displacement_scale : str, optional
        Columns, as in `dehyst.read`.
    sample_rate : float, optional
        [Hz], for records without a time.
    prior : mapping, optional
        A shape of an identified fleet, see `dehyst.fleet.prior`.

    Raises
    ------
    IdentifyError
        If an option is impossible.
    """

    structure: Literal["plain", "auto"] = "plain"
    elements: int | None = None
    norm: str = "l1"
    drift: bool = True
    delay: float | None = None
    time: str | None = None
    voltage: str | None = None
    displacement: str | None = None
    voltage_scale: str | None = None
    displacement_scale: str | None = None
    sample_rate: float | None = None
    prior: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        if self.structure not in STRUCTURES:
            raise IdentifyError(f"structure: got {self.structure!r}, need 'plain' or 'auto'")
        if self.structure == "auto" and (self.elements is not None or self.prior is not None):
            raise IdentifyError("structure: 'auto' takes neither elements nor a prior; try structure='plain'")

    @property
    def columns(self) -> dict[str, Any]:
        """The arguments of `dehyst.read`."""
        names = ("time", "voltage", "displacement", "voltage_scale", "displacement_scale", "sample_rate")
        return {name: getattr(self, name) for name in names if getattr(self, name) is not None}

    @property
    def identification(self) -> dict[str, Any]:
        """The arguments of `dehyst.identify`."""
        plain = self.structure == "plain"
        given = {"structure": "paper" if plain else "auto", "norm": self.norm, "drift": self.drift}
        return {**given, "delay": self.delay, **({"elements": self.elements} if plain else {})}

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)

    def digest(self, dataset: str) -> str:
        """Return the hash of the digest of a `dataset`, these options and the version."""
        text = json.dumps([dataset, self.as_dict(), __version__], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()
