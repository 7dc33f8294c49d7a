"""What records determine of an actuator that was identified from them, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._validation import interval, vector
from dehyst.control import Compensator, shortest_homing
from dehyst.model import Actuator
from dehyst.records import Record
from dehyst.uncertainty.bootstrap import LEAST_REPEATS, Intervals, resample
from dehyst.uncertainty.evidence import Evidence
from dehyst.uncertainty.experiment_design import advise
from dehyst.uncertainty.feasible_set import feasible_set
from dehyst.uncertainty.insight_result import Insight
from dehyst.uncertainty.known_numbers import plain_precision, structured_precision
from dehyst.uncertainty.major_loop_width import MajorLoopWidth
from dehyst.uncertainty.messages import misfit_of
from dehyst.uncertainty.model_error import HeldOut
from dehyst.uncertainty.part_identifiability import part_identifiability
from dehyst.uncertainty.precision import PRECISION, Precision
from dehyst.uncertainty.prediction_band import PredictionBand, rise_excitation, state_after_rise, state_at_top
from dehyst.uncertainty.state_knowledge import StateKnowledge


def insight(
    actuator: Actuator,
    records: Record | Sequence[Record],
    *,
    trajectory: ArrayLike | None = None,
    time: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    seconds: float | None = None,
    level: float = 0.9,
    precision: float = PRECISION,
    repeats: int = 100,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Insight:
    """Judge what records determine of an actuator that was identified from them, and what they leave open.

    Of a structured actuator less is judged, see `Insight`.

    Parameters
    ----------
    actuator : Actuator
    records : Record or sequence of Record
        Those it was identified from.
    trajectory : (n,) array_like, optional
        A displacement to follow [m], on the model's axis: how wrong may it come out? It is followed from the top of
        the limits on, where the state is known.
    time : (n,) array_like, optional
        Of the trajectory [s]; needed by a model that moves in time.
    limits : (float, float), optional
        Voltages allowed [V]; default: those of the model.
    seconds : float, optional
        Longest excitation to be advised.
    level : float, optional
        Of the intervals.
    precision : float, optional
        A number counts as known if half the width of its interval is at most this part of the estimate and the
        interval excludes zero; see `Insight.precision`.
    repeats : int, optional
        Sets of resampled cycles; 0 leaves out intervals and bands.
    seed : int, optional
    progress : callable, optional
        Called with a few words at each step.

    Raises
    ------
    RecordError, IdentifyError
        If a record cannot be used or an option is impossible.
    ModelError
        If a trajectory is given without repeats, or is no path.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(f"actuator: got {type(actuator).__name__}, need an Actuator, such as the one of a Fit")
    _check(trajectory is not None, repeats, level, precision)
    progress("reading the records beside the model")
    allowed = actuator.limits if limits is None else interval(limits)
    wanted = None if trajectory is None else vector(trajectory, "trajectory")
    clock = None if time is None else vector(time, "time")
    with one_thread():
        evidence = Evidence.from_records(actuator, records)
        misfit = misfit_of(actuator, evidence.comparisons)
        judged: dict[str, Any] = {}
        if repeats:
            judged["intervals"] = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
        judge = _judge_structured if actuator.wide else _judge_plain
        judged |= judge(evidence, judged.get("intervals"), wanted, clock, misfit, allowed, seconds, progress)
        judged["precision"] = _precision(evidence, judged, precision)
        if allowed is not None:
            judged["homing"] = shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True)
        knowledge = tuple(StateKnowledge.of(actuator, item) for item in evidence.comparisons)
        return Insight(actuator, evidence, evidence.identifiability, knowledge, misfit, allowed, **judged)


def _judge_plain(
    evidence: Evidence,
    intervals: Intervals | None,
    wanted: Array | None,
    _: Array | None,
    misfit: float,
    limits: tuple[float, float] | None,
    seconds: float | None,
    progress: Progress,
) -> dict[str, Any]:
    """Return what is judged of plain elements only: the feasible set, the band with it, and excitations to add."""
    actuator, judged = evidence.actuator, dict[str, Any]()
    if intervals is not None:
        progress("looking for models that the records do not contradict")
        if wanted is None:
            judged["feasible_set"] = feasible_set(evidence)
        else:
            start = state_at_top(actuator, limits)
            command = Compensator(actuator, limits).trajectory(wanted, state=start)
            free = feasible_set(evidence, command.displacement, start)
            progress("identifying parts of the records")
            held_out = HeldOut.of(evidence, intervals)
            band = PredictionBand.of(wanted, command, intervals, free, misfit=misfit, limits=limits, held_out=held_out)
            judged |= {"feasible_set": free, "band": band}
    progress("ranking excitations")
    if limits is not None:
        judged["advice"] = advise(evidence, limits=limits, seconds=seconds)
    return judged


def _judge_structured(
    evidence: Evidence,
    intervals: Intervals | None,
    wanted: Array | None,
    time: Array | None,
    misfit: float,
    limits: tuple[float, float] | None,
    _: float | None,
    progress: Progress,
) -> dict[str, Any]:
    """Return what is judged of structured models only: their parts, the major loop, and the band in time."""
    actuator, judged = evidence.actuator, dict[str, Any]()
    if intervals is not None and limits is not None:
        judged["loop"] = MajorLoopWidth.from_intervals(evidence, intervals, limits)
    if wanted is not None and intervals is not None:
        played = None if limits is None else rise_excitation(actuator, limits)
        start = state_at_top(actuator, limits) if limits is None else state_after_rise(actuator, limits, played)
        command = Compensator(actuator, limits).trajectory(wanted, time=time, state=start)
        clock = time if actuator.needs_time else None
        progress("identifying parts of the records")
        judged["band"] = PredictionBand.of(
            wanted,
            command,
            intervals,
            None,
            misfit=misfit,
            limits=limits,
            time=clock,
            played=played,
            held_out=HeldOut.of(evidence, intervals),
        )
    progress("judging each part")
    judged["parts"] = part_identifiability(evidence)
    return judged


def _precision(evidence: Evidence, judged: dict[str, Any], precision: float) -> Precision | None:
    """Return what is known to a precision; None without intervals."""
    intervals = judged.get("intervals")
    if intervals is None:
        return None
    if evidence.actuator.wide:
        return structured_precision(evidence, intervals, judged["parts"], precision)
    return plain_precision(evidence, intervals, judged["feasible_set"], precision)


def _check(trajectory: bool, repeats: int, level: float, precision: float) -> None:
    if repeats < 0 or 0 < repeats < LEAST_REPEATS:
        raise ModelError(f"repeats: got {repeats}, need {LEAST_REPEATS} at least, or 0 to leave out the intervals")
    if not 0 < level < 1:
        raise ModelError(f"level: got {level}, need a number between 0 and 1, e.g. 0.9")
    if not 0 < precision < 1:
        raise ModelError(
            f"precision: got {precision}, need a number between 0 and 1, e.g. 0.2 for 20 % of the estimate"
        )
    if trajectory and not repeats:
        raise ModelError(
            f"repeats: got 0 and a trajectory, need {LEAST_REPEATS} at least to estimate how wrong it may come out"
        )
