"""A player of excitations, and a session: a folder of records that loses no sample and repeats no complete record."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._io import PathLike, lock, made_folder, unwritten
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments import AbstractRig, Samples, StepFunction
from dehyst.records import Columns, Record, Recording, about_of, read
from dehyst.waveforms import Excitation

# Multiples of the planned time, and of the median step of time, above which a record causes a remark.
_SLOW_FACTOR, _JUMP = 1.1, 50.0


class ProgressListener:
    """A receiver of the progress on a rig; this base class ignores it."""

    def step(self, name: str, seconds: float = 0.0) -> None:
        """Receive the beginning of step `name`, which plays for `seconds` [s]; 0 for a step that computes."""

    def samples(self, samples: Samples) -> None:
        """Receive `samples` of the first axis."""

    def message(self, text: str) -> None:
        """Receive a `text` on the present activity of the step."""


class Player(AbstractContextManager["Player"]):
    """Plays excitations on a `rig`; the file `path` has the samples of all axes before the `listener` receives them.

    `about`: written above the samples, beside the names of the axes. `states_wanted`: whether the file has columns of
    the wanted displacement. Use it in a with-statement; a file without a sample is removed at its end. Raise
    `FileFormatError` if the file exists or cannot be written.
    """

    def __init__(
        self,
        rig: AbstractRig,
        path: Path,
        about: Mapping[str, Any],
        listener: ProgressListener,
        *,
        states_wanted: bool = False,
    ) -> None:
        self._rig, self._listener, axes = rig, listener, rig.axes if len(rig.axes) > 1 else ()
        wanted = [f"wanted_{axis}_um" for axis in axes] or ["wanted_um"]
        self._wanted = wanted if states_wanted else []
        self.file = Recording(path, about={"axis": rig.axis, **about}, others=(*rig.others, *self._wanted), axes=axes)

    def __exit__(self, *_: object) -> None:
        self.file.close()
        if not self.file.samples:
            self.file.path.unlink(missing_ok=True)

    def play(self, excitation: Excitation, wanted: Array | None = None, *, step: StepFunction | None = None) -> Record:
        """Play an `excitation` and return its record; raise as `AbstractRig.play`, or `FileFormatError` on a full disk.

        `wanted`: displacements [m] at each voltage, (n,) or (n, axes), if the file has them. `step`: as of the rig.
        """
        rows, count = self._rig.rows(len(excitation)), 0
        columns = None if wanted is None else 1e6 * wanted.reshape(len(excitation), -1)

        def listen(samples: Samples) -> None:
            nonlocal count
            at = rows[count : count + samples.time.size]
            count += samples.time.size
            targets = {} if columns is None else dict(zip(self._wanted, columns[at].T, strict=True))
            self.file.add(samples._replace(others={**samples.others, **targets}))
            self._listener.samples(samples.axis(0))

        return self._rig.play(excitation, listen, step=step)


class Session(AbstractContextManager["Session"]):
    """Records from one rig in one folder: ``records/NAME.csv``, each with all axes.

    The records are its only state. A session in the folder of an interrupted one keeps each complete record of the same
    excitation and the same instrument, and continues. Close it, or use it in a with-statement.

    `sequence`: the requested records, in order. `played`, `kept`: names of the records that were played, and that were
    on disk. `aside`: files that are cut off, damaged or of another plan, moved to ``records/set-aside``. Raise
    `FileFormatError` if the folder cannot be made, another calibration writes into it, or it holds records of another
    instrument.
    """

    def __init__(self, folder: PathLike, rig: AbstractRig, listener: ProgressListener) -> None:
        self.folder, self.rig, self._listener = Path(folder), rig, listener
        self.records = made_folder(self.folder / "records")
        self.played: list[str] = []
        self.kept: list[str] = []
        self.aside: list[Path] = []
        self.sequence: list[Record] = []
        self._lock = -1 if os.name == "nt" else os.open(self.records, os.O_RDONLY)  # Windows opens no folders
        try:
            self._demand_own()
        except BaseException:
            self.close()
            raise

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let another session use the folder."""
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1

    def record(self, excitation: Excitation, name: str, *, again: bool = False) -> Record:
        """Play an excitation and write its record, unless the record is on disk already and `again` is false.

        Raise `RecordError` or `RigError` as `AbstractRig.play`, and `FileFormatError` if nothing can be written.
        """
        record = None if again else self.stored(name, excitation)
        if record is not None:
            self.kept.append(name)
        else:
            if not self.played:
                # The wave of a killed process may still play.
                self.rig.retreat()
            if os.path.lexists(self._path(name)):
                self.aside.append(self._set_aside(self._path(name)))
            record = self._play(name, excitation)
            self.kept = [other for other in self.kept if other != name]
            self.played.append(name)
        self.sequence.append(record)
        return record

    def _demand_own(self) -> None:
        """Lock the folder, and refuse records of another instrument."""
        try:
            if self._lock >= 0:
                lock(self._lock)
        except BlockingIOError as error:
            raise FileFormatError(
                f"{self.folder}: another calibration writes into it; wait until it has ended, or give another folder"
            ) from error
        for path in sorted(self.records.glob("*.csv")):
            about = about_of(path)
            if {"rig", "axis"} <= set(about) and (about["rig"], about["axis"]) != (self.rig.identity, self.rig.axis):
                raise FileFormatError(
                    f"{self.folder}: holds a record of {about['rig']}, axis {about['axis']}, and this is "
                    f"{self.rig.identity}, axis {self.rig.axis}; give another folder with -o"
                )

    def _set_aside(self, path: Path) -> Path:
        """Move a file of records to the folder `set-aside` next to it, and return where it is now."""
        aside, number = made_folder(path.parent / "set-aside") / path.name, 1
        # A dangling link counts as existing: data written to it would go to another place.
        while os.path.lexists(aside):
            number += 1
            aside = aside.with_name(f"{path.stem}-{number}{path.suffix}")
        try:
            return path.rename(aside)
        except OSError as error:
            raise unwritten(aside, error) from error

    def _path(self, name: str) -> Path:
        return self.records / f"{name}.csv"

    def _play(self, name: str, excitation: Excitation) -> Record:
        """Play an excitation and record it."""
        self._listener.step(name, excitation.duration)
        about = {
            "rig": self.rig.identity,
            "excitation": excitation.name,
            "key": self._key(excitation),
            "program": __version__,
            "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
        }
        with Player(self.rig, self._path(name), about, self._listener) as player:
            player.play(excitation)
        return self._read(name)

    def _read(self, name: str) -> Record:
        """Return a record from its file, with what its recording states."""
        axes = self.rig.axes if len(self.rig.axes) > 1 else ()
        record = read(self._path(name), Columns(axes={axis: f"v{axis}_V:{axis}_um" for axis in axes}))
        return replace(record, meta={**record.meta, **about_of(self._path(name))})

    def stored(self, name: str, excitation: Excitation) -> Record | None:
        """Return the record on disk if it is complete, and of this excitation and instrument."""
        try:
            record = self._read(name)
        except (FileFormatError, RecordError, ValueError):
            return None
        whole = len(record) == self.rig.rows(len(excitation)).size
        return record if whole and record.meta.get("key") == self._key(excitation) else None

    def _key(self, excitation: Excitation) -> str:
        """Return a digest that identifies this excitation on this instrument."""
        header = f"{self.rig.identity} {self.rig.axis} {excitation.sample_rate!r}".encode()
        return hashlib.sha256(header + np.ascontiguousarray(excitation.voltage).tobytes()).hexdigest()


def slower(record: Record, planned: Excitation) -> Iterator[str]:
    """Yield a remark if the rig took longer than planned, or its time jumped."""
    steps, factor = np.diff(record.time), float(np.ptp(record.time)) / planned.duration
    if steps.max() > _JUMP * np.median(steps):
        at = record.time[steps.argmax()]
        yield f"The time of the rig jumps by {steps.max():.3g} s at {at:.6g} s: check its clock."
    elif factor > _SLOW_FACTOR:
        words = "the record has the slower speed. Use a faster link, or play it slower"
        yield f"The rig took {factor:.3g} times as long as planned for '{planned.name}': {words}."
