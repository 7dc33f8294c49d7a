"""What records determine of an actuator that was identified from them, and what they leave open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._validation import interval, vector
from dehyst.control import Command, Compensator, PossibleStart, StartError, shortest_homing
from dehyst.model import Actuator, State, TemperatureCover, temperature_range, tested_temperatures
from dehyst.records import Record
from dehyst.trust.bootstrap import LEAST_REPEATS, Intervals, resample
from dehyst.trust.evidence import Evidence
from dehyst.trust.experiment_design import advise
from dehyst.trust.feasible_set import FeasibleSet, feasible_set
from dehyst.trust.identifiability import StateKnowledge, part_identifiability
from dehyst.trust.insight_result import Insight
from dehyst.trust.precision import PRECISION, known_numbers
from dehyst.trust.prediction_band import MajorLoopWidth, PredictionBand, top_start


def insight(
    actuator: Actuator,
    records: Record | Sequence[Record],
    *,
    trajectory: ArrayLike | None = None,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: Callable[[Actuator], PossibleStart] | None = None,
    limits: tuple[float, float] | None = None,
    temperatures: tuple[float, float] | None = None,
    seconds: float | None = None,
    level: float = 0.9,
    precision: float | None = None,
    repeats: int = 100,
    seed: int = 0,
    progress: Progress = lambda _: None,
) -> Insight:
    """Assess an identified actuator by its records: what they determine, and what they leave open.

    The feasible set (all models that fit the records about as well) is computed for Maxwell-slip models only; see
    `Insight`.

    Parameters
    ----------
    actuator : Actuator
    records : Record or sequence of Record
        The records that the actuator was identified from.
    trajectory : (n,) array_like, optional
        A displacement to follow [m], on the model's axis, whose error is to be predicted.
    time : (n,) array_like, optional
        Time of the trajectory [s]; needed by a model that depends on time.
    temperature : float or (n,) array_like, optional
        Temperature of the trajectory [degC]; default: not known. Of a model that depends on temperature the
        band is that of the trajectory at the reference.
    start : callable, optional
        Returns the start of the trajectory for a model, such as ``lambda one: start_of(one, record, began=True)``;
        default: the top of the limits after a rise through them, where the state is known.
    limits : (float, float), optional
        Voltages allowed [V]; default: those of the model.
    temperatures : (float, float), optional
        Lowest and highest temperature in use [degC]; default: those of the trajectory. What the records do
        not cover causes a warning.
    seconds : float, optional
        Longest excitation to suggest [s]; default: no limit.
    level : float, optional
        Confidence level of the intervals, 0 to 1.
    precision : float, optional
        A number counts as known if half the width of its interval is at most this part of the estimate and the interval
        excludes zero; see `Insight.precision`. If it is given, numbers that are not known cause a warning. Default:
        0.2, without a warning, because a path can be predicted without knowing each number.
    repeats : int, optional
        Sets of resampled cycles; 0 leaves out intervals and bands.
    seed : int, optional
    progress : callable, optional
        Called with a short text at each step.

    Raises
    ------
    RecordError, IdentifyError
        If a record cannot be used or an option is impossible.
    ModelError
        If a trajectory is given without repeats, or is not a path.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator, such as the one of a Fit")
    _check(trajectory is not None, repeats, level, precision)
    progress("reading the records beside the model")
    allowed = actuator.limits if limits is None else interval(limits)
    wanted = None if trajectory is None else vector(trajectory, "trajectory")
    clock = None if time is None else vector(time, "time")
    warmth = None if temperature is None else np.asarray(temperature, dtype=np.float64)
    used = temperatures
    if used is None and warmth is not None and warmth.size:
        used = float(warmth.min()), float(warmth.max())
    reference = None if actuator.thermal is None else actuator.thermal.reference
    tested = tested_temperatures(actuator) or temperature_range([records] if isinstance(records, Record) else records)
    cover = TemperatureCover(tested, used, reference)
    _ = cover.missing  # refuses an impossible range
    with one_thread():
        evidence = Evidence.from_records(actuator, records)
        intervals = free = band = known = loop = path = None
        if repeats:
            intervals = resample(evidence, level=level, repeats=repeats, seed=seed, progress=progress)
            path = None if wanted is None else _WantedPath.followed(actuator, wanted, clock, warmth, start, allowed)
            progress("looking for models that the records do not contradict")
            moved = (None, None) if path is None else (path.command.displacement, path.first)
            free = feasible_set(evidence, *moved)
            if path is not None:
                band = path.band(evidence, intervals, free)
            loop = None if allowed is None else MajorLoopWidth.from_intervals(evidence, intervals, allowed)
        progress("judging each part")
        parts = part_identifiability(evidence)
        if intervals is not None:
            known = known_numbers(evidence, intervals, parts, free, PRECISION if precision is None else precision)
        progress("ranking excitations")
        return Insight(
            evidence,
            tuple(StateKnowledge.of(actuator, item) for item in evidence.comparisons),
            allowed,
            homing=None
            if allowed is None
            else shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True),
            intervals=intervals,
            band=band,
            feasible_set=free,
            advice=() if allowed is None else advise(evidence, limits=allowed, seconds=seconds),
            parts=parts,
            loop=loop,
            precision=known,
            exact=precision is not None,
            start=None if path is None else path.start,
            opened=None if path is None else path.opened,
            temperatures=cover,
        )


