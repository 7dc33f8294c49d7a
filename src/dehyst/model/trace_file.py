"""Files of traces: measured and simulated displacement of the records of a fit, as a NumPy archive."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dehyst._errors import FileFormatError
from dehyst._io.archives import packed
from dehyst._io.drafts import PathLike, write_atomically
from dehyst._io.marks import ARCHIVE
from dehyst._io.reading import reading_errors
from dehyst.model.fit import Trace

_COLUMNS = {"time_s": "time", "voltage_V": "voltage", "measured_m": "measured", "simulated_m": "simulated"}


def write_traces(path: PathLike, traces: Sequence[Trace]) -> None:
    """Write `traces` to a `path` that ends in .npz.

    It has the arrays time_s_1, voltage_V_1, measured_m_1 and simulated_m_1 of the first record, and so on; the array
    "dehyst-output" is JSON in bytes: name, role and first time [s] of each.

    Raises
    ------
    FileFormatError
        The suffix is another one, or the file cannot be written.
    """
    if Path(path).suffix.lower() != ".npz":
        raise FileFormatError(f"{path}: traces are written as a NumPy archive; give a name that ends in .npz")
    heads = [{"record": one.record, "role": one.role, "first_s": min(one.began, *one.time[:1])} for one in traces]
    arrays = {ARCHIVE: np.frombuffer(json.dumps(heads).encode(), dtype=np.uint8)}
    for k, one in enumerate(traces, 1):
        arrays |= {f"{column}_{k}": getattr(one, name) for column, name in _COLUMNS.items()}
    write_atomically(path, packed(arrays))


def read_traces(path: PathLike) -> Iterator[Trace]:
    """Yield the traces that `write_traces` wrote to a `path`, one at a time.

    Raises
    ------
    FileFormatError
        The file cannot be read, or is another one.
    """
    with reading_errors(Path(path), ".npz"), np.load(path, allow_pickle=False) as archive:
        if ARCHIVE not in archive:
            raise FileFormatError(f"{path}: holds no traces; write them with dehyst identify --traces")
        heads: list[dict[str, Any]] = json.loads(archive[ARCHIVE].tobytes())
        for k, head in enumerate(heads, 1):
            columns = {name: archive[f"{column}_{k}"] for column, name in _COLUMNS.items()}
            yield Trace(head["record"], head["role"], **columns, began=float(head["first_s"]))
