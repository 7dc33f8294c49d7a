"""Records of all axes of a rig in one folder: every sample is on disk before the next ones are played."""

from __future__ import annotations

import hashlib
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from dehyst._io.drafts import PathLike
from dehyst._types import Array
from dehyst._version import __version__
from dehyst.instruments import AbstractStageRig, Samples, StageSamples
from dehyst.instruments.calibration import ProgressListener
from dehyst.instruments.calibration.session import claimed, set_aside
from dehyst.records import Record, Recording
from dehyst.records.recording import demand_disk_space, salvage
from dehyst.stages.record import StageRecord


class StageSession:
    """Records on the axes of one rig, in one folder: a file an axis and record, ``records/NAME-AXIS.h5``.

    Raise `FileFormatError` if the folder cannot be made, or belongs to another instrument. Records that are there
    already are moved to ``records/set-aside`` before the first one is played.

    Parameters
    ----------
    folder : path
    rig : AbstractStageRig
    listener : ProgressListener
        Receives the samples of the axis that is farthest off its path; of the first one where there is no path.

    Attributes
    ----------
    sequence : list of StageRecord
        The records, in the order in which they were played.
    """

    def __init__(self, folder: PathLike, rig: AbstractStageRig, listener: ProgressListener) -> None:
        self.folder, self.rig, self._listener = Path(folder), rig, listener
        self.records = claimed(self.folder, rig.identity, ",".join(rig.axes))
        salvage(self.records)
        self.sequence: list[StageRecord] = []

    def record(
        self,
        voltage: Array,
        sample_rate: float,
        name: str,
        *,
        wanted: Array | None = None,
        strokes: Array | None = None,
    ) -> StageRecord:
        """Play voltages on all axes and write their records.

        Raise `RecordError` or `RigError` as `AbstractStageRig.play`, `FileFormatError` if nothing can be written.

        Parameters
        ----------
        voltage : (n, axes) array
            [V].
        sample_rate : float
            [Hz].
        name : str
            Of the record and its files.
        wanted : (n, axes) array, optional
            Wanted displacements [m], for the listener; NaN where none is wanted.
        strokes : (axes,) array, optional
            References of their errors [m]; needed with `wanted`.
        """
        demand_disk_space(self.records, len(self.rig.axes) * len(voltage))
        if not self.sequence:
            # The wave of a killed process may still be playing.
            self.rig.retreat()
            # Not before it is known that something can be played.
            for path in sorted(self.records.glob("*.h5")):
                set_aside(path)
        self._listener.step(name, (len(voltage) - 1) / sample_rate)
        rows = self.rig.rows(len(voltage))
        with ExitStack() as stack:
            files = [stack.enter_context(self._recording(name, j)) for j in range(len(self.rig.axes))]

            def listen(samples: StageSamples) -> None:
                indices = rows[files[0].samples : files[0].samples + samples.time.size]
                for j, recording in enumerate(files):
                    recording.add(_axis(samples, j))
                if wanted is None or strokes is None:
                    self._listener.samples(_axis(samples, 0))
                    return
                # Nothing is wanted during a homing.
                error = np.nan_to_num(np.abs(samples.displacement - wanted[indices])) / strokes
                worst = int(error.max(axis=0).argmax())
                self._listener.samples(_axis(samples, worst), wanted[indices, worst], float(strokes[worst]))

            played = self.rig.play(voltage, sample_rate, listen, name=name)
            for j, recording in enumerate(files):
                recording.finish(Record(*_axis(played, j), recording.name))
        record = StageRecord(played.time, played.voltage, played.displacement, self.rig.axes, name)
        self.sequence.append(record)
        return record

    def hashes(self) -> dict[str, str]:
        """Return the SHA-256 of the file of each record."""
        return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(self.records.glob("*.h5"))}

    def _recording(self, name: str, j: int) -> Recording:
        axis = self.rig.axes[j]
        meta = {"identity": self.rig.identity, "axis": axis, "excitation": name, "program": __version__}
        return Recording(self.records / f"{name}-{axis}.h5", name=f"{name}, axis {axis}", meta=meta)


def _axis(samples: StageSamples, j: int) -> Samples:
    columns = (np.ascontiguousarray(rows[:, j]) for rows in (samples.voltage, samples.displacement))
    return Samples(samples.time, *columns)
