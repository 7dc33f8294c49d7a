"""Comparison of models on the same records: each is fitted to one part and judged on the held-out part."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from dehyst._errors import IdentifyError, RecordError
from dehyst._threads import one_thread
from dehyst._types import Array, Mask, Progress
from dehyst._views.fields import json_value, json_values
from dehyst.identification import Prepared, distinct, epochs, filled, identify, prepare, state_after, without_offset
from dehyst.model import AbstractModel, Actuator, simulated, timed
from dehyst.records import Record, counting, largest, percent, rms, thinned
from dehyst.trust.baselines import Linear, TwoBranches

# A function of training records that returns the model, or raises an error that states why there is none.
Identification: TypeAlias = Callable[[Sequence[Record]], AbstractModel]
OURS, _LINE = "dehyst", "linear ratio"
# The command that installs published models.
RIVALS = "pip install dehyst-rivals (from a clone: pip install ./packages/rivals)"
# The group of entry points of installed packages whose functions are an `Identification`.
_GROUP = "dehyst.baselines"
# Errors of models and records and NumPy's LinAlgError are among them.
_FAILURES = (ValueError, ArithmeticError, RuntimeError)
# The first part of each record is fitted, the rest is held out, if no record is given to judge by.
_TRAINING_PART = 0.75


@dataclass(frozen=True)
class RecordScore:
    """Measured minus simulated displacement of one record, in % of the training stroke.

    `role`: "training" or "validation". `samples`, `left_out`: samples that count, and samples that do not: those before
    the voltage has been through its range, or before the held-out part. `largest`, `rms`: errors with one free constant
    for the record, because its residual strain and its sensor's zero are not known. `largest_without`, `rms_without`:
    errors without this constant, on the model's own axis, or, for the last part of a record, on the axis found from the
    samples before it.
    """

    record: str
    role: str
    samples: int
    left_out: int
    largest: float
    rms: float
    largest_without: float
    rms_without: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        named = "largest_percent=largest rms_percent=rms"
        without = "largest_without_constant_percent=largest_without rms_without_constant_percent=rms_without"
        return json_values(self, f"record role samples left_out {named} {without}")


@dataclass(frozen=True)
class ModelScore:
    """Scores of one model.

    `failure`: a sentence on why the model or its scores are missing; empty if nothing is missing. `seconds`: time that
    the fit took. `scores`: one for each record, training first.
    """

    name: str
    failure: str = ""
    seconds: float | None = None
    scores: tuple[RecordScore, ...] = ()

    def worst(self, role: str) -> RecordScore | None:
        """Return the score with the largest error among the records of a role."""
        return max((score for score in self.scores if score.role == role), key=lambda s: s.largest, default=None)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return {"model": self.name, "said": self.failure or None, **json_values(self, "fit_s=seconds errors=scores")}


class Best(NamedTuple):
    """The model with the least RMS error on held-out samples, the next one, and a line; errors in % of the stroke."""

    model: str
    rms: float
    next: str
    next_rms: float
    line_rms: float | None = None

    @property
    def factor(self) -> float:
        """By how much the error of the next one is larger."""
        return self.next_rms / self.rms if self.rms else np.inf

    def __str__(self) -> str:
        line = "" if self.line_rms is None or _LINE in self[::2] else f"; a straight line has {self.line_rms:.2g} %"
        return (
            f"{self.model} is best on held-out samples: {self.rms:.2g} % of the stroke RMS; next is {self.next} with "
            f"{self.next_rms:.2g} %, {self.factor:.3g} times as much{line}."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "model rms_percent=rms next next_rms_percent=next_rms factor line_rms_percent=line_rms"
        return {**json_values(self, keys), "sentence": str(self)}


@dataclass(frozen=True)
class ModelComparison:
    """Comparison table: `rows` has one entry for each model.

    `stroke` [m]: reference of the percentages. `records`, `held_out`: names of the training records and of the held-out
    ones. `apart`: whether these are the last parts of the training records.
    """

    rows: tuple[ModelScore, ...]
    stroke: float
    records: tuple[str, ...]
    held_out: tuple[str, ...]
    apart: bool = False

    @property
    def best(self) -> Best | None:
        """The best model by its RMS error on held-out samples; None with fewer than two models that have one."""
        judged = {row.name: score.rms for row in self.rows if (score := row.worst("validation")) is not None}
        name, runner_up = [*sorted(judged, key=judged.__getitem__), "", ""][:2]
        return Best(name, judged[name], runner_up, judged[runner_up], judged.get(_LINE)) if runner_up else None

    @property
    def note(self) -> str:
        """A sentence on the held-out samples."""
        if not self.apart:
            return f"Held out: {', '.join(self.held_out)}."
        return (
            f"Held out: the last quarter of {', '.join(self.held_out)}; each model was fitted to the rest. From the "
            "displacement before that part, dehyst's model takes its state and an offset of the voltage, every other "
            "model a constant."
        )

    @property
    def hint(self) -> str:
        """A sentence on how to get more models to compare with; empty if a package adds some."""
        return "" if _added() else f"Nine published models can be added: {RIVALS}."

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        texts = {"note": self.note, "hint": self.hint or None}
        keys = "stroke_m=stroke training=records validation=held_out held_out_by_itself=apart best"
        return {**json_values(self, keys), **texts, "models": json_value(self.rows)}


def contenders() -> dict[str, Identification]:
    """Return all models by name as functions: dehyst's, a table and a line, those of installed packages."""
    ours = {OURS: lambda records: identify(records, structure="auto").actuator}
    own: dict[str, Identification] = {**ours, "two branches": TwoBranches.fit, _LINE: Linear.fit}
    return own | _added() | own


