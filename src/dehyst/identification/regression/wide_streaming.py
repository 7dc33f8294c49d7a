"""The wider regression of records of any length: its rows are made again for each pass, and never exist all at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from dehyst._types import Array
from dehyst.identification.regression.streaming import AbstractStream
from dehyst.identification.regression.wide_regression import WideCoefficients, WideRegression
from dehyst.identification.solvers.program import Norm, solve_blocks


@final
@dataclass(frozen=True, eq=False)
class WideStream(AbstractStream[WideCoefficients]):
    """All rows of a wider regression; the gap of a fit is that of all rows."""

    regression: WideRegression

    def _fit(self, norm: Norm, before: WideCoefficients | None) -> WideCoefficients:
        epochs, some = np.arange(self.source.count), self.regression
        like = some.nuisances(epochs), some.bounded, some.target
        table = _Columns(self, before, norm)
        return some.fitted(lambda limits: solve_blocks(table, like, norm=norm, constraints=limits), epochs)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The program's columns; rows weighted by the inverse slope of a model, if there is one."""

    stream: WideStream
    model: WideCoefficients | None
    norm: Norm

    def __len__(self) -> int:
        return len(self.stream.source) + len(self._alike[3])

    @cached_property
    def _alike(self) -> tuple[Array, Array, Array, Array]:
        some, source = self.stream.regression, self.stream.source
        weight = 1.0 if self.model is None else some.floor / some.mean_slope
        return some.held_alike(self.norm, len(source), source.count + len(some.drifting), weight)

    def __iter__(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        some, epochs = self.stream.regression, np.arange(self.stream.source.count)
        lasting = np.asarray(some.start_columns.any(axis=0))
        for rows in self.stream.source.blocks():
            block = replace(some, rows=rows, lasting=lasting)
            weights = np.ones(len(rows)) if self.model is None else block.floor / block.slope(self.model)
            yield block.nuisances(epochs), block.bounded, block.target, weights
        if len(self._alike[3]):
            yield self._alike
