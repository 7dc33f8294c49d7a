"""Scores of one case: tracking by each method, what the fit claims, false parts, and whether a failure is silent."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import dehyst
from dehyst import Record
from dehyst.identification import Fit, Verdict
from dehyst.model import AbstractModel, Actuator
from strangers.cases import Case, Experiment

AUTO, PLAIN, LINEAR = "auto", "plain", "linear ratio"
# The best published of each class; the others are special cases of these.
RIVALS = (
    "Prandtl-Ishlinskii, modified",
    "Prandtl-Ishlinskii, generalised",
    "Preisach",
    "Preisach, reversal curves",
    "Bouc-Wen",
    "Duhem",
)
# Seconds that a fit may take.
LONGEST = {AUTO: 120.0, PLAIN: 60.0}
LONGEST_RIVAL = 10.0
# A failure is more than so many times the plain model's error or the claimed one; smaller errors [% of the stroke,
# largest and RMS] are none.
FAILURE, SMALLEST = 2.0, (0.3, 0.1)
# More than so many times the plain model's error is worse than it.
WORSE = 1.1
# A claimed error is right within this factor.
RIGHT = 1.5
# A shorter delay, in samples, is no part.
SHORTEST_DELAY = 0.5
# Warnings that name a cause in the truth or the protocol.
_GENERAL = (
    r"not tried|determine|extrapolat|do not use|held out|samples that count lie|floor|set aside|left out|cannot tell"
)
_FAILURES = (ValueError, ArithmeticError, RuntimeError)


def score(case: Case) -> dict[str, Any]:
    """Run one case; return its JSON values."""
    import dehyst_rivals  # noqa: PLC0415 - a table of results needs no models

    experiment = case.experiment()
    fits: dict[str, Fit] = {}

    def fitted(name: str, structure: Any) -> Callable[[Sequence[Record]], AbstractModel]:
        def run(records: Sequence[Record]) -> AbstractModel:
            fits[name] = dehyst.identify(records, structure=structure)
            return fits[name].actuator

        return run

    ways = {AUTO: fitted(AUTO, "auto"), PLAIN: fitted(PLAIN, "maxwell_slip")}
    ways |= {name: dehyst_rivals.RIVALS[name] for name in RIVALS} | {LINEAR: dehyst_rivals.linear_ratio}
    methods = {name: _tried(experiment, name, way) for name, way in ways.items()}
    for name, fit in fits.items():
        methods[name] |= claims(fit, experiment)
    found = {
        "case": case.name,
        "command": case.command,
        "truth": case.truth.name,
        "protocol": case.protocol.name,
        "disturbance": case.disturbance.name,
        "methods": methods,
    }
    return found | judged(case, methods, fits.get(AUTO))


def _tried(experiment: Experiment, name: str, way: Callable[[Sequence[Record]], AbstractModel]) -> dict[str, Any]:
    begin = time.process_time()
    row: dict[str, Any] = {"said": ""}
    try:
        with _limited(LONGEST.get(name, LONGEST_RIVAL)):
            model = way(experiment.records)
        row["seconds"] = time.process_time() - begin
        row |= experiment.track(model)
    except _FAILURES as failure:
        row["said"] = str(failure) or type(failure).__name__
    return {"seconds": time.process_time() - begin} | row


@contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """Raise RuntimeError after so many seconds of processor time."""

    def stop(*_: object) -> None:
        raise RuntimeError(f"stopped after {seconds:g} s")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def claims(fit: Fit, experiment: Experiment) -> dict[str, Any]:
    """Return what a fit claims: errors [% of the stroke], outcome, warnings and parts."""
    training = [error for error in fit.errors if error.role == "training"]
    stroke = training[0].stroke
    expected = fit.promise
    claimed = max(error.rms_percent for error in training) if expected is None else 100 * expected.rms / stroke
    total = sum(error.samples + error.left_out for error in training)
    return {
        "claimed_rms": claimed,
        "claimed_by": "training" if expected is None else expected.basis,
        "verdict": None if expected is None else expected.as_dict(),
        "training_rms": max(error.rms_percent for error in training),
        "training_largest": max(error.largest_percent for error in training),
        "set_aside": sum(error.left_out for error in training) / total,
        "outcome": fit.outcome.name,
        "remarks": list(fit.remarks),
        "failed_checks": [f"{check.name}: {check.sentence}" for check in fit.checks if check.verdict is Verdict.FAILS],
        "repairs": list(fit.repairs),
        "parts": parts(fit.actuator),
        "delay_samples": fit.actuator.delay / experiment.shortest,
    }


def parts(actuator: Actuator) -> str:
    """Describe the parts of an actuator in few words."""
    slip = actuator.slip
    words = [f"{len(slip)} elements" + (f" x {slip.knots.size - 1}" if hasattr(slip, "knots") else "")]
    if actuator.transformer is not None:
        words.append("transformer")
    if actuator.displacement_creep is not None:
        held = actuator.displacement_creep.time_constants[actuator.displacement_creep.gains > 0]
        ends = f"{held.min():.3g} to {held.max():.3g} s" if held.size else "none held"
        words.append(f"creep ({held.size}: {ends})")
    if actuator.smooth is not None:
        words.append("smooth")
    if actuator.dynamics is not None:
        found = actuator.dynamics
        words.append(f"resonance ({found.frequency:.4g} Hz, zeta {found.damping:.3g})")
    if actuator.delay:
        words.append(f"delay ({actuator.delay:.3g} s)")
    return ", ".join(words)


def judged(case: Case, methods: dict[str, Any], fit: Fit | None) -> dict[str, Any]:
    """Return the verdicts on the selected model of a case."""
    auto, plain = methods[AUTO], methods[PLAIN]
    verdicts: dict[str, Any] = {"refused": auto["said"], "false_parts": [], "named": "", "failures": []}
    if fit is None or "rms" not in auto:
        return verdicts | {"silent": False}
    verdicts["false_parts"] = false_parts(fit.actuator, case, auto["delay_samples"])
    verdicts["claim"] = _figure(auto, "rms") / auto["claimed_rms"]
    failures = []
    if "rms" in plain:
        pairs = [(_figure(auto, key), _figure(plain, key), least) for key, least in _KEYS]
        verdicts["to_plain"] = [mine / other for mine, other, _ in pairs]
        verdicts["worse"] = any(mine > max(WORSE * other, least) for mine, other, least in pairs)
        if any(mine > max(FAILURE * other, least) for mine, other, least in pairs):
            failures.append("plain")
    if _figure(auto, "rms") > max(FAILURE * auto["claimed_rms"], SMALLEST[1]):
        failures.append("claim")
    named = naming(case, auto, good=fit.outcome.good)
    return verdicts | {"failures": failures, "named": named, "silent": bool(failures) and not named}


_KEYS = tuple(zip(("largest", "rms"), SMALLEST, strict=True))


def _figure(row: dict[str, Any], key: str) -> float:
    """Return an error; behind a sensor's filter the smaller one of the truth and of what is seen, as none can tell."""
    return float(min(row[key], row.get(f"sensed_{key}", row[key])))


def false_parts(actuator: Actuator, case: Case, delay: float) -> list[str]:
    """Return the parts that move in time and that neither the truth nor the disturbance has."""
    creep = actuator.displacement_creep is not None
    present = {"resonance": actuator.dynamics is not None, "delay": delay > SHORTEST_DELAY, "creep": creep}
    return [part for part, there in present.items() if there and part not in case.parts]


def naming(case: Case, claimed: dict[str, Any], *, good: bool) -> str:
    """Return what warns of an error: "disturbance" by name, "outcome", "general", or "" if nothing does."""
    warnings = [*claimed["remarks"], *claimed["failed_checks"]]
    if any(re.search(case.disturbance.named, sentence, re.I) for sentence in (*warnings, *claimed["repairs"])):
        return "disturbance"
    if not good:
        return "outcome"
    general = claimed["failed_checks"] or any(re.search(_GENERAL, sentence, re.I) for sentence in warnings)
    return "general" if general else ""
