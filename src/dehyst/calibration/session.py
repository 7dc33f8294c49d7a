"""A session: a folder of records that loses no sample, and does not repeat complete records of one axis."""

from __future__ import annotations

import hashlib
import os
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._io import PathLike, demand_version, made_folder, read_json, unwritten, write_json
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.calibration.comparison_loop import Agreement, agreement, replay
from dehyst.instruments import AbstractRig, Samples
from dehyst.records import Record, Recording, about_of, demand_disk_space, read, unused_path
from dehyst.waveforms import Excitation

FORMAT = "dehyst-calibration"


class ProgressListener(Protocol):
    """A receiver of the progress of a calibration."""

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Receive the beginning of step `name`, which plays for `seconds` [s]; 0 for a step that computes."""

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Receive `samples`; `expected` (n,) [m] is their wanted displacement, `stroke` [m] the actuator's stroke."""

    def message(self, text: str) -> None:
        """Receive a `text` on the present activity of the step."""


class NullProgress:
    """A listener that ignores the progress."""

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Ignore the step."""

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Ignore the samples."""

    def message(self, text: str) -> None:
        """Ignore the message."""


class Session:
    """Records from one rig in one folder: ``records/NAME.csv``, or for several axes ``records/NAME-AXIS.csv``.

    Complete records of one axis are kept, so a session continues in the folder of an earlier calibration of the same
    instrument. Records of several axes are moved to ``records/set-aside`` before the first one is played. The listener
    receives the samples; with several axes, the samples of the axis with the largest error.

    `sequence`: the requested records, in order. `played`, `kept`: names of the records that were played, and that were
    on disk. `agreement`: comparison of a loop on disk with its replay; None if no record on disk was kept. Raise
    `FileFormatError` if the folder cannot be made, or belongs to another instrument.
    """

    def __init__(self, folder: PathLike, rig: AbstractRig, listener: ProgressListener) -> None:
        self.folder, self.rig, self._listener = Path(folder), rig, listener
        self.records = claimed(self.folder, rig.identity, rig.axis)
        self._several = len(rig.axes) > 1
        self._comparisons = self.records / "comparisons"
        self.played: list[str] = []
        self.kept: list[str] = []
        self.aside: list[Path] = []
        self.sequence: list[Record] = []
        self.agreement: Agreement | None = None
        self._replayed: Record | None = None

    def record(
        self, excitation: Excitation, name: str, *, wanted: Array | None = None, stroke: Any = None, again: bool = False
    ) -> Record:
        """Play an excitation and write its record, unless the record is on disk already and `again` is false.

        Before the first record on disk is kept, one of its loops is played again and must agree. Raise `RecordError` or
        `RigError` as `AbstractRig.play`; RecordError also if the record on disk seems to belong to another actuator.
        Raise `FileFormatError` if nothing can be written.

        For the listener: `wanted` displacements [m] at each voltage, (n,) or (n, axes), NaN if there is none, and the
        `stroke` [m] of each axis, the reference of the error.
        """
        paths = self._paths(name)
        stored = None if again else self._stored(name, excitation)
        if stored is not None and self._agrees(replace(stored, name=name), excitation):
            self.kept.append(name)
            self.sequence.append(stored)
            return stored
        self._begin(excitation)
        for path in paths:
            self.aside += set_aside(path)
        record = self._play(paths, name, excitation, wanted, stroke)
        if name in self.kept:
            self.kept.remove(name)
        self.played.append(name)
        if self._replayed is not None:
            self.sequence.append(self._replayed)
            self._replayed = None
        self.sequence.append(record)
        return record

    def is_complete(self, excitation: Excitation, name: str) -> bool:
        """Return whether the complete record of an excitation is on disk."""
        return self._stored(name, excitation) is not None

    def hashes(self) -> dict[str, str]:
        """Return the SHA-256 of the file of each requested record."""
        paths = [path for name in dict.fromkeys((*self.kept, *self.played)) for path in self._paths(name)]
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}

    def _begin(self, excitation: Excitation) -> None:
        """Bring the voltage to a safe value once, at first, because the wave of a killed process may still play."""
        demand_disk_space(self.records, len(self.rig.axes) * len(excitation))
        if self.played or self.agreement is not None:
            return
        self.rig.retreat()
        if self._several:
            # Not before it is known that something can be played.
            for path in sorted(self.records.glob("*.csv")):
                self.aside += set_aside(path)

    def _paths(self, name: str) -> list[Path]:
        """Return the files of a record: one for each axis."""
        return [self.records / f"{name}{f'-{axis}' if self._several else ''}.csv" for axis in self.rig.axes]

    def _play(
        self, paths: list[Path], name: str, excitation: Excitation, wanted: Array | None = None, stroke: Any = None
    ) -> Record:
        """Play an excitation and record each axis to its file."""
        self._listener.step(name, excitation.duration)
        about = {
            "rig": self.rig.identity,
            "excitation": excitation.name,
            "key": self._key(excitation),
            "program": __version__,
            "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        }
        rows = self.rig.rows(len(excitation))
        files = [
            Recording(path, about={"axis": axis, **about}, others=self.rig.others)
            for path, axis in zip(paths, self.rig.axes, strict=True)
        ]
        try:
            with ExitStack() as stack:
                for one in files:
                    stack.enter_context(one)

                def listen(samples: Samples) -> None:
                    indices = rows[files[0].samples : files[0].samples + samples.time.size]
                    for j, one in enumerate(files):
                        one.add(samples.axis(j))
                    self._report(samples, None if wanted is None else wanted[indices], stroke)

                played = self.rig.play(excitation, listen)
        except BaseException:
            for one in files:
                if not one.samples:
                    one.path.unlink(missing_ok=True)
            raise
        return replace(played, name=name) if self._several else _recorded(paths[0])

    def _report(self, samples: Samples, wanted: Array | None, stroke: Any) -> None:
        """Pass samples to the listener: with several axes, the samples of the axis with the largest error."""
        if wanted is None or not self._several:
            self._listener.samples(samples.axis(0), wanted, stroke)
            return
        # Nothing is wanted during a homing.
        error = np.nan_to_num(np.abs(samples.displacement - wanted)) / stroke
        worst = int(error.max(axis=0).argmax())
        self._listener.samples(samples.axis(worst), wanted[:, worst], float(stroke[worst]))

    def _agrees(self, stored: Record, excitation: Excitation) -> bool:
        """Return whether a record on disk may be kept; once per session, replay one of its loops and compare.

        False if the record has no loop to compare. Raise RecordError if it belongs to another actuator.
        """
        if self.agreement is not None or stored.name in self.played:
            return True
        loop = replay(excitation)
        if loop is None:
            return False
        folder = made_folder(self._comparisons)
        self._begin(loop)
        played = self._play([unused_path(folder / f"{loop.name}.csv")], loop.name, loop)
        rows = self.rig.rows(len(excitation)), self.rig.rows(len(loop))
        result = agreement(stored, excitation, played, *rows)
        if not result.good:
            raise RecordError(f"{self.folder}: {result.refusal}")
        self._listener.message(result.words)
        self.agreement, self._replayed = result, played
        return True

    def _stored(self, name: str, excitation: Excitation) -> Record | None:
        """Return the record of one axis on disk if it is complete, and of this excitation and instrument."""
        if self._several:
            return None
        try:
            record = _recorded(self._paths(name)[0])
        except (FileFormatError, RecordError):
            return None
        complete = len(record) == self.rig.rows(len(excitation)).size
        return record if complete and record.meta.get("key") == self._key(excitation) else None

    def _key(self, excitation: Excitation) -> str:
        """Return a digest that identifies this excitation on this instrument."""
        header = f"{self.rig.identity} {self.rig.axis} {excitation.sample_rate!r}".encode()
        return hashlib.sha256(header + np.ascontiguousarray(excitation.voltage).tobytes()).hexdigest()


def _recorded(path: Path) -> Record:
    """Return the record in a file, with what its recording states."""
    record = read(path)
    return replace(record, meta={**record.meta, **about_of(path)})


def claimed(folder: Path, rig: str, axis: str) -> Path:
    """Make a `folder` for records and assign it to an instrument: its identity `rig` and its `axis` or axes.

    Returns the folder of records. Raise `FileFormatError` if it cannot be made, or belongs to another instrument.
    """
    records, path = folder / "records", folder / "campaign.json"
    made_folder(records)
    instrument: dict[str, Any] = {"rig": rig, "axis": axis}
    if not os.path.lexists(path):
        write_json(path, {"format": FORMAT, "version": 1, **instrument})
        return records
    try:
        owner = read_json(path)
    except FileFormatError as error:
        raise FileFormatError(f"{error}; or delete it, if the folder is one of this instrument") from error
    demand_version(owner, f"{path}")
    if {key: owner.get(key) for key in instrument} != instrument:
        raise FileFormatError(
            f"{folder}: holds a calibration of {owner.get('rig')}, axis {owner.get('axis')}, and this is "
            f"{rig}, axis {axis}; give another folder with -o"
        )
    return records


def set_aside(path: Path) -> list[Path]:
    """Move a file of records, if it exists, to the folder `set-aside` next to it, and return where it is now.

    Raise `FileFormatError` on failure.
    """
    if not os.path.lexists(path):
        return []
    aside = unused_path(made_folder(path.parent / "set-aside") / path.name)
    try:
        path.rename(aside)
    except OSError as error:
        raise unwritten(aside, error) from error
    return [aside]
