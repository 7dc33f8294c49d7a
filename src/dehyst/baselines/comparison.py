"""Comparison of all models on the same records and virtual actuators: one row of figures for each model."""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError, ModelError, PluginError
from dehyst._plugins import Registry, plugin_errors
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._validation import choice
from dehyst._views.fields import json_value, json_values
from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.linear import Linear
from dehyst.baselines.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
)
from dehyst.baselines.preisach import Preisach
from dehyst.baselines.tracking_trials import TRIALS, TrackingErrors, TrackingTrial
from dehyst.identification import Prepared, as_list, epochs, identify, prepare, state_after, without_offset
from dehyst.model import AbstractModel, Actuator, Motion, Validity, promise, simulated, timed
from dehyst.records import Record, largest, percent, rms

Identification: TypeAlias = Callable[[Sequence[Record]], AbstractModel]

OURS = "dehyst"
_PAPERS = f"{OURS}, paper's"


def _of_plugin(name: str, fit: Identification) -> Identification:
    if not callable(fit):
        raise TypeError(f"got a {type(fit).__name__}, need a function of a list of records that returns a model")
    if name.casefold() in map(str.casefold, (OURS, _PAPERS, *_OWN)):
        raise ValueError("the name is of a model of dehyst; its author must choose another")

    def fitted(records: Sequence[Record]) -> AbstractModel:
        with plugin_errors(name):
            return fit(records)

    return fitted


# Each a function of training records that returns the model, or raises an error that states why there is none.
_OWN: Mapping[str, Identification] = {
    "Goldfarb-Celanovic": lambda records: GoldfarbCelanovic.fit(records[0]),
    "Prandtl-Ishlinskii": PrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, modified": ModifiedPrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, generalised": GeneralizedPrandtlIshlinskii.fit,
    "Krasnoselskii-Pokrovskii": KrasnoselskiiPokrovskii.fit,
    "Preisach": Preisach.fit,
    "Preisach, reversal curves": Preisach.from_reversal_curves,
    "Bouc-Wen": BoucWen.fit,
    "Duhem": Duhem.fit,
    "linear ratio": Linear.fit,
}
BASELINES: Registry[Identification] = Registry("baselines", _OWN, _of_plugin)
_SAMPLES_TO_TIME, _RUNS_TO_TIME = 20_000, 5
# Errors of models and records and NumPy's LinAlgError are among them.
_FAILURES = (ValueError, ArithmeticError, RuntimeError, PluginError)


@dataclass(frozen=True)
class RecordScore:
    """Measured minus simulated displacement of one record, in % of the training stroke.

    `role`: "training" or "validation". `samples`, `left_out`: samples that count, and samples that do not, because they
    are before the voltage has been through its range or in the lead-in. `largest`, `rms`: errors with one free constant
    for the record, because its residual strain and its sensor's zero are not known. `largest_without`, `rms_without`:
    errors without this constant, on the model's own axis, or after a lead-in on the axis found from it.
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

    `failure`: a sentence on why the model or a figure is missing; empty if nothing is missing. `parameters`: number
    of coefficients. `seconds`: time that the fit took. `scores`: one for each record, training first. `tracking`:
    errors by virtual actuator; the model was fitted to that actuator's own records. `simulate`, `compensate`:
    nanoseconds per sample. `promised`: expected largest and RMS error on the held-out records [%].
    """

    name: str
    failure: str = ""
    parameters: int | None = None
    seconds: float | None = None
    scores: tuple[RecordScore, ...] = ()
    tracking: Mapping[str, TrackingErrors] = field(default_factory=dict)
    simulate: float | None = None
    compensate: float | None = None
    promised: tuple[float, float] | None = None

    def worst(self, role: str) -> RecordScore | None:
        """Return the score with the largest error among the records of a role."""
        return max((score for score in self.scores if score.role == role), key=lambda s: s.largest, default=None)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "parameters fit_s=seconds errors=scores promised_percent=promised tracking simulate_ns=simulate"
        keys += " compensate_ns=compensate"
        return {"model": self.name, "said": self.failure or None, **json_values(self, keys)}


@dataclass(frozen=True)
class ModelComparison:
    """Comparison table: `rows` has one entry for each model.

    `stroke` [m]: reference of the percentages. `records`, `held_out`, `truths`: names of the training records, of the
    held-out records and of the virtual actuators. `lead`: lead-in of the held-out records [s].
    """

    rows: tuple[ModelScore, ...]
    stroke: float
    records: tuple[str, ...]
    held_out: tuple[str, ...]
    truths: tuple[str, ...]
    lead: float = 0.0

    @property
    def note(self) -> str:
        """A sentence on the data besides the voltage that models used of held-out records; empty if none."""
        if not (self.lead and self.held_out):
            return ""
        return (
            f"The first {self.lead:g} s of held-out records do not count. From the displacement measured there, the "
            "models of dehyst take their state and an offset of the voltage, every other model takes a constant: its "
            "mean error there."
        )

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        keys = "stroke_m=stroke training=records validation=held_out truths lead_s=lead"
        return {**json_values(self, keys), "note": self.note or None, "models": json_value(self.rows)}


