"""Ours and every rival on the same records: one split, one set of figures, a row for each."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dehyst._errors import IdentifyError
from dehyst._threads import one_thread
from dehyst._types import Array
from dehyst.baselines.registry import BASELINES, Identification
from dehyst.baselines.tracking_trials import TrackingErrors, TrackingTrial, trial
from dehyst.identification import identify
from dehyst.identification.preprocessing.preparation import Prepared, as_list, prepare
from dehyst.identification.preprocessing.regressors import epochs
from dehyst.identification.validation import state_after, without_offset
from dehyst.model import AbstractModel, Actuator, Motion, simulated
from dehyst.model.replay import timed
from dehyst.records import Record
from dehyst.records.metrics import largest, percent, rms

OURS = "dehyst"
_SAMPLES_TO_TIME = 20_000
_RUNS_TO_TIME = 5
# DehystError and NumPy's LinAlgError are among them.
_FAILURES = (ValueError, ArithmeticError, RuntimeError)


@dataclass(frozen=True)
class RecordScore:
    """Measured minus simulated displacement of one record, in % of the training stroke.

    Attributes
    ----------
    role : str
        "training" or "validation".
    samples, left_out : int
        Counted, and not: before the voltage has been through its range, or within the lead.
    largest, rms : float
        With one constant for the record free: its residual strain and its sensor's zero are not known.
    largest_without, rms_without : float
        Without it, on the model's own axis; after a lead, on the axis that the lead told.
    """

    record: str
    role: str
    samples: int
    left_out: int
    largest: float
    rms: float
    largest_without: float
    rms_without: float


@dataclass(frozen=True)
class ModelScore:
    """One model.

    Attributes
    ----------
    name : str
    said : str
        Why there is no model or no figure, as a sentence; empty if all went well.
    parameters : int or None
        Number of coefficients.
    seconds : float or None
        That the fit took.
    scores : tuple of RecordScore
        One a record, training first.
    tracking : Mapping
        By virtual actuator, each of whose models was fitted to its own records.
    simulate, compensate : float or None
        Nanoseconds a sample.
    """

    name: str
    said: str = ""
    parameters: int | None = None
    seconds: float | None = None
    scores: tuple[RecordScore, ...] = ()
    tracking: Mapping[str, TrackingErrors] = field(default_factory=dict)
    simulate: float | None = None
    compensate: float | None = None

    def worst(self, role: str) -> RecordScore | None:
        """The score of the record of that role with the largest error."""
        return max((score for score in self.scores if score.role == role), key=lambda s: s.largest, default=None)

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "model": self.name,
            "said": self.said or None,
            "parameters": self.parameters,
            "fit_s": self.seconds,
            "errors": [
                {
                    "record": s.record,
                    "role": s.role,
                    "samples": s.samples,
                    "left_out": s.left_out,
                    "largest_percent": s.largest,
                    "rms_percent": s.rms,
                    "largest_without_constant_percent": s.largest_without,
                    "rms_without_constant_percent": s.rms_without,
                }
                for s in self.scores
            ],
            "tracking": {
                truth: {"largest_percent": one.largest, "rms_percent": one.rms, "beyond_voltage_percent": one.beyond}
                for truth, one in self.tracking.items()
            },
            "simulate_ns": self.simulate,
            "compensate_ns": self.compensate,
        }


@dataclass(frozen=True)
class ModelComparison:
    """A table: one row for each model, the stroke [m] of its percentages, and the virtual actuators tracked on.

    The lead is that of the held-out records [s].
    """

    rows: tuple[ModelScore, ...]
    stroke: float
    records: tuple[str, ...]
    held_out: tuple[str, ...]
    truths: tuple[str, ...]
    lead: float = 0.0

    @property
    def note(self) -> str:
        """What models were told of held-out records, as a sentence; empty if nothing but the voltage."""
        if not (self.lead and self.held_out):
            return ""
        return (
            f"The displacement measured in the first {self.lead:g} s of held-out records, which do not count, told our "
            "own models their state and an offset of the voltage, every other model a constant, its mean error there."
        )

    def as_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "stroke_m": self.stroke,
            "training": list(self.records),
            "validation": list(self.held_out),
            "truths": list(self.truths),
            "lead_s": self.lead,
            "note": self.note or None,
            "models": [row.as_dict() for row in self.rows],
        }


def contenders() -> dict[str, Identification]:
    """Ours, of the structure that the records support and of the paper's, then every rival: name -> identification."""
    return {
        OURS: lambda records: identify(records, structure="auto").actuator,
        f"{OURS}, paper's": lambda records: identify(records, structure="paper").actuator,
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
    progress: Callable[[str], None] | None = None,
) -> ModelComparison:
    """Fit every model to the same records and hold it against the same others.

    A model is played the voltage of a record, delayed by its own delay, from the record's first sample and its own
    start. Samples count once the voltage has been through all of the record's range: what a model cannot know of its
    state adds a constant from then on.

    Parameters
    ----------
    records : Record or sequence of Record, optional
        Training records; default: those of the first virtual actuator, with its held-out ones.
    validate : Record or sequence of Record, optional
        Held-out records.
    truths : sequence of str, optional
        Virtual actuators ("play", "creep", "preisach", "boucwen") to track on: models are fitted to records of each.
    lead : float, optional
        Seconds at the start of held-out records that are played but not counted: give it where a held-out stretch goes
        on from one that is known. What was measured there tells an actuator of ours its state and an offset of the
        voltage, any other model a constant: its mean error there.
    models : Mapping, optional
        Name -> function of the training records; default: `contenders()`.
    progress : callable, optional
        Called with a few words at each step.

    Returns
    -------
    ModelComparison
        A model that fails has a row with its sentence.

    Raises
    ------
    RecordError
        If a record cannot be used at all.
    IdentifyError
        If there is neither a record nor a virtual actuator, or the lead is impossible.
    ModelError
        If there is no such virtual actuator.
    """
    trials = [trial(name) for name in truths]
    if not isinstance(lead, Real) or not 0 <= float(lead) < np.inf:
        raise IdentifyError(f"lead: got {lead!r}, need seconds, 0 or more")
    given = as_list(records)
    training, held_out = _records(given, as_list(validate), trials)
    job = _ComparisonRun(training, [prepare(one) for one in training], [prepare(one) for one in held_out], float(lead))
    # The same list, so that its fit serves for both.
    own = [(one, list(one.records()) if given or i else training) for i, one in enumerate(trials)]
    chosen = contenders() if models is None else models
    tell = progress or (lambda _: None)
    rows = tuple(_row(name, fit, job, own, tell) for name, fit in chosen.items())
    return ModelComparison(
        rows,
        job.stroke,
        tuple(one.name for one in training),
        tuple(one.name for one in held_out),
        tuple(one.name for one in trials),
        job.lead,
    )


