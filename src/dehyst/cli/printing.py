"""Printed results: a fit, an assessment of a model, the experiment of the paper."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dehyst._text import escaped
from dehyst.cli.common import echo_files
from dehyst.cli.terminal import echo, worded

if TYPE_CHECKING:
    from dehyst.model import Fit
    from dehyst.studies.paper import Paper
    from dehyst.uncertainty import Insight


# Structures, best first.
_SHOWN = 5


def print_fit(fit: Fit, output: Path | None, report: Path | None) -> None:
    """Print the result of an identification."""
    if fit.expectation is not None:
        echo(fit.expectation.sentence)
    echo(fit.outcome.value)
    if fit.errors:
        names = [escaped(error.record) for error in fit.errors]
        width = max(6, *map(len, names))
        echo()
        echo(f"{'':<{width}}  {'':<10} {'':>8} {'':>8}  {'of the stroke':^18}  {'':^18}  {'with its drift':^18}")
        echo(f"{'record':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}" + 3 * f"  {'largest':>9}{'RMS':>9}")
    for name, error in zip(names, fit.errors, strict=True):
        drift, rms = 100 * error.largest_with_drift / error.stroke, 100 * error.rms_with_drift / error.stroke
        echo(
            f"{name:<{width}}  {error.role:<10} {error.samples:>8} {error.left_out:>8}"
            f"  {error.largest_percent:>7.3f} % {error.rms_percent:>7.3f} %"
            f"  {error.largest * 1e9:>6.0f} nm {error.rms * 1e9:>6.0f} nm  {drift:>7.3f} %{rms:>7.3f} %"
        )
    if fit.trials:
        from dehyst.identification.structure_selection import label

        echo()
        echo("Structures tried, RMS error of cycles held out in turn:")
        structure = fit.options.get("structure")
        for trial in sorted(fit.trials, key=lambda trial: trial.held_out)[:_SHOWN]:
            chosen = " (chosen)" if trial.structure.as_dict() == structure else ""
            echo(f"  {trial.held_out * 1e9:>7.1f} nm  {label(trial.structure, fit.trials)}{chosen}")
        echo("  (A part is kept only if it lowers this error by at least 3 %.)")
    _print_parts(fit.actuator)
    causes = [one.sentence(fit.errors[0].stroke) for one in fit.remaining]
    lists = ("Repaired or left out", fit.repairs), ("Remaining error", causes), ("Remarks", fit.remarks)
    for title, sentences in lists:
        if sentences:
            echo()
            echo(f"{title}:")
            _echo_list(sentences)
    echo()
    echo(f"Solver: {fit.status}, duality gap {fit.gap:.1g}")
    echo_files(Model=output if fit.actuator is not None else None, Report=report)


def _echo_list(sentences: Iterable[str]) -> None:
    for sentence in sentences:
        echo(f"  - {sentence}")


def _print_parts(actuator: Any) -> None:
    """Print the parts of a wider actuator."""
    from dehyst.model import Actuator
    from dehyst.model.summary import parts_of

    if isinstance(actuator, Actuator) and actuator.wide:
        echo()
        echo("The model is made of:")
        for part in parts_of(actuator):
            echo(f"  {part.name + ':':<18}{part.sentence}")


def print_insight(found: Insight, output: Path | None, report: Path | None) -> None:
    """Print an assessment of a model, in the order in which it matters."""
    for warning in worded(found.warnings()):
        echo(f"WARNING: {warning}")
        echo()
    misfit = 100 * found.misfit / found.evidence.stroke
    echo(f"The largest error of the model on these records is {misfit:.3g} % of their range.")
    if found.precision is not None:
        echo(found.precision.sentence)
    if found.structured:
        _print_parts_known(found)
    else:
        _print_directions(found)
    echo()
    echo("When the state becomes known, if nothing is known before:")
    for known in found.knowledge:
        measured, played = (_moment(t) for t in (known.by_displacement, known.by_voltage))
        echo(
            f"  - {known.record}: {measured} from the measured displacement, "
            f"{played if known.judged else 'not judged'} from the voltage alone"
        )
    _print_homing(found)
    echo_files(Band=output, Report=report)


def _print_directions(found: Insight) -> None:
    identifiability = found.identifiability
    echo(
        "Directions of the stiffnesses that the turning points determine, whatever the noise: "
        f"{identifiability.determined} of {identifiability.of}"
    )
    _echo_list(_first_few(identifiability.sentences()))
    values = " ".join(f"{value:.2g}" for value in identifiability.values)
    echo(f"  singular values, V for each volt of breakaway voltage: {values}")
    _print_stiffnesses(found)
    _print_band(found)
    if found.advice:
        echo()
        echo("To record next, best first:")
        for excitation in found.advice[:3]:
            echo(f"  - {excitation.words}: {excitation.determined} of {excitation.of} in {excitation.seconds:.4g} s")
            echo(f"      {excitation.command}")
    elif identifiability.determined == identifiability.of:
        echo()
        echo(f"To record next: {_next(found)}")


def _next(found: Insight) -> str:
    """Return what to record where no loop determines more directions."""
    if found.precision is None or found.precision.all_known:
        return "nothing; no loop determines more directions."
    return f"no loop determines more directions. {found.precision.next}"


def _print_parts_known(found: Insight) -> None:
    """Print what records determine of each part of a wider model, and how accurate its numbers are."""
    from dehyst.uncertainty.part_identifiability import SHARP

    identifiability = found.identifiability
    echo(
        f"Their turning points determine {identifiability.determined} of {identifiability.of} directions of plain "
        "elements."
    )
    echo(f"Known of each part, with all other parts free, to {100 * SHARP:g} % of the voltages:")
    _echo_list(part.sentence for part in found.parts)
    if found.precision is not None:
        echo(f"Known within {100 * found.precision.precision:g} %, number by number:")
        _echo_list(f"{part.counted}" for part in found.precision.parts)
        echo(found.precision.rule)
    if found.intervals is not None:
        echo()
        echo(f"Uncertainty due to noise ({100 * found.intervals.level:.0f} % intervals):")
        if found.loop is not None:
            off = found.loop.off
            share = 100 * off / found.evidence.stroke
            echo(f"  - the displacement on the major loop{share:8.2g} % of the range, {off * 1e9:.3g} nm")
        for name, (model, noise) in found.numbers().items():
            if noise is not None and abs(model).max(initial=0.0) > 0:
                width = 0.5 * (noise[1] - noise[0]).mean() / abs(model).max()
                echo(f"  - {name.split('_')[0]:<33}{100 * width:8.2g} % of its largest number, on average")
    _print_band(found)
    echo()
    echo(found.not_judged)


def _print_homing(found: Insight) -> None:
    if found.homing is None:
        return
    turns = ", ".join(f"{v:.6g}" for v in found.homing.turns)
    verdict = "certified" if found.homing.certified else "NOT certified"
    if found.homing.played is None:
        echo(f"  - shortest homing: {turns} V ({verdict}: from any state to within {found.homing.width * 1e6:.1g} um)")
    else:
        echo(
            f"  - homing: {turns} V in {found.homing.played.duration:.4g} s ({verdict}: the displacement is known to "
            f"{found.homing.error * 1e6:.3g} um after it)"
        )
    for remark in worded(found.homing.remarks):
        echo(f"      {remark}")


def _first_few(sentences: tuple[str, ...], most: int = 12) -> tuple[str, ...]:
    return sentences if len(sentences) <= most else (*sentences[:most], f"and {len(sentences) - most} more (--json)")


def _moment(seconds: float | None) -> str:
    return "never" if seconds is None else f"after {seconds:.4g} s"


def _print_stiffnesses(found: Insight) -> None:
    if found.intervals is None or found.feasible_set is None or found.precision is None:
        return
    from dehyst.uncertainty.precision import NOISE_BIAS

    slip, level, judged = found.actuator.slip, 100 * found.intervals.level, found.precision.parts[0]
    echo()
    echo(f"  i  breakaway  stiffness   {level:.0f} % by noise          compatible            verdict")
    echo("            um       V/um           V/um            with the records, V/um")
    alone, movable = found.identifiability.alone, found.identifiability.movable
    number = movable.cumsum() - 1
    for i, (rho, kappa) in enumerate(zip(slip.breakaway * 1e6, slip.stiffness * 1e-6, strict=True)):
        if not movable[i]:
            echo(f"{i + 1:>3}{rho:>11.4g}{kappa:>11.4g}   never slides: part of the spring")
            continue
        noise = _ends(found.intervals.stiffness[:, i]) if alone[i] else "open"
        free = _ends(found.feasible_set.stiffness[:, i])
        echo(f"{i + 1:>3}{rho:>11.4g}{kappa:>11.4g}   {noise:<22}{free:<22}{judged.words(int(number[i]))}")
    if any(judged.biased):
        echo(NOISE_BIAS)
    if not alone[movable].all():
        echo("Open: these records do not determine it by itself, whatever their noise; see the next column.")
    echo(found.precision.rule)


def _ends(pair: Any) -> str:
    return f"{pair[0] * 1e-6:>8.4g} to {pair[1] * 1e-6:<8.4g}"


def _print_band(found: Insight) -> None:
    if found.band is None:
        return
    from dehyst.uncertainty.prediction_band import ERRORS

    stroke = found.evidence.stroke
    echo()
    echo("Largest error to expect on the trajectory, in % of the range:")
    for name, error in found.band.errors().items():
        if error or name != "clamped":
            echo(f"  {ERRORS[name]:<42}{100 * error / stroke:8.3f} %{error * 1e9:10.0f} nm")
    if found.band.likely is not None:
        echo(found.band.sentence(stroke))


def print_paper(found: Paper, output: Path) -> None:
    """Print the paper's numbers beside those of this package, for both virtual actuators."""
    from dehyst.studies.paper.tables import summary

    titles = {
        "asymmetric": "Virtual E-280.10",
        "symmetric": "The same without its asymmetric map: the errors are those of the method, not of the model class",
    }
    for key, experiment in found.experiments.items():
        echo(f"{titles[key]} (errors against the truth)")
        echo(f"  {'':<42}{'paper':>9}{'ours, by':>12}{'ours, whole':>13}{'with more':>12}{'Goldfarb,':>12}")
        echo(f"  {'':<42}{'':>9}{'its method':>12}{'record':>13}{'loops':>12}{'relaxed':>12}")
        for row in summary(experiment):
            cells = [row.models.get(name) for name in ("breakpoints", "record", "record_tops", "goldfarb")]
            if row.actuator is not None:
                cells = [row.actuator, None, None, None] if not row.models else cells
            cells_written = [("" if value is None else f"{value:.3f}") for value in (row.paper, *cells)]
            unit = "um" if row.unit == "µm" else row.unit
            echo(
                f"  {row.words + ', ' + unit:<42}"
                + "".join(f"{text:>{width}}" for text, width in zip(cells_written, (9, 12, 13, 12, 12), strict=True))
            )
        echo()
    echo(f"Written to {output}/: open index.html")
