"""A record that is being taken: a CSV file to which samples are appended, each block on the disk before the next."""

from __future__ import annotations

import contextlib
import errno
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from dehyst._errors import FileFormatError, RecordError
from dehyst._io import PathLike, path_of, settle, settle_folder, to_json, unwritten
from dehyst.records.formats.column import Column
from dehyst.records.formats.containers import LINE, LONGEST
from dehyst.records.record import Channel

_MICRO, _EMPTY = 1e6, MappingProxyType[str, Any]({})


class Recording:
    """A CSV file of a record that is being taken, which `read` reads at any time, also after the process was killed.

    ::

        with Recording("tops.csv") as recording:
            rig.play(excitation, recording.add)

    Parameters
    ----------
    path : path
        The file, .csv, which may not exist yet.
    about : mapping, optional
        Written above the samples, as JSON in a comment; see `about_of`.
    others : sequence of str
        Names of further channels, as "temperature_C" and "humidity [%]"; each block of samples holds them in a mapping
        ``samples.others``.
    axes : sequence of str
        Names of several axes, as "x" and "y": the columns of each are vx_V and x_um.

    Attributes
    ----------
    path : Path
    samples : int
        Number of samples so far.

    Raises
    ------
    FileFormatError
        The path exists or cannot be written, `about` cannot be written as JSON, or one of `others` has no unit.
    """

    def __init__(
        self, path: PathLike, *, about: Mapping[str, Any] = _EMPTY, others: Sequence[str] = (), axes: Sequence[str] = ()
    ) -> None:
        self.path, self.others, self.samples = path_of(path), tuple(others), 0
        measured = [f"v{axis}_V" for axis in axes] + [f"{axis}_um" for axis in axes] or ["voltage_V", "displacement_um"]
        self._columns = ("time_s", *measured, *self.others)
        channels = [Channel.of(Column(column, np.zeros(1))) for column in self.others]
        if fault := next((channel.fault for channel in channels if channel.fault), ""):
            raise FileFormatError(argument="others", message=fault)
        if self.path.suffix.lower() != ".csv":
            raise FileFormatError(f"{path}: a recording needs the suffix .csv; rename it")
        stated = {"others": [channel.column for channel in channels if channel.role == "other"]} if channels else {}
        head = to_json({**stated, **about}, f"{self.path}: about")
        self._failure: FileFormatError | None = None
        try:
            self._stream = self.path.open("xb", buffering=0)
        except FileExistsError as error:
            raise FileFormatError(f"{path}: is there already, and no record is overwritten; name another") from error
        except OSError as error:
            raise unwritten(path, error) from error
        try:
            self._write(f"{LINE}{head}\n{','.join(self._columns)}\n".encode())
        except FileFormatError:
            self.close()
            self.path.unlink(missing_ok=True)
            raise
        self.samples = 0
        settle_folder(self.path.parent)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, samples: Any) -> None:
        """Append samples after the earlier ones; they are on the disk when this returns.

        `samples` has arrays (n,) ``time`` [s], ``voltage`` [V] and ``displacement`` [m]; of several axes, the last two
        are (n, axes). With further channels it also has ``others``, arrays (n,) by column name.

        Raises
        ------
        RecordError
            If the columns are not of one length, one of `others` is missing, or the recording is closed.
        FileFormatError
            If samples cannot be written, because the disk is full or the file was removed. Samples that are written
            stay; later ones are refused, because of the gap.
        """
        if self._stream.closed:
            raise RecordError(f"{self.path}: this recording is closed; begin another")
        further = getattr(samples, "others", {})
        if missing := [column for column in self.others if column not in further]:
            raise RecordError(f"{self.path}: got samples without {', '.join(missing)}, need all columns")
        voltage, displacement = np.transpose(samples.voltage), _MICRO * np.transpose(samples.displacement)
        given = samples.time, *np.atleast_2d(voltage), *np.atleast_2d(displacement), *map(further.get, self.others)
        columns = [np.asarray(values, dtype=np.float64).ravel() for values in given]
        sizes = [column.size for column in columns]
        if len(set(sizes)) > 1 or len(sizes) != len(self._columns):
            raise RecordError(f"{self.path}: got {sizes} values, need {len(self._columns)} columns of one length")
        rows = zip(*(map(repr, column.tolist()) for column in columns), strict=True)
        self._write("".join(f"{','.join(row)}\n" for row in rows).encode())

    def close(self) -> None:
        """End the recording; may be called twice."""
        self._stream.close()

    def _write(self, data: bytes) -> None:
        """Append lines, and count them; `read` leaves out a line that is cut off."""
        if self._failure is not None:
            raise self._failure
        done = 0
        try:
            while done < len(data):
                done += self._stream.write(data[done:])
            settle(self._stream.fileno())
            if not os.fstat(self._stream.fileno()).st_nlink:
                raise OSError(errno.ENOENT, "it was removed while recording")
        except OSError as error:
            self._failure = unwritten(self.path, error)
            raise self._failure from error
        finally:
            self.samples += data.count(b"\n", 0, done)


def about_of(path: Path) -> dict[str, Any]:
    """Return what a recording states above its samples; nothing if it states nothing, or cannot be read."""
    with contextlib.suppress(OSError, ValueError, RecursionError), path.open("rb") as stream:
        stated = json.loads(stream.readline(LONGEST).decode().removeprefix(LINE))
        return stated if isinstance(stated, dict) else {}
    return {}
