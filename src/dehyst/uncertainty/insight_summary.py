"""An assessment in words: the lines of `Insight.summary`, which `dehyst insight` prints, and its HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TYPE_CHECKING, Any, TypeAlias

from dehyst._text import counted, escaped
from dehyst._views import html
from dehyst.uncertainty.part_identifiability import SHARP
from dehyst.uncertainty.precision import NOISE_BIAS
from dehyst.uncertainty.prediction_band import ERRORS

if TYPE_CHECKING:
    from dehyst.uncertainty.insight_result import Insight

Worded: TypeAlias = "Callable[[Iterable[str]], tuple[str, ...]]"


def one_line(found: Insight) -> str:
    """Return what is determined and known, counted."""
    directions = f"{found.identifiability.determined} of {found.identifiability.of} directions determined"
    known = "" if found.precision is None else f", {found.precision.sentence.removesuffix('.')}"
    warnings = counted(len(found.warnings()), "warning")
    return f"<Insight of '{escaped(found.actuator.name)}': {directions}{known}, {warnings}>"


def as_html(found: Insight) -> str:
    """Return an assessment for a notebook: warnings, what is known, and the numbers of each part."""
    warnings, precision = found.warnings(), found.precision
    stroke = found.evidence.stroke
    rows = [
        ("largest error on the records", f"{100 * found.misfit / stroke:.3g} % of their range"),
        ("directions determined", f"{found.identifiability.determined} of {found.identifiability.of}"),
    ]
    if precision is not None:
        rows += [(f"{part.several} known", f"{part.known} of {part.of_all}") for part in precision.parts]
    if found.band is not None:
        errors = {name: error for name, error in found.band.errors().items() if error or name != "clamped"}
        rows += [
            (f"path: {ERRORS[name]}", f"{100 * error / stroke:.3g} % of the range") for name, error in errors.items()
        ]
    title = f"Insight of '{found.actuator.name}'"
    text = html.preformatted("Summary", lines(found))
    return html.block(title, *map(html.line, warnings), html.facts(rows), text, colour="amber" if warnings else "green")


def lines(found: Insight, worded: Worded = tuple) -> Iterator[str]:
    """Yield the lines of a summary, in the order in which they matter; `worded` may change words of the sentences."""
    for warning in worded(found.warnings()):
        yield f"WARNING: {warning}"
        yield ""
    misfit = 100 * found.misfit / found.evidence.stroke
    yield f"The largest error of the model on these records is {misfit:.3g} % of their range."
    if found.precision is not None:
        yield found.precision.sentence
    if found.structured:
        yield from _parts_known(found)
    else:
        yield from _directions(found)
    yield ""
    yield "When the state becomes known, if nothing is known before:"
    for known in found.knowledge:
        measured, played = (_moment(t) for t in (known.by_displacement, known.by_voltage))
        yield (
            f"  - {known.record}: {measured} from the measured displacement, "
            f"{played if known.judged else 'not judged'} from the voltage alone"
        )
    yield from _homing(found, worded)


def _directions(found: Insight) -> Iterator[str]:
    identifiability = found.identifiability
    yield (
        "Directions of the stiffnesses that the turning points determine, whatever the noise: "
        f"{identifiability.determined} of {identifiability.of}"
    )
    yield from _bullets(_first_few(identifiability.sentences()))
    values = " ".join(f"{value:.2g}" for value in identifiability.values)
    yield f"  singular values, V for each volt of breakaway voltage: {values}"
    yield from _stiffnesses(found)
    yield from _band(found)
    if found.advice:
        yield ""
        yield "To record next, best first:"
        for excitation in found.advice[:3]:
            yield f"  - {excitation.words}: {excitation.determined} of {excitation.of} in {excitation.seconds:.4g} s"
            yield f"      {excitation.command}"
    elif identifiability.determined == identifiability.of:
        yield ""
        yield f"To record next: {_next(found)}"


def _next(found: Insight) -> str:
    """Return what to record where no loop determines more directions."""
    if found.precision is None or found.precision.all_known:
        return "nothing; no loop determines more directions."
    return f"no loop determines more directions. {found.precision.next}"


def _parts_known(found: Insight) -> Iterator[str]:
    """Yield what records determine of each part of a wider model, and how accurate its numbers are."""
    identifiability = found.identifiability
    yield (
        f"Their turning points determine {identifiability.determined} of {identifiability.of} directions of plain "
        "elements."
    )
    yield f"Known of each part, with all other parts free, to {100 * SHARP:g} % of the voltages:"
    yield from _bullets(part.sentence for part in found.parts)
    if found.precision is not None:
        yield f"Known within {100 * found.precision.precision:g} %, number by number:"
        yield from _bullets(part.counted for part in found.precision.parts)
        yield found.precision.rule
    if found.intervals is not None:
        yield ""
        yield f"Uncertainty due to noise ({100 * found.intervals.level:.0f} % intervals):"
        if found.loop is not None:
            off = found.loop.off
            share = 100 * off / found.evidence.stroke
            yield f"  - the displacement on the major loop{share:8.2g} % of the range, {off * 1e9:.3g} nm"
        for name, (model, noise) in found.numbers().items():
            if noise is not None and abs(model).max(initial=0.0) > 0:
                width = 0.5 * (noise[1] - noise[0]).mean() / abs(model).max()
                yield f"  - {name.split('_')[0]:<33}{100 * width:8.2g} % of its largest number, on average"
    yield from _band(found)
    yield ""
    yield found.not_judged


def _homing(found: Insight, worded: Worded) -> Iterator[str]:
    if found.homing is None:
        return
    turns = ", ".join(f"{v:.6g}" for v in found.homing.turns)
    verdict = "certified" if found.homing.certified else "NOT certified"
    if found.homing.played is None:
        yield f"  - shortest homing: {turns} V ({verdict}: from any state to within {found.homing.width * 1e6:.1g} um)"
    else:
        yield (
            f"  - homing: {turns} V in {found.homing.played.duration:.4g} s ({verdict}: the displacement is known to "
            f"{found.homing.error * 1e6:.3g} um after it)"
        )
    for remark in worded(found.homing.remarks):
        yield f"      {remark}"


def _first_few(sentences: tuple[str, ...], most: int = 12) -> tuple[str, ...]:
    return sentences if len(sentences) <= most else (*sentences[:most], f"and {len(sentences) - most} more (--json)")


def _moment(seconds: float | None) -> str:
    return "never" if seconds is None else f"after {seconds:.4g} s"


def _stiffnesses(found: Insight) -> Iterator[str]:
    if found.intervals is None or found.feasible_set is None or found.precision is None:
        return

    slip, level, judged = found.actuator.slip, 100 * found.intervals.level, found.precision.parts[0]
    yield ""
    yield f"  i  breakaway  stiffness   {level:.0f} % by noise          compatible            verdict"
    yield "            um       V/um           V/um            with the records, V/um"
    alone, movable = found.identifiability.alone, found.identifiability.movable
    number = movable.cumsum() - 1
    for i, (rho, kappa) in enumerate(zip(slip.breakaway * 1e6, slip.stiffness * 1e-6, strict=True)):
        if not movable[i]:
            yield f"{i + 1:>3}{rho:>11.4g}{kappa:>11.4g}   never slides: part of the spring"
            continue
        noise = _ends(found.intervals.stiffness[:, i]) if alone[i] else "open"
        free = _ends(found.feasible_set.stiffness[:, i])
        yield f"{i + 1:>3}{rho:>11.4g}{kappa:>11.4g}   {noise:<22}{free:<22}{judged.words(int(number[i]))}"
    if any(judged.biased):
        yield NOISE_BIAS
    if not alone[movable].all():
        yield "Open: these records do not determine it by itself, whatever their noise; see the next column."
    yield found.precision.rule


def _ends(pair: Any) -> str:
    return f"{pair[0] * 1e-6:>8.4g} to {pair[1] * 1e-6:<8.4g}"


def _band(found: Insight) -> Iterator[str]:
    if found.band is None:
        return

    stroke = found.evidence.stroke
    yield ""
    yield "Largest error to expect on the trajectory, in % of the range:"
    for name, error in found.band.errors().items():
        if error or name != "clamped":
            yield f"  {ERRORS[name]:<42}{100 * error / stroke:8.3f} %{error * 1e9:10.0f} nm"
    if found.band.likely is not None:
        yield found.band.sentence(stroke)


def _bullets(sentences: Iterable[str]) -> Iterator[str]:
    for sentence in sentences:
        yield f"  - {sentence}"
