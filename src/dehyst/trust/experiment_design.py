"""Experiment design: which excitations of a menu determine most of the stiffness directions that are still open."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dehyst._errors import ModelError
from dehyst._threads import one_thread
from dehyst._views.fields import json_values
from dehyst.identification import cycle_time
from dehyst.records import Record
from dehyst.trust.evidence import Evidence
from dehyst.waveforms import Excitation, Sampling, descending_tops, minor_loop, raised_cosine, reversal_curves

_SAMPLES_A_CYCLE = 200


@dataclass(frozen=True, eq=False)
class Suggestion:
    """A suggested excitation, and what would be known after recording it.

    Attributes
    ----------
    words : str
        Description of the excitation.
    command : str
        The `dehyst excite` command that writes it.
    excitation : Excitation
        The voltage. Its first cycle is a major loop, so no homing is needed before it.
    determined, of : int
        Number of stiffness directions known after recording it, and their total number.
    weakest : float
        Smallest singular value of the known directions [V/V]; see `Identifiability`.
    """

    words: str
    command: str
    excitation: Excitation
    determined: int
    of: int
    weakest: float

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.excitation.duration

    def as_dict(self) -> dict[str, object]:
        """Return JSON values."""
        return json_values(self, "words command seconds determined of weakest_V_per_V=weakest")


def advise(evidence: Evidence, limits: tuple[float, float], seconds: float | None = None) -> tuple[Suggestion, ...]:
    """Rank a menu of excitations by the stiffness directions that they would determine, how well, and in what time.

    Parameters
    ----------
    evidence : Evidence
        The present records and model. The model predicts the motion of each excitation, at the rate of the records.
    limits : (float, float)
        Voltages allowed [V].
    seconds : float, optional
        Longest duration of an excitation [s]; default: no limit.

    Returns
    -------
    tuple of Suggestion
        Best first. Excitations that determine nothing new are left out, so the tuple may be empty.

    Raises
    ------
    ModelError
        If the time is not positive.
    """
    if seconds is not None and not seconds > 0:
        raise ModelError(argument="seconds", got=seconds, need="a positive time")
    # A base of 7e-15 V, as records leave it, is 0 V.
    low, high = limits
    allowed = (0.0 if abs(low) < 1e-9 * (high - low) else low, high)
    cycle = min(cycle_time(one.record.record) for one in evidence.comparisons)
    drive = Sampling(frequency=1 / cycle, sample_rate=_SAMPLES_A_CYCLE / cycle, base=allowed[0], limits=allowed)
    found = []
    with one_thread():
        for words, command, excitation in _menu(drive, allowed[1], len(evidence.actuator.slip)):
            if seconds is None or excitation.duration <= seconds:
                found.append(_judged(evidence, words, drive.command(command), excitation))
    better = [one for one in found if one.determined > evidence.identifiability.determined]
    most = max((one.determined for one in better), default=0)
    clearest = max((one.weakest for one in better if one.determined == most), default=0.0)
    # Rank is not conditioning: what barely determines a direction comes after what determines it well.
    return tuple(sorted(better, key=lambda one: (-one.determined, one.weakest < 0.5 * clearest, one.seconds)))


def _menu(drive: Sampling, top: float, elements: int) -> Iterator[tuple[str, str, Excitation]]:
    """Return description, arguments of `dehyst excite`, and voltage of each excitation."""
    low = drive.base

    def at(part: float) -> float:
        return float(f"{low + part * (top - low):.6g}")

    for parts in ((0.3,), (0.5,), (0.7,), (0.5, 0.3), (0.7, 0.5, 0.3)):
        peaks = [top, *map(at, parts)]
        tops = " and ".join(f"{peak:g}" for peak in peaks[1:])
        command = f"raised-cosine {' '.join(f'{peak:g}' for peak in peaks)} --cycles 2"
        words = f"a major loop, then minor loops from {low:g} V to {tops} V, each twice"
        yield words, command, raised_cosine(peaks, cycles=2, drive=drive)
    inner = minor_loop(at(0.35), at(0.65), highest=top, cycles=2, drive=drive)
    words = f"a major loop, then a minor loop between {at(0.35):g} and {at(0.65):g} V with its approach"
    yield words, f"minor-loop {at(0.35):g} {at(0.65):g} --highest {top:g} --cycles 2", inner
    for steps in sorted({5, 10, min(max(elements, 5), 40)}):
        tops_excitation = descending_tops(top, steps=steps, majors=1, drive=drive)
        words = f"a major loop, then {steps} tops descending from {top:g} V, all back to {low:g} V"
        yield words, f"descending-tops {top:g} --steps {steps} --majors 1", tops_excitation
    curves = reversal_curves(top, count=10, drive=drive)
    yield f"10 first-order reversal curves from {top:g} V", f"reversal-curves {top:g}", curves


def _judged(evidence: Evidence, words: str, command: str, excitation: Excitation) -> Suggestion:
    actuator = evidence.actuator
    first = actuator.turned(float(actuator.spring.displacement[0]), rising=False)
    time = excitation.time if actuator.needs_time else None
    begun = actuator.simulate(
        excitation.voltage[:1], time=None if time is None else time[:1], state=first, extrapolate=True
    ).state
    motion = actuator.simulate(excitation.voltage, time=time, state=begun, extrapolate=True)
    record = Record(excitation.time, excitation.voltage, motion.displacement, excitation.name)
    directions = evidence.directions(record)
    weakest = float(directions.values[directions.determined - 1]) if directions.determined else float(np.nan)
    return Suggestion(words, command, excitation, directions.determined, directions.of, weakest)
