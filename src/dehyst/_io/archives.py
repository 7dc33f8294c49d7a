"""NumPy archives (.npz): arrays by name, in memory until they are written as one file."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray


def packed(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """Return arrays as the content of an .npz file, in their order, not compressed."""
    content, named = io.BytesIO(), dict[str, Any](arrays)
    np.savez(content, **named)
    return content.getvalue()
