"""BLAS with one thread while dehyst solves: more threads make its small factorisations slower."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["one_thread"]

_lock = threading.Lock()
# The limit holds for the whole process: the first solver sets it, the last one removes it.
_limit: Any = None
_solvers = 0


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit every BLAS library to one thread; works as a decorator, nested, and in several threads at once."""
    global _limit, _solvers  # noqa: PLW0603
    # Only loaded libraries can be limited, and SciPy brings a BLAS of its own.
    import scipy.linalg  # noqa: F401
    import threadpoolctl

    with _lock:
        if not _solvers:
            _limit = threadpoolctl.threadpool_limits(1, user_api="blas")
        _solvers += 1
    try:
        yield
    finally:
        with _lock:
            _solvers -= 1
            if not _solvers:
                _limit.restore_original_limits()
                _limit = None