def _added() -> dict[str, Identification]:
    """Return the models of installed packages; each is imported when it is fitted."""
    from importlib.metadata import entry_points

    points = entry_points(group=_GROUP)
    return {point.name: partial(lambda point, records: point.load()(records), point) for point in points}


@one_thread()
def compare(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    models: Mapping[str, Identification] | None = None,
    progress: Progress | None = None,
) -> ModelComparison:
    """Fit every model to the same training records and score it on the same held-out records.

    A model is simulated with the voltage of a record, delayed by the model's own delay, from the record's first sample
    and the model's own start. Samples count once the voltage has been through all of the record's range: from then on
    an unknown initial state adds a constant only.

    Parameters
    ----------
    records : Record or sequence of Record
        Records of loops.
    validate : Record or sequence of Record, optional
        Held-out records. By default, the last quarter of each record is held out if its first three quarters can be
        fitted, and the models are fitted to the rest.
    models : Mapping, optional
        Name -> function of the training records; default: dehyst's model, a table of two branches, a straight line,
        and the models of installed packages.
    progress : callable, optional
        Called with a short description of each step.

    Returns
    -------
    ModelComparison
        A model that fails has a row with the reason.

    Raises
    ------
    RecordError
        If a record cannot be used at all.
    IdentifyError
        If there is no record, one is given twice, or no part of a record can be held out.
    """
    training, given = ([*map(thinned, some)] for some in distinct(records, validate))
    held_out = [Played(prepare(filled(record))) for record in given]
    if not given:
        training, held_out = _kept_apart(training)
    fits, report = contenders() if models is None else models, progress or (lambda _: None)
    rows, stroke = scored(training, held_out, fits, report)
    judged = tuple(part.item.name for part in held_out)
    return ModelComparison(rows, stroke, tuple(record.name for record in training), judged, apart=not given)


def scored(
    training: list[Record], held_out: list[Played], fits: Mapping[str, Identification], progress: Progress
) -> tuple[tuple[ModelScore, ...], float]:
    """Fit and score every model; return a row for each, and the training stroke [m]; errors as `compare`."""
    # Some models are fitted to all samples, also between events.
    training = [*map(filled, training)]
    played = [*(Played(prepare(record), "training") for record in training), *held_out]
    stroke = max(high - low for low, high in (part.item.span() for part in played[: len(training)]))
    for part in held_out:
        if not part.counted():
            need = "need samples after the voltage has been through its range"
            raise IdentifyError(f"{part.item.name}: no sample counts; {need}. Give a longer record")
    return tuple(_row(name, fit, training, played, stroke, progress) for name, fit in fits.items()), stroke


