"""A folder of records being made: what is on disk is not played again, and nothing that was recorded is lost."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._io.drafts import PathLike, unwritten
from dehyst._io.json_files import read_json, write_json
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments.base import AbstractRig, Samples
from dehyst.instruments.calibration.comparison_loop import Agreement, agreement, replay
from dehyst.records import Record, Recording, read
from dehyst.records.hdf5 import sha256_of
from dehyst.records.recording import demand_disk_space, salvage, unused_path
from dehyst.waveforms import Excitation

FORMAT = "dehyst-calibration"


class ProgressListener(Protocol):
    """Who is told how a calibration goes on."""

    def step(self, name: str, seconds: float = 0.0) -> None:
        """A step begins, and plays for so long [s]; 0 for one that computes."""

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Samples came; `expected` (n,) [m] is the displacement wanted of them, of a stroke [m]."""

    def tell(self, words: str) -> None:
        """What the step does now."""


class NullProgress:
    """A watcher that tells nobody."""

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Pass over it."""

    def samples(self, samples: Samples, expected: Array | None = None, stroke: float | None = None) -> None:
        """Pass over them."""

    def tell(self, words: str) -> None:
        """Pass over it."""


class Session:
    """Records on one rig, in one folder.

    Parameters
    ----------
    folder : path
        Made if it does not exist. One that a calibration of the same instrument left is gone on with.
    rig : AbstractRig
    watcher : ProgressListener

    Attributes
    ----------
    sequence : list of Record
        What was asked for, in order.
    played, kept : list of str
        Names of the records that were played, and of those that were on disk.
    agreement : Agreement or None
        How far a loop of the records on disk, played again, agrees with them; None if none of them was kept.
    salvaged : tuple of Path
        What a killed process had left.

    Raises
    ------
    FileFormatError
        If the folder cannot be made, or is one of another instrument.
    """

    def __init__(self, folder: PathLike, rig: AbstractRig, watcher: ProgressListener) -> None:
        self.folder, self.rig, self._watcher = Path(folder), rig, watcher
        self.records = self.folder / "records"
        try:
            self.records.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileFormatError(
                f"{folder}: cannot be made a folder ({error.strerror}); give another one with -o"
            ) from error
        self._claim()
        self._comparisons = self.records / "comparisons"
        self.salvaged = tuple(salvage(self.records))
        if self._comparisons.is_dir():
            salvage(self._comparisons)
        self.played: list[str] = []
        self.kept: list[str] = []
        self.sequence: list[Record] = []
        self.agreement: Agreement | None = None
        self._replayed: Record | None = None

    def record(
        self,
        excitation: Excitation,
        name: str,
        *,
        wanted: Array | None = None,
        stroke: float | None = None,
        afresh: bool = False,
    ) -> Record:
        """Play an excitation and have its record on disk, unless it is there already.

        Before the first record on disk is kept, a loop of it is played again and must agree.

        Parameters
        ----------
        excitation : Excitation
        name : str
            Of the record and its file.
        wanted : (n,) array, optional
            Displacement [m] of each voltage, for who watches; NaN where none is wanted.
        stroke : float, optional
            What its error refers to [m].
        afresh : bool
            Whether to play it though it is on disk.

        Raises
        ------
        RecordError, RigError
            As `AbstractRig.play`; RecordError also if the record on disk looks like one of another actuator.
        FileFormatError
            If nothing can be written.
        """
        path = self.records / f"{name}.h5"
        found = None if afresh else self._whole(path, excitation)
        if found is not None and self._agrees(found.with_name(name), excitation):
            self.kept.append(name)
            self.sequence.append(found)
            return found
        self._set_aside(path)
        record = self._play(path, name, excitation, wanted, stroke)
        if name in self.kept:
            self.kept.remove(name)
        self.played.append(name)
        if self._replayed is not None:
            self.sequence.append(self._replayed)
            self._replayed = None
        self.sequence.append(record)
        return record

    def _play(
        self, path: Path, name: str, excitation: Excitation, wanted: Array | None = None, stroke: float | None = None
    ) -> Record:
        """Play an excitation and record it to a file."""
        demand_disk_space(path.parent, len(excitation))
        if not self.played and self.agreement is None:
            # What a killed process left may still be playing.
            self.rig.retreat()
        self._watcher.step(name, excitation.duration)
        meta = {
            "identity": self.rig.identity,
            "axis": self.rig.axis,
            "excitation": excitation.name,
            "key": self._key(excitation),
            "program": __version__,
        }
        rows = self.rig.rows(len(excitation))
        recording = Recording(path, name=name, meta=meta)
        try:
            with recording:

                def listen(samples: Samples) -> None:
                    here = rows[recording.samples : recording.samples + samples.time.size]
                    recording.add(samples)
                    self._watcher.samples(samples, None if wanted is None else wanted[here], stroke)

                recording.finish(self.rig.play(excitation, listen))
        except BaseException:
            if not recording.samples:
                path.unlink(missing_ok=True)
            raise
        return read(path)

    def _agrees(self, stored: Record, excitation: Excitation) -> bool:
        """Whether a record on disk may be kept; once a session, a loop of it is played again and compared.

        False if it has no loop to compare. Raises RecordError if it is of another actuator.
        """
        if self.agreement is not None or stored.name in self.played:
            return True
        loop = replay(excitation)
        if loop is None:
            return False
        folder = _folder(self._comparisons)
        played = self._play(unused_path(folder / f"{loop.name}.h5"), loop.name, loop)
        rows = self.rig.rows(len(excitation)), self.rig.rows(len(loop))
        found = agreement(stored, excitation, played, *rows)
        if not found.good:
            raise RecordError(f"{self.folder}: {found.refusal}")
        self._watcher.tell(found.words)
        self.agreement, self._replayed = found, played
        return True

    def holds(self, excitation: Excitation, name: str) -> bool:
        """Whether the record of an excitation is on disk, whole."""
        return self._whole(self.records / f"{name}.h5", excitation) is not None

    def hashes(self) -> dict[str, str]:
        """Sha256 of the file of each record that was asked for."""
        paths = [self.records / f"{name}.h5" for name in dict.fromkeys((*self.kept, *self.played))]
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}

    def _set_aside(self, path: Path) -> None:
        """Move what stands under a name, cut off or of another excitation, to where it is not taken for a record."""
        if os.path.lexists(path):
            aside = unused_path(_folder(self.records / "set-aside") / path.name)
            try:
                path.rename(aside)
            except OSError as error:
                raise unwritten(aside, error) from error

    def _claim(self) -> None:
        """Make sure that the folder is of this instrument; raises FileFormatError."""
        path, mine = self.folder / "campaign.json", self._instrument()
        if not os.path.lexists(path):
            write_json(path, {"format": FORMAT, "version": 1, **mine})
            return
        try:
            found = read_json(path)
        except FileFormatError as error:
            raise FileFormatError(f"{error}; or delete it, if the folder is one of this instrument") from error
        if {key: found.get(key) for key in mine} != mine:
            raise FileFormatError(
                f"{self.folder}: holds a calibration of {found.get('rig')}, axis {found.get('axis')}, and this is "
                f"{mine['rig']}, axis {mine['axis']}; give another folder with -o"
            )

    def _instrument(self) -> dict[str, Any]:
        return {"rig": self.rig.identity, "axis": self.rig.axis}

    def _whole(self, path: Path, excitation: Excitation) -> Record | None:
        """The record in a file if it is whole, undamaged and of this excitation on this instrument."""
        try:
            record = read(path)
        except (FileFormatError, RecordError):
            return None
        meta, samples = record.meta, (record.time, record.voltage, record.displacement)
        of_this = meta.get("key") == self._key(excitation) and meta.get("sha256") == sha256_of(samples)
        fits = len(record) == self.rig.rows(len(excitation)).size
        return record if of_this and fits and meta.get("complete") is True else None

    def _key(self, excitation: Excitation) -> str:
        """What tells one excitation on one instrument from any other."""
        told = f"{self.rig.identity} {self.rig.axis} {excitation.sample_rate!r}".encode()
        return hashlib.sha256(told + np.ascontiguousarray(excitation.voltage).tobytes()).hexdigest()


def _folder(path: Path) -> Path:
    """The folder of this name, made if it is not there; raises FileFormatError."""
    try:
        path.mkdir(exist_ok=True)
    except FileExistsError as error:
        raise FileFormatError(f"{path}: is a file where a folder is needed; move it elsewhere") from error
    except OSError as error:
        raise unwritten(path, error) from error
    return path
