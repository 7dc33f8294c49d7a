"""A curve drawn with characters, for a terminal."""

from __future__ import annotations

from typing import Any

import numpy as np

_WIDTH, _HEIGHT = 60, 16


def text_plot(x: Any, y: Any, x_label: str, y_label: str) -> list[str]:
    """Return the lines of a plot of finite arrays (n,), with the ends of both ranges at its axes."""
    cells = np.full((_HEIGHT, _WIDTH), " ")
    cells[_HEIGHT - 1 - _places(y, _HEIGHT), _places(x, _WIDTH)] = "*"
    ends = [f"{value:.4g}" for value in (float(np.max(y)), float(np.min(y)))]
    margin = max(map(len, ends))
    marks = {0: ends[0], _HEIGHT - 1: ends[1]}
    rows = [f"{marks.get(k, ''):>{margin}} |{''.join(row)}".rstrip() for k, row in enumerate(cells)]
    low, high = f"{float(np.min(x)):.4g}", f"{float(np.max(x)):.4g}"
    below = f"{low}{x_label:^{_WIDTH - len(low) - len(high)}}{high}"
    return [f"{'':>{margin}}  {y_label}", *rows, f"{'':>{margin}} +{'-' * _WIDTH}", f"{'':>{margin}}  {below}"]


def _places(values: Any, count: int) -> Any:
    """Return the cell of each value, 0 to count - 1."""
    low, span = float(np.min(values)), float(np.ptp(values))
    if span == 0:
        return np.zeros(len(values), dtype=np.intp)
    return np.minimum(((np.asarray(values) - low) / span * count).astype(np.intp), count - 1)