class _WantedPath(NamedTuple):
    """A trajectory (n,) [m], its time (n,) [s], the command that follows it, and its start.

    `state` gives the state of a model before it, `first` that of the actuator.
    """

    wanted: Array
    time: Array | None
    command: Command
    state: Callable[[Actuator], State]
    first: State
    start: PossibleStart | None
    opened: StartError | None

    @classmethod
    def followed(
        cls,
        actuator: Actuator,
        wanted: Array,
        time: Array | None,
        temperature: Array | None,
        start: Callable[[Actuator], PossibleStart] | None,
        limits: tuple[float, float] | None,
    ) -> _WantedPath:
        """Follow a trajectory, at the reference temperature, from its start or from the top of the limits."""
        if actuator.thermal is not None and temperature is not None:
            wanted = actuator.thermal.at_reference(wanted, temperature)
        begin = None if start is None else start(actuator)
        state = top_start(actuator, limits) if start is None else lambda one: start(one).within(one, limits)
        first = state(actuator)
        command = Compensator(actuator, limits).trajectory(wanted, time=time, state=first)
        command = replace(command, temperature=temperature)
        opened = None
        if begin is not None and not begin.known:
            opened = StartError.along(actuator, begin.states, command.voltage, time=time)
        return cls(wanted, time, command, state, first, begin, opened)

    def band(self, evidence: Evidence, intervals: Intervals, free: FeasibleSet | None) -> PredictionBand:
        """Return the prediction band of the displacement."""
        return PredictionBand.of(
            self.wanted,
            self.command,
            intervals,
            free,
            self.state,
            misfit=evidence.misfit,
            time=self.time,
            promise=self.command.promise,
        )


def _check(trajectory: bool, repeats: int, level: float, precision: float | None) -> None:
    if repeats < 0 or 0 < repeats < LEAST_REPEATS:
        raise ModelError(
            argument="repeats", got=repeats, need=f"{LEAST_REPEATS} at least, or 0 to leave out the intervals"
        )
    if not 0 < level < 1:
        raise ModelError(argument="level", got=level, need="a number between 0 and 1, e.g. 0.9")
    if precision is not None and not 0 < precision < 1:
        raise ModelError(
            argument="precision", got=precision, need="a number between 0 and 1, e.g. 0.2 for 20 % of the estimate"
        )
    if trajectory and not repeats:
        raise ModelError(
            argument="repeats",
            got="0 and a trajectory",
            need=f"{LEAST_REPEATS} at least to estimate how wrong it may come out",
        )