def _records(
    training: list[Record], held_out: list[Record], trials: Sequence[TrackingTrial]
) -> tuple[list[Record], list[Record]]:
    """Records to train on and held out: those given, or those of the first virtual actuator."""
    if training:
        return training, held_out
    if not trials:
        raise IdentifyError("got neither records nor a virtual actuator; give one of them at least")
    if held_out:
        raise IdentifyError("got held-out records and none to train on; give these too")
    return list(trials[0].records()), list(trials[0].held_out())


@dataclass(frozen=True, eq=False)
class _ComparisonRun:
    """The records, as they were given and made ready."""

    records: list[Record]
    training: list[Prepared]
    held_out: list[Prepared]
    lead: float

    def __post_init__(self) -> None:
        for item in self.held_out:
            if not _counted(item, self.lead):
                raise IdentifyError(
                    f"{item.name}: no sample counts after {self.lead:g} s; need a range that has been seen before. "
                    "Give a longer record or a shorter lead"
                )

    @property
    def stroke(self) -> float:
        """Range of the widest training record's loops [m]."""
        return max(high - low for low, high in (item.span() for item in self.training))

    def scores(self, model: AbstractModel) -> tuple[RecordScore, ...]:
        """One a record, training first."""
        items = [(item, "training", 0.0) for item in self.training]
        items += [(item, "validation", self.lead) for item in self.held_out]
        return tuple(_score(model, item, role, lead, self.stroke) for item, role, lead in items)


def _row(
    name: str,
    fit: Identification,
    job: _ComparisonRun,
    trials: list[tuple[TrackingTrial, list[Record]]],
    tell: Callable[[str], None],
) -> ModelScore:
    """Fit one model and take all its figures; a failure is a sentence."""
    tell(f"fitting {name}")
    known: dict[int, AbstractModel] = {}
    row, said = ModelScore(name), []
    begin = time.perf_counter()
    try:
        model = known[id(job.records)] = fit(job.records)
        row = replace(row, seconds=time.perf_counter() - begin, parameters=parameters_of(model))
        tell(f"simulating {name}")
        simulate, compensate = speeds(model, job.training[0].record)
        row = replace(row, scores=job.scores(model), simulate=simulate, compensate=compensate)
    except _FAILURES as error:
        said.append(_sentence(error))
    tracking = {}
    for one, records in trials:
        if records is job.records and not known:
            continue
        tell(f"tracking with {name} on {one.name}")
        try:
            tracking[one.name] = one.track(known.get(id(records)) or fit(records))
        except _FAILURES as error:
            said.append(f"{one.name}: {_sentence(error)}")
    return replace(row, tracking=tracking, said=" ".join(said))


