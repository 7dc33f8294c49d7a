"""The regression of records of any length: its rows are made again for each pass, and never exist all at once."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.coefficients import Coefficients
from dehyst.identification.regression.regression import Regression
from dehyst.identification.solvers.program import Norm, solve_blocks


@dataclass(frozen=True, eq=False)
class Stream:
    """All rows of a regression; the gap of a fit is that of all rows.

    Attributes
    ----------
    source : RowSource
    regression : Regression
        On some of the rows: everything but the rows counts, and they give the scales.
    """

    source: RowSource
    regression: Regression

    @property
    def whole(self) -> bool:
        """Whether the regression has all rows already."""
        return len(self.regression.rows) == len(self.source)

    def fit_weighted(self, norm: Norm) -> Coefficients:
        """Fit all rows as the regression's `fit_weighted` fits some."""
        if self.whole:
            return self.regression.fit_weighted(norm)
        return self._fit(norm, self._fit("l2", None))

    def _fit(self, norm: Norm, before: Coefficients | None) -> Coefficients:
        """Fit with the weights of a model found before."""
        epochs = np.arange(self.source.count)
        table, like = _Columns(self, before, norm), self.regression.table(epochs)
        return self.regression.solved_with(
            lambda limits: solve_blocks(table, like, norm=norm, constraints=limits), epochs
        )

    def fit_nuisances(self, model: Coefficients) -> Coefficients:
        """Fit the constants and drifts of all rows for a given model without starts of creep."""
        if self.whole:
            return self.regression.fit_nuisances(model)
        epochs = np.arange(self.source.count)
        free, bounded, _ = self.regression.table(epochs)
        like = free, bounded[:, :0], -self.regression.model(model)
        answer = solve_blocks(_Nuisances(self, model), like, norm="l2")
        return self.regression.with_nuisances(model, answer, epochs)

    def blocks(self) -> Iterator[Regression]:
        """Yield the regression on block after block."""
        lasting = np.asarray(self.regression.start_columns.any(axis=0))
        for rows in self.source.blocks():
            yield replace(self.regression, rows=rows, lasting=lasting)

    def weights(self, block: Regression, model: Coefficients | None) -> Array:
        """Return inverse slopes of a model at the rows of a block, of the order of one."""
        if model is None:
            return np.ones(len(block.rows))
        return np.asarray(float(model.slopes.min()) / block.slope(model))


@dataclass(frozen=True, eq=False)
class _Columns:
    """The program's columns; rows weighted by the inverse slope of a model, if there is one."""

    stream: Stream
    model: Coefficients | None
    norm: Norm

    def __len__(self) -> int:
        return len(self.stream.source) + len(self._regularization[3])

    @cached_property
    def _regularization(self) -> tuple[Array, Array, Array, Array]:
        some, source = self.stream.regression, self.stream.source
        weight = 1.0 if self.model is None else float(self.model.slopes.min()) / some.mean_slope
        return some.regularization(self.norm, len(source), source.count + len(some.drifting), weight)

    def __iter__(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        epochs = np.arange(self.stream.source.count)
        for block in self.stream.blocks():
            yield *block.table(epochs), self.stream.weights(block, self.model)
        if len(self._regularization[3]):
            yield self._regularization


@dataclass(frozen=True, eq=False)
class _Nuisances:
    """The columns of constants and drifts alone, for a model that is given."""

    stream: Stream
    model: Coefficients

    def __len__(self) -> int:
        return len(self.stream.source)

    def __iter__(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        epochs = np.arange(self.stream.source.count)
        for block in self.stream.blocks():
            free, bounded, _ = block.table(epochs)
            yield free, bounded[:, :0], -block.model(self.model), self.stream.weights(block, self.model)
