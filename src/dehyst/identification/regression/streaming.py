"""The regression of records of any length: its rows are made again for each pass, and never exist all at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Generic, final

import numpy as np

from dehyst._types import Array
from dehyst.identification.preprocessing.regressors import RowSource
from dehyst.identification.regression.regression import AbstractRegression, Coefficients, Found, Regression
from dehyst.identification.solvers.program import Norm, solve_blocks


@dataclass(frozen=True, eq=False)
class AbstractStream(ABC, Generic[Found]):
    """All rows of a regression, whatever the class of the model.

    Attributes
    ----------
    source : RowSource
    regression : AbstractRegression
        On some of the rows: everything but the rows counts, and they give the scales.
    """

    source: RowSource
    regression: AbstractRegression[Found]

    @property
    def whole(self) -> bool:
        """Whether the regression has all rows already."""
        return len(self.regression.rows) == len(self.source)

    def fit_weighted(self, norm: Norm) -> Found:
        """As the regression's `fit_weighted`, of all rows."""
        if self.whole:
            return self.regression.fit_weighted(norm)
        return self._fit(norm, self._fit("l2", None))

    @abstractmethod
    def _fit(self, norm: Norm, before: Found | None) -> Found:
        """Fit with the weights that a model found before gives."""


@final
@dataclass(frozen=True, eq=False)
class Stream(AbstractStream[Coefficients]):
    """All rows of a plain regression."""

    regression: Regression

    def nuisances_of(self, model: Coefficients) -> Coefficients:
        """As `Regression.nuisances_of`."""
        if self.whole:
            return self.regression.nuisances_of(model)
        epochs = np.arange(self.source.count)
        answer = solve_blocks(_Nuisances(self, model), self._like(model), norm="l2")
        return self.regression.with_nuisances(model, answer, epochs)

    def blocks(self) -> Iterator[Regression]:
        """The regression on block after block."""
        for rows in self.source.blocks():
            yield replace(self.regression, rows=rows)

    def weights(self, block: Regression, model: Coefficients | None) -> Array:
        """Inverse slopes of a model at the rows of a block, of the order of one."""
        if model is None:
            return np.ones(len(block.rows))
        return np.asarray(float(model.slopes.min()) / block.slope(model))

    def _fit(self, norm: Norm, before: Coefficients | None) -> Coefficients:
        epochs = np.arange(self.source.count)
        answer = solve_blocks(_Columns(self, before), self.regression.table(epochs), norm=norm)
        return self.regression.coefficients(answer, epochs)

    def _like(self, model: Coefficients) -> tuple[Array, Array, Array]:
        free, bounded, _ = self.regression.table(np.arange(self.source.count))
        return free, bounded[:, :0], self.regression.rest(model)


@dataclass(frozen=True, eq=False)
class _Columns:
    """The program's columns; rows weighted by the inverse slope of a model, if there is one."""

    stream: Stream
    model: Coefficients | None

    def __len__(self) -> int:
        return len(self.stream.source)

    def __iter__(self) -> Iterator[tuple[Array, Array, Array, Array]]:
        epochs = np.arange(self.stream.source.count)
        for block in self.stream.blocks():
            yield *block.table(epochs), self.stream.weights(block, self.model)


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
            yield free, bounded[:, :0], block.rest(self.model), self.stream.weights(block, self.model)
