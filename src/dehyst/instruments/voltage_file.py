"""A voltage to play, from a file."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._types import Array
from dehyst.records import read_table
from dehyst.records.files import time_of
from dehyst.records.formats.file_content import MOST
from dehyst.waveforms import Excitation

# Share of the median by which the steps of time may differ.
_UNEVEN = 1e-3


class WantedVoltage(NamedTuple):
    """An `excitation`, and the displacement (n,) [m] that is `wanted` at each of its voltages, or None."""

    excitation: Excitation
    wanted: Array | None


def read_voltage(path: Path, *, max_bytes: float = MOST) -> WantedVoltage:
    """Read a voltage to play, as `dehyst excite` and `dehyst compensate` write it.

    Parameters
    ----------
    path : Path
        A table with time [s] and voltage [V], and perhaps the wanted displacement.
    max_bytes : float
        Largest size of the file.

    Raises
    ------
    FileFormatError
        If it cannot be read, or the times are not evenly spaced.
    """
    table = read_table(path, max_bytes=max_bytes)
    voltage = table.column("voltage")
    time = time_of(table, voltage.size, None, None)
    steps = np.diff(time)
    if not steps.size or float(np.ptp(steps)) > _UNEVEN * float(np.median(steps)):
        raise FileFormatError(f"{path}: the times are not evenly spaced; write it with dehyst excite, or resample it")
    excitation = Excitation(path.stem, voltage, 1 / float(np.median(steps)))
    try:
        wanted = table.column("displacement")
    except FileFormatError:
        wanted = None
    return WantedVoltage(excitation, wanted)
