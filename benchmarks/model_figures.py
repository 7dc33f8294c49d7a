"""What `accuracy.json` has of each model besides its errors: coefficients, promise and speed."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Sequence

import numpy as np

from dehyst._types import Array
from dehyst.identification import prepare
from dehyst.model import AbstractModel, Actuator, Motion, Validity, timed
from dehyst.model.promise import promise
from dehyst.records import Record, percent
from dehyst.trust.comparison import RecordScore

SAMPLES_TO_TIME, RUNS_TO_TIME = 20_000, 5


def promised(
    model: AbstractModel, trained: RecordScore, training: Sequence[Record], held_out: Sequence[Record], stroke: float
) -> tuple[float, float]:
    """Return the promised largest and RMS error [% of the stroke] on the held-out records, by one rule.

    For an actuator of this package the promise comes from its identification; for any other model from its training
    errors.
    """
    known = getattr(getattr(model, "actuator", model), "identification", None)
    validity = None if known is None else known.validity
    if validity is None:
        validity = Validity.by_records(
            [(record.time, record.voltage) for record in training],
            rms=trained.rms / 100 * stroke,
            largest=trained.largest / 100 * stroke,
            disagreement=0.0,
            stroke=stroke,
        )
    found = [promise(validity, own.voltage, own.time) for own in (prepare(record).record for record in held_out)]
    return percent(max(error.largest for error in found), stroke), percent(max(error.rms for error in found), stroke)


def parameters_of(model: AbstractModel) -> int | None:
    """Return the number of coefficients of a model: its `parameters`, or the elements and knots of an actuator."""
    inner = getattr(model, "actuator", model)
    if not isinstance(inner, Actuator):
        return getattr(inner, "parameters", None)
    tables = [inner.slip.stiffness, inner.spring.voltage]
    tables += [] if inner.smooth is None else [inner.smooth.stiffness]
    rest = 0 if inner.transformer is None else inner.transformer.drive.size - 2
    rest += 0 if inner.dynamics is None else 3
    return sum(table.size for table in tables) + rest + bool(inner.lag)


def speeds(model: AbstractModel, record: Record) -> tuple[float, float]:
    """Return nanoseconds per sample of simulation and compensation: the best of five runs over a repeated record."""
    record = prepare(record).record
    long = np.resize(record.voltage, max(len(record), SAMPLES_TO_TIME))
    options = timed(model, record.sample_time * np.arange(long.size, dtype=np.float64))
    path = model.simulate(long, **options).displacement

    def nanoseconds(run: Callable[..., Motion], drive: Array) -> float:
        return 1e9 / drive.size * min(timeit.repeat(lambda: run(drive, **options), number=1, repeat=RUNS_TO_TIME))

    return nanoseconds(model.simulate, long), nanoseconds(model.compensate, path)
