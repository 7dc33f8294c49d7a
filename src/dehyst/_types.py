"""Types that many modules use."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
# Called with a short message at each step of a long computation.
Progress: TypeAlias = Callable[[str], None]
