"""What records determine of an actuator that was identified from them, and what they leave open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from dehyst._errors import ModelError
from dehyst._threads import one_thread
from dehyst._types import Progress
from dehyst._validation import interval, vector
from dehyst.control import Compensator, PossibleStart, StartError, shortest_homing
from dehyst.model import Actuator, TemperatureCover, temperature_range, tested_temperatures
from dehyst.records import Record
from dehyst.trust.evidence import Evidence
from dehyst.trust.experiment_design import advise
from dehyst.trust.insight_result import Insight
from dehyst.trust.prediction_band import PredictionBand, top_state
from dehyst.trust.state_knowledge import StateKnowledge


def insight(
    actuator: Actuator,
    records: Record | Sequence[Record],
    *,
    trajectory: ArrayLike | None = None,
    time: ArrayLike | None = None,
    temperature: ArrayLike | None = None,
    start: PossibleStart | None = None,
    limits: tuple[float, float] | None = None,
    temperatures: tuple[float, float] | None = None,
    seconds: float | None = None,
    progress: Progress = lambda _: None,
) -> Insight:
    """Assess an identified actuator by its records: what they determine, and what to record next.

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
    start : PossibleStart, optional
        The start of the trajectory; default: the top of the limits after a rise through them, where the state is known.
    limits : (float, float), optional
        Voltages allowed [V]; default: those of the model.
    temperatures : (float, float), optional
        Lowest and highest temperature in use [degC]; default: those of the trajectory. What the records do
        not cover causes a warning.
    seconds : float, optional
        Longest excitation to suggest [s]; default: no limit.
    progress : callable, optional
        Called with a short text at each step.

    Raises
    ------
    RecordError, IdentifyError
        If a record cannot be used or an option is impossible.
    ModelError
        If the trajectory is not a path.
    """
    if not isinstance(actuator, Actuator):
        raise ModelError(argument="actuator", got=type(actuator).__name__, need="an Actuator, such as the one of a Fit")
    progress("reading the records beside the model")
    allowed = actuator.limits if limits is None else interval(limits)
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
        band = opened = homing = None
        if trajectory is not None:
            wanted, clock = vector(trajectory, "trajectory"), None if time is None else vector(time, "time")
            if actuator.thermal is not None and warmth is not None:
                wanted = actuator.thermal.at_reference(wanted, warmth)
            state = top_state(actuator, allowed) if start is None else start.within(actuator, allowed)
            command = Compensator(actuator, allowed).trajectory(wanted, time=clock, state=state)
            command = replace(command, temperature=warmth)
            if start is not None and not start.known:
                opened = StartError.along(actuator, start.states, command.voltage, time=clock)
            path = command.voltage, command.displacement
            band = PredictionBand(wanted, *path, evidence.misfit, command.warnings, command.promise, clock)
        if allowed is not None:
            homing = shortest_homing(actuator, limits=allowed, present=allowed[0], stiff_only=True)
        progress("ranking excitations")
        return Insight(
            evidence,
            tuple(StateKnowledge.of(actuator, item) for item in evidence.comparisons),
            allowed,
            homing=homing,
            band=band,
            advice=() if allowed is None else advise(evidence, allowed, seconds),
            start=start if band is not None else None,
            opened=opened,
            temperatures=cover,
        )
