"""The only interface to pandas: columns as its tables."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import library

if TYPE_CHECKING:
    from pandas import DataFrame


def frame(columns: Mapping[str, Any], **attributes: Any) -> DataFrame:
    """Return columns as a DataFrame with given attributes (`DataFrame.attrs`); arrays are copied.

    Raise `MissingExtraError` if pandas is not installed.
    """
    pandas = library("pandas", "A DataFrame", "files")
    made = pandas.DataFrame({name: np.array(values) for name, values in columns.items()})
    made.attrs.update(attributes)
    return made