def _kept_apart(records: list[Record]) -> tuple[list[Record], list[Played]]:
    """Return records without their last quarters, and the last quarters; a record too short for that stays whole."""
    training, held_out = [], list[Played]()
    for record in records:
        lead = _TRAINING_PART * float(record.time[-1] - record.time[0])
        whole = Played(prepare(filled(record)), lead=lead)
        usable = bool(whole.counted())
        try:
            first = record[: int(np.searchsorted(record.time, record.time[0] + lead, side="right"))]
            prepare(first).span()
        except (IdentifyError, RecordError):
            usable = False
        training.append(first if usable else record)
        held_out += [whole] if usable else []
    if not held_out:
        words = "no record is long enough to hold out its last quarter: the first three quarters need a full cycle"
        hint = "record more cycles, or give other records to judge by"
        raise IdentifyError(words, hint=hint, change=("validate",))
    return training, held_out


class Played(NamedTuple):
    """A prepared record, and the seconds at its start [s] that are simulated but do not count.

    From the displacement in these seconds, an actuator of this package takes its state and a voltage offset; any other
    model takes a constant, its mean error there.
    """

    item: Prepared
    role: str = "validation"
    lead: float = 0.0

    def score(self, model: AbstractModel, stroke: float) -> RecordScore:
        """Return the errors of a model [% of the stroke]."""
        item, delay = self.item, float(getattr(model, "delay", 0.0))
        counted = self.counted(delay)
        residuals = [_residual(model, *own, item.noise, lead=self.lead > 0) for own in counted]
        error = np.concatenate([np.zeros(0), *residuals])
        if not error.size:
            raise IdentifyError(f"{item.name}: no sample counts with the model's delay of {delay:.3g} s")
        if not np.isfinite(error).all():
            raise IdentifyError(f"{item.name}: the simulation diverges")
        free = error - error.mean()
        figures = (percent(figure(e), stroke) for e in (free, error) for figure in (largest, rms))
        return RecordScore(item.name, self.role, error.size, item.samples - error.size, *figures)

    def counted(self, delay: float = 0.0) -> list[tuple[Record, Mask]]:
        """Return pieces with their voltage delayed, and which of their samples count."""
        counted = []
        for piece in self.item.acting(delay):
            kept = np.zeros(len(piece), dtype=bool)
            for epoch in epochs(piece, self.item.noise)[-1:]:
                kept[epoch.start : epoch.stop] = True
            kept &= piece.time >= self.item.start + self.lead
            if (own := counting(piece)) is not None:
                kept &= own
            if kept.any():
                counted.append((piece, kept))
        return counted


def _residual(model: AbstractModel, piece: Record, kept: Mask, noise: float, *, lead: bool) -> Array:
    """Return measured minus simulated displacement of the samples that count, simulated from the first sample.

    With a `lead`, the residual is on the axis found from the samples before those that count.
    """
    before = int(np.argmax(kept)) if lead else 0
    if before and isinstance(model, Actuator):
        state, offset = state_after(replace(model, delay=0.0), piece[: before + 1])
        rest = piece[before:]
        voltage = without_offset(model, rest.voltage, offset)
        motion = model.simulate(voltage, state=state, **timed(model, rest.time))
        return np.asarray((rest.displacement - motion.displacement)[kept[before:]])
    error = piece.displacement - simulated(model, piece.voltage, piece.time).displacement
    if not before:
        return np.asarray(error[kept])
    # The constant is computed as in `state_after`: from the used samples, or from the last one.
    last = epochs(piece[: before + 1], noise)[-1:]
    return np.asarray(error[kept] - error[last[0].start if last else before : before + 1].mean())


def _row(
    name: str, fit: Identification, training: list[Record], played: list[Played], stroke: float, progress: Progress
) -> ModelScore:
    """Fit one model and score it; report a failure as a sentence."""
    progress(f"fitting {name}")
    row, begin = ModelScore(name), time.perf_counter()
    try:
        model = fit(list(training))  # A copy, because a foreign function may change it.
        if not all(callable(getattr(model, name, None)) for name in ("simulate", "compensate")):
            raise TypeError(f"its fit returned a {type(model).__name__}, need a model with simulate and compensate")
        row = replace(row, seconds=time.perf_counter() - begin)
        progress(f"simulating {name}")
        return replace(row, scores=tuple(record.score(model, stroke) for record in played))
    except Exception as error:
        # A foreign model may fail in any way: an error of foreign code is stated with its type.
        words, kind = str(error), type(error).__name__
        known = bool(words) and isinstance(error, _FAILURES)
        return replace(row, failure=words if known else f"{kind}: {words}".removesuffix(": "))