def contenders() -> dict[str, Identification]:
    """Return all models by name as functions: dehyst's selected structure and "maxwell_slip", then the baselines."""
    return {
        OURS: lambda records: identify(records, structure="auto").actuator,
        _PAPERS: lambda records: identify(records, structure="maxwell_slip").actuator,
        **BASELINES,
    }


@one_thread()
def compare(
    records: Record | Sequence[Record] = (),
    *,
    validate: Record | Sequence[Record] = (),
    truths: Sequence[str] = (),
    lead: float = 0.0,
    models: Mapping[str, Identification] | None = None,
    progress: Progress | None = None,
) -> ModelComparison:
    """Fit every model to the same training records and score it on the same held-out records.

    A model is simulated with the voltage of a record, delayed by the model's own delay, from the record's first sample
    and the model's own start. Samples count once the voltage has been through all of the record's range: from then on
    an unknown initial state adds a constant only.

    Parameters
    ----------
    records : Record or sequence of Record, optional
        Training records; default: records of the first virtual actuator, with its held-out ones.
    validate : Record or sequence of Record, optional
        Held-out records.
    truths : sequence of str, optional
        Virtual actuators ("play", "creep", "preisach", "boucwen") to track on: models are fitted to records of each.
    lead : float, optional
        Lead-in [s]: the start of held-out records that is simulated but does not count. Use it if a held-out record
        continues a known one. From the displacement measured in the lead-in, an actuator of this package takes its
        state and a voltage offset; any other model takes a constant, its mean error there.
    models : Mapping, optional
        Name -> function of the training records; default: `contenders()`.
    progress : callable, optional
        Called with a short description of each step.

    Returns
    -------
    ModelComparison
        A model that fails has a row with the reason.

    Raises
    ------
    RecordError, ModelError
        If a record cannot be used at all; if there is no such virtual actuator.
    IdentifyError
        If there is neither a record nor a virtual actuator, or the lead-in is impossible.
    """
    for name in truths:
        choice(name, "truths", TRIALS, error=ModelError)
    trials = [TRIALS[name] for name in truths]
    if not isinstance(lead, Real) or not 0 <= float(lead) < np.inf:
        raise IdentifyError(argument="lead", got=repr(lead), need="seconds, 0 or more")
    given, held_out = as_list(records), as_list(validate)
    if not given and not trials:
        raise IdentifyError("got neither records nor a virtual actuator; give at least one of them")
    if not given and held_out:
        raise IdentifyError("got held-out records but no training records; give these too")
    training = given or list(trials[0].records())
    held_out = held_out if given else list(trials[0].held_out())
    played = [_Played(prepare(record), "training", 0.0) for record in training]
    stroke = max(high - low for low, high in (one.item.span() for one in played))
    for record in held_out:
        played.append(_Played(prepare(record), "validation", float(lead)))
        if not played[-1].counted():
            raise IdentifyError(
                f"{record.name}: no sample counts after {lead:g} s; need samples after the voltage has been through "
                "its range. Give a longer record or a shorter lead-in"
            )
    # The same list, so that one fit serves both.
    trial_records = [(item, list(item.records()) if given or i else training) for i, item in enumerate(trials)]
    chosen = contenders() if models is None else models
    report = progress or (lambda _: None)
    rows = tuple(_row(name, fit, training, played, stroke, trial_records, report) for name, fit in chosen.items())
    names = (tuple(one.name for one in group) for group in (training, held_out, trials))
    return ModelComparison(rows, stroke, *names, float(lead))


class _Played(NamedTuple):
    """A prepared record, and the seconds at its start that do not count."""

    item: Prepared
    role: str
    lead: float

    def score(self, model: AbstractModel, stroke: float) -> RecordScore:
        """Return the errors of a model [% of the stroke]."""
        item, delay = self.item, float(getattr(model, "delay", 0.0))
        residuals = [
            _residual(model, piece, kept, item.noise, stroke if self.lead else None)
            for piece, kept in self.counted(delay)
        ]
        error = np.concatenate([np.zeros(0), *residuals])
        if not error.size:
            raise IdentifyError(f"{item.name}: no sample counts with the model's delay of {delay:.3g} s")
        if not np.isfinite(error).all():
            raise IdentifyError(f"{item.name}: the simulation diverges")
        free = error - error.mean()
        figures = (percent(figure(e), stroke) for e in (free, error) for figure in (largest, rms))
        return RecordScore(item.name, self.role, error.size, item.samples - error.size, *figures)

    def counted(self, delay: float = 0.0) -> list[tuple[Record, NDArray[np.bool_]]]:
        """Return pieces with their voltage delayed, and which of their samples count."""
        counted = []
        for _, piece, _ in self.item.delayed(0, delay):
            kept = np.zeros(len(piece), dtype=bool)
            for epoch in epochs(piece, self.item.noise)[-1:]:
                kept[epoch.start : epoch.stop] = True
            kept &= piece.time >= self.item.start + self.lead
            if kept.any():
                counted.append((piece, kept))
        return counted


