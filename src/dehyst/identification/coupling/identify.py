"""Records of several axes to a stage: the coupling matrix, the actuator of each axis, and the summary of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import IdentifyError, RecordError
from dehyst._text import escaped, to_know
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.identification.coupling.cross_talk import CrossTalk, cross_talk
from dehyst.identification.coupling.matrix import (
    AxisTraces,
    Coupling,
    PlayColumns,
    coupling_by_models,
    coupling_by_plays,
    refuse_inseparable,
    refuse_still_or_equal,
    refuse_unmoved,
    separate_motion,
)
from dehyst.identification.expectation import Readiness
from dehyst.identification.fit import Fit
from dehyst.identification.identify import identify
from dehyst.model import Stage
from dehyst.model.stage import apply, by_axis, inverse, matrix_lines
from dehyst.records import Record

# Matrix and axes are identified in turn until the matrix moves no axis by more than this share of its stroke.
_MOST_PASSES, _SETTLED = 3, 2e-4
_SPANS = 24
_KEYS = (
    "verdict good axes coupling uncertainty condition rank_one_share is_matrix own_motion passes errors remarks "
    "residual_coupling_certainty=cross_talk.certainty"
)
# Coupling beyond a matrix, as a share of the stroke (RMS), with which a stage may still be used.
_SMALL = 0.003


@dataclass(frozen=True)
class AxisError:
    """How far the model of a stage misses one axis of a record.

    Attributes
    ----------
    record, role, axis : str
        `role` is training or validation.
    rms, largest : float
        [m].
    stroke : float
        Range of the axis in the training records [m], the reference of percentages.
    samples, left_out : int
        Samples that are compared, and others.
    """

    record: str
    role: str
    axis: str
    rms: float
    largest: float
    stroke: float
    samples: int
    left_out: int

    @property
    def rms_percent(self) -> float:
        """RMS error in % of the stroke."""
        return 100 * self.rms / self.stroke

    @property
    def largest_percent(self) -> float:
        """Largest error in % of the stroke."""
        return 100 * self.largest / self.stroke

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        lengths = {"rms_nm": 1e9 * self.rms, "largest_nm": 1e9 * self.largest, "stroke_um": 1e6 * self.stroke}
        return json_values(self, "record role axis rms_percent largest_percent samples left_out") | lengths


@dataclass(frozen=True, eq=False)
class StageFit:
    """The result of an identification of a stage.

    Attributes
    ----------
    stage : Stage or None
        None only if an axis could not be identified.
    fits : tuple of Fit
        The identification of each axis on its decoupled displacement ``coupling^-1 y``.
    coupling, uncertainty : (axes, axes) array
        The coupling matrix, and the standard error of each entry (0 on the diagonal).
    rank_one_share : (axes,) array
        Of the energy of all displacements by each voltage, the share that is one shape times a column of the matrix.
    cross_talk : CrossTalk
        What is left of each axis that follows the voltage of another one.
    errors : tuple of AxisError
        Of simulating each record, training first, a row an axis.
    own_motion : (axes,) array
        Share of the motion of each voltage that no other voltage explains.
    passes : int
        How often matrix and axes were identified in turn.
    remarks : tuple of str
        Sentences: limits of the result.
    axes : tuple of str
        Names of the axes.
    """

    stage: Stage | None
    fits: tuple[Fit, ...]
    coupling: Array
    uncertainty: Array
    rank_one_share: Array
    cross_talk: CrossTalk
    errors: tuple[AxisError, ...]
    own_motion: Array
    passes: int
    remarks: tuple[str, ...] = ()
    axes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<StageFit of axes {', '.join(self.axes)}: {escaped(self.verdict)}>"

    @property
    def condition(self) -> float:
        """Condition number of the coupling matrix."""
        return float(np.linalg.cond(self.coupling))

    @property
    def is_matrix(self) -> bool:
        """Whether coupling is a matrix, as far as the records show."""
        return not bool(np.any(self.cross_talk.beyond))

    @property
    def good(self) -> bool:
        """Whether the model may be used: every axis is usable, and what no matrix describes of the coupling is small.

        Small is at most 0.3 % of the stroke (RMS). What the voltage of another axis moves more is no axis of its own.
        """
        if self.exchanged:
            return False
        small = bool(np.all(self.cross_talk.size[self.cross_talk.beyond] <= _SMALL))
        return self.stage is not None and all(fit.good for fit in self.fits) and small

    @property
    def exchanged(self) -> tuple[str, ...]:
        """Axes whose displacement the voltage of another axis moves more than their own."""
        beside = np.abs(self.coupling - np.eye(len(self.axes))).max(axis=1, initial=0.0)
        return tuple(axis for axis, most in zip(self.axes, beside.tolist(), strict=True) if most > 1)

    @property
    def verdict(self) -> str:
        """One sentence on what to expect of the stage."""
        if self.exchanged:
            return (
                f"Not usable: the voltage of another axis moves {', '.join(self.exchanged)} more than its own does; "
                "are the columns of displacements exchanged?"
            )
        if self.stage is None:
            bad = [axis for axis, fit in zip(self.axes, self.fits, strict=True) if fit.actuator is None]
            return f"Not usable: no model of axis {', '.join(bad)}"
        held = [error for error in self.errors if error.role == "validation"]
        judged, source = (held, "held-out") if held else (self.errors, "training")
        largest = max(judged, key=lambda error: error.largest_percent)
        rms = max(error.rms_percent for error in judged)
        missed = (
            f"the {source} records are missed by {largest.largest_percent:.2g} % of the stroke at most "
            f"(axis {largest.axis}), {rms:.2g} % RMS"
        )
        if not self.is_matrix:
            return f"{'Usable, with care' if self.good else 'Not usable'}: coupling is more than a matrix; {missed}"
        words = {Readiness.NOT_USABLE: "Not usable", Readiness.READY: "Ready for use"}
        levels = [fit.expectation.readiness for fit in self.fits if fit.expectation is not None]
        worst = Readiness.NOT_USABLE if Readiness.NOT_USABLE in levels or not self.good else None
        if worst is None and levels and all(level is Readiness.READY for level in levels):
            worst = Readiness.READY
        head = "Usable, with care" if worst is None else words[worst]
        return f"{head}: {missed}"

    def summary(self, full: bool = False) -> str:
        """Return what `dehyst identify` prints of several axes, in lines; `full`: with `--all`."""
        return "\n".join(escaped(line) for line in (lines if full else _brief)(self))

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        return json_values(self, _KEYS) | {
            "residual_coupling_percent": (100 * self.cross_talk.size).tolist(),
            "residual_coupling_floor_percent": (100 * self.cross_talk.floor).tolist(),
            "fits": by_axis(self.axes, self.fits),
        }


def identify_stage(
    records: Record | Sequence[Record],
    *,
    validate: Record | Sequence[Record] = (),
    progress: Progress | None = None,
    **options: Any,
) -> StageFit:
    """Identify a stage: its coupling matrix, and each axis by `dehyst.identify`.

    All displacements are fitted at once to plays of all voltages; the part of each voltage is one shape times a column
    of the coupling matrix. Each actuator is identified from its voltage and ``coupling^-1 y``. Then the matrix is
    fitted to the outputs of these models, and both are repeated until the matrix settles.

    Parameters
    ----------
    records : Record or sequence of Record
        Training records, in which axes move one after the other, together, or both.
    validate : Record or sequence of Record, optional
        Records that are only simulated.
    progress : callable, optional
        Called with a few words at each step.
    **options
        Of `dehyst.identify`, for every axis.

    Raises
    ------
    RecordError, IdentifyError
        As `dehyst.identify`, the axis named, or if a voltage or displacement of an axis never moves, two displacements
        are the same, two axes always move together, or records have different axes.
    """
    training, held_out, report = _listed(records), _listed(validate), progress or (lambda _: None)
    if not training:
        raise IdentifyError("got no records, need one of all axes at least")
    _refuse_other_axes([*training, *held_out])
    names, strokes = training[0].axes, np.max([np.ptp(record.displacement, axis=0) for record in training], axis=0)
    refuse_still_or_equal(training)
    report("coupling of the axes")
    with one_thread():
        columns = PlayColumns.of(training)
        own = separate_motion(columns)
        remarks = refuse_inseparable(training, own)
        refuse_unmoved(columns, names)
        coupling = coupling_by_plays(columns)
    found = _in_turn(training, held_out, coupling, strokes, options, report)
    final, uncertainty, share = found.coupling.matrix, found.coupling.uncertainty, found.coupling.share
    if not found.traces:
        nothing = np.zeros_like(final)
        talk = CrossTalk(nothing, nothing, nothing, nothing.astype(bool))
        return StageFit(None, found.fits, final, uncertainty, share, talk, (), own, found.passes, tuple(remarks), names)
    report("what is left of the coupling")
    talk = cross_talk(columns, found.traces, final, strokes)
    beside = [AxisTraces.of(one, found.fits, k, found.used) for k, one in enumerate([*training, *held_out])]
    roles = ["training"] * len(training) + ["validation"] * len(held_out)
    errors = tuple(e for one, role in zip(beside, roles, strict=True) for e in _errors(one, role, final, strokes))
    stage = Stage(
        tuple(fit.actuator for fit in found.fits),
        final,
        names,
        provenance={
            "dehyst": __version__,
            "records": [{"name": one.name, **one.meta} for one in training],
            "passes": found.passes,
            "coupling_uncertainty": uncertainty.tolist(),
        },
        is_matrix=not bool(talk.beyond.any()),
        recorded_columns=tuple(training[0].meta.get("axes", ())),
    )
    remarks += _talk_remarks(talk, names)
    return StageFit(
        stage, found.fits, final, uncertainty, share, talk, errors, own, found.passes, tuple(remarks), names
    )


class _InTurn(NamedTuple):
    """The fit of each axis; the final coupling, and the one `used` for these fits; traces only if all have a model."""

    fits: tuple[Fit, ...]
    coupling: Coupling
    used: Array
    traces: list[AxisTraces]
    passes: int


def _in_turn(
    training: Sequence[Record],
    held_out: Sequence[Record],
    coupling: Coupling,
    strokes: Array,
    options: dict[str, Any],
    report: Progress,
) -> _InTurn:
    """Identify the axes and refine the coupling in turn, until it settles."""
    for passes in range(1, _MOST_PASSES + 1):
        used = coupling.matrix
        fits = _axis_fits(training, held_out, used, options, lambda words, turn=passes: report(f"pass {turn}, {words}"))  # type: ignore[misc]
        if any(fit.actuator is None for fit in fits):
            return _InTurn(fits, coupling, used, [], passes)
        traces = [AxisTraces.of(record, fits, k, used) for k, record in enumerate(training)]
        refined = _refined(traces, coupling.share)
        change = np.abs(refined.matrix - used) * strokes[None, :] / strokes[:, None]
        if change.max() <= _SETTLED:
            coupling = replace(refined, matrix=used)
            break
        coupling = refined
    return _InTurn(fits, coupling, used, traces, passes)


def _axis_fits(
    training: Sequence[Record],
    held_out: Sequence[Record],
    coupling: Array,
    options: dict[str, Any],
    report: Progress,
) -> tuple[Fit, ...]:
    """Identify each axis on its decoupled displacement."""
    table, fits = inverse(coupling), []
    for j, axis in enumerate(training[0].axes):
        alone = [[one.axis(j, apply(table, one.displacement)[:, j]) for one in some] for some in (training, held_out)]
        try:
            fits.append(
                identify(
                    alone[0],
                    validate=alone[1],
                    progress=lambda words, axis=axis: report(f"axis {axis}: {words}"),  # type: ignore[misc]
                    **{"throw": False, **options},
                )
            )
        except (RecordError, IdentifyError) as error:
            raise type(error)(f"axis {axis}: {error}") from error
    return tuple(fits)


def _refined(traces: Sequence[AxisTraces], share: Array) -> Coupling:
    """Return the coupling by least squares on the outputs of the models."""
    counted = [one.counted for one in traces]
    displacement = np.concatenate([one.record.displacement[rows] for one, rows in zip(traces, counted, strict=True)])
    outputs = np.concatenate([one.outputs[rows] for one, rows in zip(traces, counted, strict=True)])
    own = [one.nuisances()[rows] for one, rows in zip(traces, counted, strict=True)]
    nuisances = np.zeros((len(outputs), sum(part.shape[1] for part in own)))
    groups, row, column = np.empty(len(outputs), dtype=np.intp), 0, 0
    for part in own:
        stop = row + len(part)
        nuisances[row:stop, column : column + part.shape[1]] = part
        groups[row:stop] = np.arange(len(part)) * _SPANS // max(len(part), 1)
        row, column = stop, column + part.shape[1]
    moving = np.ptp(nuisances, axis=0) > 0
    moving |= (nuisances != 0).all(axis=0)
    return coupling_by_models(displacement, outputs, nuisances[:, moving], groups, share)


def _errors(traces: AxisTraces, role: str, coupling: Array, strokes: Array) -> list[AxisError]:
    residual = traces.residual(coupling)
    rows = np.isfinite(residual).all(axis=1)
    left = residual[rows]
    if not len(left):
        return []
    return [
        AxisError(
            traces.record.name,
            role,
            axis,
            float(np.sqrt(np.mean(left[:, i] ** 2))),
            float(np.abs(left[:, i]).max()),
            float(strokes[i]),
            len(left),
            len(residual) - len(left),
        )
        for i, axis in enumerate(traces.record.axes)
    ]


def _talk_remarks(talk: CrossTalk, names: Sequence[str]) -> list[str]:
    return [
        f"coupling of {names[j]} into {names[i]} is more than a number: beside it the voltage of {names[j]} moves axis "
        f"{names[i]} by {100 * talk.size[i, j]:.2g} % of its stroke (RMS), {talk.certainty[i, j]:.2g} times the "
        "scatter; it has hysteresis or a curve of its own, which no matrix describes"
        for i, j in np.argwhere(talk.beyond).tolist()
    ]


def _listed(records: Record | Sequence[Record]) -> list[Record]:
    single = isinstance(records, Record) or not isinstance(records, Sequence)
    found: list[Any] = [records] if single else list(records)  # type: ignore[arg-type]
    for one in found:
        if not isinstance(one, Record) or not one.axes:
            got = "a record of one axis" if isinstance(one, Record) else type(one).__name__
            raise RecordError(
                argument="records",
                got=got,
                need="records of several axes",
                hint="dehyst.read(path, axes=...) reads one",
            )
    return found


def _refuse_other_axes(records: Sequence[Record]) -> None:
    first = records[0]
    for other in records[1:]:
        if other.axes != first.axes:
            raise RecordError(
                f"record '{other.name}': has the axes {', '.join(other.axes)}, but '{first.name}' has "
                f"{', '.join(first.axes)}; give records of the same axes in the same order"
            )


def _brief(fit: StageFit) -> Iterator[str]:
    """Yield the verdict, whether coupling is a matrix, what to expect of each axis, and at most three remarks."""
    yield f"{fit.verdict}."
    yield from talk_lines(fit)
    for axis, one in zip(fit.axes, fit.fits, strict=True):
        yield f"Axis {axis}: {one.summary().splitlines()[0]}"
    yield from to_know(fit.remarks)


def lines(fit: StageFit) -> Iterator[str]:
    """Yield verdict, coupling, errors, what is left of the coupling, the verdict of each axis, and remarks."""
    yield fit.verdict
    yield ""
    yield "Coupling: displacement of each axis (row) for each metre that an actuator (column) moves"
    yield from matrix_lines(fit.axes, fit.coupling, fit.uncertainty)
    yield f"Condition {fit.condition:.4g}; identified in turn with the axes, {fit.passes} times."
    shares = ", ".join(f"{axis} {share:.5f}" for axis, share in zip(fit.axes, fit.rank_one_share, strict=True))
    yield f"Rank-one share of what each voltage moves: {shares}."
    yield from talk_lines(fit)
    if fit.errors:
        width = max(len(f"{error.record} ({error.axis})") for error in fit.errors)
        yield ""
        yield f"{'record (axis)':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}  {'largest':>9}  {'RMS':>9}"
        for error in fit.errors:
            yield (
                f"{f'{error.record} ({error.axis})':<{width}}  {error.role:<10} {error.samples:>8} {error.left_out:>8}"
                f"  {error.largest_percent:>7.3f} %  {error.rms_percent:>7.3f} %"
            )
    for axis, one in zip(fit.axes, fit.fits, strict=True):
        yield ""
        yield f"Axis {axis}: {one}"
    if fit.remarks:
        yield ""
        yield "Remarks:"
        yield from (f"  - {remark}" for remark in fit.remarks)


def talk_lines(fit: StageFit) -> Iterator[str]:
    """Yield what is left of the coupling, and whether it is a matrix."""
    talk, axes = fit.cross_talk, fit.axes
    if fit.stage is None or len(axes) < 2:
        return
    i, j = np.unravel_index(int(np.argmax(talk.size)), talk.size.shape)
    largest = f"at most {100 * talk.size[i, j]:.2g} % of the stroke (RMS, {axes[j]} into {axes[i]})"
    floor = f"{100 * float(talk.floor.max()):.2g} %"
    if not talk.size.any():
        yield f"Coupling is a matrix: beside it no voltage moves another axis; {floor} of the stroke (RMS) would count."
    elif fit.is_matrix:
        yield f"Coupling is a matrix: beside it a voltage moves another axis by {largest}; {floor} would count."
    else:
        yield f"Coupling is NOT a matrix: beside it a voltage moves another axis by {largest}; {floor} counts."
