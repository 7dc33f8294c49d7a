"""What engines have in common: a task that ended, and the number of processors."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any, NamedTuple

from dehyst.fleet.dataset import Task


class Done(NamedTuple):
    """A task that ended: what its worker answers, or the `reason` why there is no row."""

    task: Task
    answer: Mapping[str, Any]
    reason: str = ""


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