def _residual(
    model: AbstractModel, piece: Record, kept: NDArray[np.bool_], noise: float, stroke: float | None
) -> Array:
    """Return measured minus simulated displacement of the samples that count, simulated from the first sample.

    If `stroke` [m] is given, there is a lead-in, and the residual is on the axis found from the samples in it.
    """
    before = 0 if stroke is None else int(np.argmax(kept))
    if before and isinstance(model, Actuator):
        state, offset = state_after(replace(model, delay=0.0), piece.slice(0, before + 1), stroke)
        rest = piece.slice(before, len(piece))
        voltage = without_offset(model, rest.voltage, offset)
        motion = model.simulate(voltage, state=state, **timed(model, rest.time))
        return np.asarray((rest.displacement - motion.displacement)[kept[before:]])
    error = piece.displacement - simulated(model, piece.voltage, piece.time).displacement
    if not before:
        return np.asarray(error[kept])
    # As `state_after` does: over the samples that count, or from the last one.
    last = epochs(piece.slice(0, before + 1), noise)[-1:]
    return np.asarray(error[kept] - error[last[0].start if last else before : before + 1].mean())


def _row(
    name: str,
    fit: Identification,
    training: list[Record],
    played: list[_Played],
    stroke: float,
    trials: list[tuple[TrackingTrial, list[Record]]],
    progress: Progress,
) -> ModelScore:
    """Fit one model and compute all its figures; report a failure as a sentence."""
    progress(f"fitting {name}")
    fitted: dict[int, AbstractModel] = {}
    row, tracking, failures = ModelScore(name), dict[str, TrackingErrors](), list[str]()
    begin = time.perf_counter()
    # Models of others may fail in any way.
    failing = _FAILURES if name in (OURS, _PAPERS, *_OWN) else Exception
    try:
        model = fitted[id(training)] = _fitted(fit, training)
        row = replace(row, seconds=time.perf_counter() - begin, parameters=parameters_of(model))
        progress(f"simulating {name}")
        simulate, compensate = speeds(model, played[0].item.record)
        scores = tuple(one.score(model, stroke) for one in played)
        row = replace(row, scores=scores, simulate=simulate, compensate=compensate)
        row = replace(row, promised=_promised(model, row.worst("training"), training, played, stroke))
    except failing as error:
        failures.append(_reason(error))
    for item, records in trials:
        if records is training and not fitted:
            continue
        progress(f"tracking with {name} on {item.name}")
        try:
            tracking[item.name] = item.track(fitted.get(id(records)) or _fitted(fit, records))
        except failing as error:
            failures.append(f"{item.name}: {_reason(error)}")
    return replace(row, tracking=tracking, failure=" ".join(failures))


def _fitted(fit: Identification, records: list[Record]) -> AbstractModel:
    """Return the model of a copy of the list of records, which a function of others may change."""
    model = fit(list(records))
    if not all(callable(getattr(model, name, None)) for name in ("simulate", "compensate")):
        raise PluginError(f"its fit returned a {type(model).__name__}, need a model with simulate and compensate")
    return model


def _reason(error: Exception) -> str:
    """Return the words of an error, with its type for one of foreign code."""
    words = str(error)
    return words if words and isinstance(error, _FAILURES) else f"{type(error).__name__}: {words}".removesuffix(": ")


def _promised(
    model: AbstractModel, trained: RecordScore | None, training: list[Record], played: list[_Played], stroke: float
) -> tuple[float, float] | None:
    """Return the promised largest and RMS error [% of the stroke] on the held-out records, by one rule.

    For an actuator of this package the promise comes from its identification; for any other model from its training
    errors.
    """
    held_out = [one.item.record for one in played if one.role == "validation"]
    if not held_out or trained is None:
        return None
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
    found = [promise(validity, record.voltage, record.time) for record in held_out]
    return percent(max(one.largest for one in found), stroke), percent(max(one.rms for one in found), stroke)


def parameters_of(model: AbstractModel) -> int | None:
    """Return the number of coefficients of a model: its `parameters`, or the elements and knots of an actuator."""
    inner = getattr(model, "actuator", model)
    if not isinstance(inner, Actuator):
        return getattr(inner, "parameters", None)
    tables = [inner.slip.stiffness, inner.spring.voltage]
    tables += [part.stiffness for part in (inner.creep, inner.smooth) if part is not None]
    rest = 0 if inner.transformer is None else inner.transformer.drive.size - 2
    rest += 0 if inner.dynamics is None else 3
    return sum(table.size for table in tables) + rest + bool(inner.lag)


def speeds(model: AbstractModel, record: Record) -> tuple[float, float]:
    """Return nanoseconds per sample of simulation and compensation: the best of five runs over a repeated record."""
    long = np.resize(record.voltage, max(len(record), _SAMPLES_TO_TIME))
    options = timed(model, record.sample_time * np.arange(long.size, dtype=np.float64))
    path = model.simulate(long, **options).displacement

    def nanoseconds(run: Callable[..., Motion], drive: Array) -> float:
        return 1e9 / drive.size * min(timeit.repeat(lambda: run(drive, **options), number=1, repeat=_RUNS_TO_TIME))

    return nanoseconds(model.simulate, long), nanoseconds(model.compensate, path)
