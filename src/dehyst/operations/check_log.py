"""The table to which `check` appends its results."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from dehyst._errors import FileFormatError
from dehyst._io import unwritten, write_atomically
from dehyst.records import percent
from dehyst.trust import Recheck

_COLUMNS = (
    *("date", "record", "model", "axis", "standing", "error_percent", "rms_percent", "goal_percent"),
    *("promised_percent", "promise_kept", "changes"),
)


def read_log(path: Path, *, again: bool = False) -> bytes:
    """Return a table of checks, or the header of one that begins; raise `FileFormatError` if it is another table."""
    header = ",".join(_COLUMNS).encode() + b"\n"
    try:
        before = (path.read_bytes() if path.exists() and not again else b"") or header
    except OSError as error:
        raise unwritten(path, error) from error
    if not before.startswith(header):
        words = f"has other columns than a table of checks, {','.join(_COLUMNS)}"
        raise FileFormatError(f"{path}: {words}; give another name with --log")
    return before


def append_checks(path: Path, before: bytes, checks: Mapping[str, Recheck]) -> None:
    """Write a table of checks with another row for the check of each axis."""
    stream, now = io.StringIO(), f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    csv.writer(stream, lineterminator="\n").writerows(_row(now, axis, check) for axis, check in checks.items())
    write_atomically(path, before.rstrip(b"\n") + b"\n" + stream.getvalue().encode())


def _row(now: str, axis: str, check: Recheck) -> list[str]:
    """Return a check by column; a number that is not known is empty."""
    row = [now, check.record, check.model, axis, check.standing.value]
    row += [f"{percent(part, check.stroke):.4g}" for part in (check.without_noise, check.rms)]
    promised = None if check.promise is None else f"{percent(check.promise.largest, check.stroke):.4g}"
    row += [f"{check.goal:.4g}", *(["", ""] if promised is None else [promised, "yes" if check.kept else "no"])]
    signs = {change.name: "-" if change.value < 0 else "+" for change in check.changed}
    return [*row, "; ".join(f"{new.name} {signs[new.name]}{new.amount(check.stroke)}" for new in check.changed)]