def _sentence(error: Exception) -> str:
    return str(error) or type(error).__name__


def _score(model: AbstractModel, item: Prepared, role: str, lead: float, stroke: float) -> RecordScore:
    delay = float(getattr(model, "delay", 0.0))
    residuals = [
        _missed_after(model, piece, kept, item.noise, stroke) if lead else _missed(model, piece)[kept]
        for piece, kept in _counted(item, lead, delay)
    ]
    error = np.concatenate([np.zeros(0), *residuals])
    if not np.isfinite(error).all():
        raise IdentifyError(f"{item.name}: the simulation diverges")
    free = error - error.mean() if error.size else error
    figures = (percent(figure(e), stroke) for e in (free, error) for figure in (largest, rms))
    return RecordScore(item.name, role, error.size, item.samples - error.size, *figures)


def _missed(model: AbstractModel, piece: Record) -> Array:
    """Measured less simulated displacement, played from the first sample."""
    return np.asarray(piece.displacement - simulated(model, piece.voltage, piece.time).displacement)


def _missed_after(model: AbstractModel, piece: Record, kept: NDArray[np.bool_], noise: float, stroke: float) -> Array:
    """The same of the samples that count, on the axis that those measured before them tell."""
    before = int(np.argmax(kept))
    if not before:
        return _missed(model, piece)[kept]
    lead = piece.slice(0, before + 1)
    if not isinstance(model, Actuator):
        error = _missed(model, piece)
        # As `state_after` does: over the samples that count, or from the last one.
        last = epochs(lead, noise)[-1:]
        return np.asarray(error[kept] - error[last[0].start if last else before : before + 1].mean())
    state, offset = state_after(replace(model, delay=0.0), lead, stroke)
    rest = piece.slice(before, len(piece))
    voltage = without_offset(model, rest.voltage, offset)
    played = model.simulate(voltage, state=state, **timed(model, rest.time)).displacement
    return np.asarray((rest.displacement - played)[kept[before:]])


def _counted(item: Prepared, lead: float, delay: float = 0.0) -> list[tuple[Record, Any]]:
    """Pieces with their delayed voltage, and which of their samples count."""
    found = []
    for _, piece, _ in item.delayed(0, delay):
        kept = np.zeros(len(piece), dtype=bool)
        for epoch in epochs(piece, item.noise)[-1:]:
            kept[epoch.start : epoch.stop] = True
        kept &= piece.time >= item.start + lead
        if kept.any():
            found.append((piece, kept))
    return found


def parameters_of(model: AbstractModel) -> int | None:
    """Number of coefficients of a model: what it says, or elements and knots of an actuator."""
    inner = getattr(model, "actuator", model)
    if isinstance(inner, Actuator):
        tables = [inner.slip.stiffness, inner.spring.voltage]
        tables += [part.stiffness for part in (inner.creep, inner.smooth) if part is not None]
        rest = 0 if inner.transformer is None else inner.transformer.drive.size - 2
        rest += 0 if inner.dynamics is None else 3
        return sum(table.size for table in tables) + rest + bool(inner.lag)
    count = getattr(inner, "parameters", None)
    return None if count is None else int(count)


def speeds(model: AbstractModel, record: Record) -> tuple[float, float]:
    """Nanoseconds a sample to simulate and to compensate, the best of five runs over a record said again and again."""
    long = np.resize(record.voltage, max(len(record), _SAMPLES_TO_TIME))
    options = timed(model, record.sample_time * np.arange(long.size, dtype=np.float64))
    path = model.simulate(long, **options).displacement
    both = _nanoseconds(model.simulate, long, options), _nanoseconds(model.compensate, path, options)
    if not all(map(isfinite, both)):
        raise IdentifyError("the clock gave no time")
    return both


def _nanoseconds(run: Callable[..., Motion], drive: Array, options: Mapping[str, Any]) -> float:
    best = np.inf
    for _ in range(_RUNS_TO_TIME):
        begin = time.perf_counter()
        run(drive, **options)
        best = min(best, time.perf_counter() - begin)
    return 1e9 * best / drive.size
