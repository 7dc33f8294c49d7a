"""Identification of a stage from records of several axes: coupling matrix, actuators, and summary."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dehyst._errors import IdentifyError, RecordError
from dehyst._text import escaped, to_know
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst._views.fields import json_values
from dehyst.identification.coupling import matrix
from dehyst.identification.coupling.cross_talk import CrossTalk, cross_talk
from dehyst.identification.expectation import Readiness
from dehyst.identification.fit import Fit
from dehyst.identification.identify import identify
from dehyst.model import Stage, apply, by_axis, inverse, matrix_lines
from dehyst.records import Record, largest, rms

# Matrix and axes are identified in turn until the matrix moves no axis by more than this share of its stroke.
_MOST_PASSES, _SETTLED = 3, 2e-4
_KEYS = (
    "verdict good axes coupling uncertainty condition rank_one_share is_matrix own_motion passes errors remarks "
    "residual_coupling_certainty=cross_talk.certainty"
)
# Coupling beyond a matrix, as a share of the stroke (RMS), with which a stage may still be used.
_SMALL = 0.003


@dataclass(frozen=True)
class AxisError:
    """Error of the model of a stage on one axis of a record.

    Attributes
    ----------
    record, role, axis : str
        `role` is training or validation.
    rms, largest : float
        RMS and largest error [m].
    stroke : float
        Range of the axis in the training records [m], the reference of percentages.
    samples, left_out : int
        Number of samples that are compared, and of others: those before the axis moves, and before the second turning
        point of each voltage that moves.
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
        For each voltage, the share of the energy of all displacements due to it that is one shape times a column of the
        matrix.
    cross_talk : CrossTalk
        Motion of each axis due to other voltages that the matrix does not describe.
    errors : tuple of AxisError
        Errors of the simulation of each record, training first, one for each axis.
    own_motion : (axes,) array
        Share of the motion of each voltage that no other voltage explains.
    passes : int
        Number of alternating identifications of matrix and axes.
    remarks : tuple of str
        Sentences on the limits of the result.
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
        """Whether the model may be used: every axis is usable, and the coupling that no matrix describes is small.

        Small is at most 0.3 % of the stroke (RMS). No axis may move more by another voltage than by its own.
        """
        small = bool(np.all(self.cross_talk.size[self.cross_talk.beyond] <= _SMALL))
        return not self.exchanged and self.stage is not None and all(fit.good for fit in self.fits) and small

    @property
    def exchanged(self) -> tuple[str, ...]:
        """Axes whose displacement moves more by another axis' voltage than by their own."""
        others = np.abs(self.coupling - np.eye(len(self.axes))).max(axis=1, initial=0.0)
        return tuple(axis for axis, most in zip(self.axes, others.tolist(), strict=True) if most > 1)

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
        levels = {fit.expectation.readiness for fit in self.fits if fit.expectation is not None}
        head = "Usable, with care"
        if not self.good or (self.is_matrix and Readiness.NOT_USABLE in levels):
            head = "Not usable"
        elif self.is_matrix and levels == {Readiness.READY}:
            head = "Ready for use"
        return f"{head}: {missed}" if self.is_matrix else f"{head}: coupling is more than a matrix; {missed}"

    def summary(self, full: bool = False) -> str:
        """Return what `dehyst identify` prints of several axes, in lines; `full`: with `--all`."""
        return "\n".join(escaped(line) for line in (self._lines if full else self._brief)())

    def as_dict(self) -> dict[str, Any]:
        """Return JSON values without the traces."""
        return json_values(self, _KEYS) | {
            "residual_coupling_percent": (100 * self.cross_talk.size).tolist(),
            "residual_coupling_floor_percent": (100 * self.cross_talk.floor).tolist(),
            "fits": by_axis(self.axes, self.fits),
        }

    def _brief(self) -> Iterator[str]:
        """Yield the verdict, whether coupling is a matrix, what to expect of each axis, and at most three remarks."""
        yield f"{self.verdict}."
        yield from self._left()
        for axis, one in zip(self.axes, self.fits, strict=True):
            yield f"Axis {axis}: {one.summary().splitlines()[0]}"
        yield from to_know(self.remarks)

    def _lines(self) -> Iterator[str]:
        """Yield verdict, coupling, errors, what is left of the coupling, the verdict of each axis, and remarks."""
        yield from (self.verdict, "")
        yield "Coupling: displacement of each axis (row) for each metre that an actuator (column) moves"
        yield from matrix_lines(self.axes, self.coupling, self.uncertainty)
        yield f"Condition {self.condition:.4g}; identified in turn with the axes, {self.passes} times."
        shares = ", ".join(f"{axis} {share:.5f}" for axis, share in zip(self.axes, self.rank_one_share, strict=True))
        yield f"Rank-one share of what each voltage moves: {shares}."
        yield from self._left()
        if self.errors:
            names = [f"{error.record} ({error.axis})" for error in self.errors]
            width = max(map(len, names))
            yield ""
            yield f"{'record (axis)':<{width}}  {'role':<10} {'samples':>8} {'left out':>8}  {'largest':>9}  {'RMS':>9}"
            for name, error in zip(names, self.errors, strict=True):
                counts = f"{error.role:<10} {error.samples:>8} {error.left_out:>8}"
                yield f"{name:<{width}}  {counts}  {error.largest_percent:>7.3f} %  {error.rms_percent:>7.3f} %"
        for axis, one in zip(self.axes, self.fits, strict=True):
            yield from ("", f"Axis {axis}: {one}", *(f"  - {remark}" for remark in one.remarks))
        if self.remarks:
            yield from ("", "Remarks:", *(f"  - {remark}" for remark in self.remarks))

    def _left(self) -> Iterator[str]:
        """Yield what is left of the coupling, and whether it is a matrix."""
        talk, axes = self.cross_talk, self.axes
        if self.stage is None or len(axes) < 2:
            return
        i, j = np.unravel_index(int(np.argmax(talk.size)), talk.size.shape)
        largest = f"at most {100 * talk.size[i, j]:.2g} % of the stroke (RMS, {axes[j]} into {axes[i]})"
        floor, matrix = f"{100 * float(talk.floor.max()):.2g} %", "Coupling is a matrix: beside it"
        if not talk.size.any():
            yield f"{matrix} no voltage moves another axis; {floor} of the stroke (RMS) would count."
        elif self.is_matrix:
            yield f"{matrix} a voltage moves another axis by {largest}; {floor} would count."
        else:
            yield f"Coupling is NOT a matrix: in addition, a voltage moves another axis by {largest}; {floor} counts."


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
        Options of `dehyst.identify`, for every axis.

    Raises
    ------
    RecordError, IdentifyError
        As `dehyst.identify`, with the name of the axis; or if a voltage or displacement of an axis never moves, two
        displacements are the same, two axes always move together, or records have different axes.
    """
    training, held_out, report = _listed(records), _listed(validate), progress or (lambda _: None)
    if not training:
        raise IdentifyError("got no records, need one of all axes at least")
    for other in (*training, *held_out):
        if other.axes != training[0].axes:
            raise RecordError(
                f"record '{other.name}': has the axes {', '.join(other.axes)}, but '{training[0].name}' has "
                f"{', '.join(training[0].axes)}; give records of the same axes in the same order"
            )
    names, strokes = training[0].axes, np.max([np.ptp(record.displacement, axis=0) for record in training], axis=0)
    matrix.refuse_still(training)
    matrix.refuse_equal(training)
    report("coupling of the axes")
    with one_thread():
        columns = matrix.PlayColumns.of(training)
        own = matrix.separate_motion(columns)
        remarks = matrix.refuse_inseparable(names, own)
        matrix.refuse_unmoved(columns, names)
        coupling = matrix.coupling_by_plays(columns)
    # Axes and coupling are identified in turn until the matrix settles.
    for passes in range(1, _MOST_PASSES + 1):
        used = coupling.matrix
        fits = _axis_fits(training, held_out, used, options, lambda words, turn=passes: report(f"pass {turn}, {words}"))  # type: ignore[misc]
        if any(fit.actuator is None for fit in fits):
            nothing = np.zeros_like(used)
            talk = CrossTalk(nothing, nothing, nothing, nothing.astype(bool))
            found = used, coupling.uncertainty, coupling.share, talk
            return StageFit(None, fits, *found, (), own, passes, tuple(remarks), names)
        traces = [matrix.AxisTraces.of(record, fits, k, used) for k, record in enumerate(training)]
        refined = matrix.coupling_by_models(traces, coupling.share)
        change = np.abs(refined.matrix - used) * strokes[None, :] / strokes[:, None]
        settled = change.max() <= _SETTLED
        coupling = replace(refined, matrix=used) if settled else refined
        if settled:
            break
    final = coupling.matrix
    report("what is left of the coupling")
    talk = cross_talk(columns, traces, final, strokes)
    traces += [matrix.AxisTraces.of(one, fits, k, used) for k, one in enumerate(held_out, len(training))]
    roles = ["training"] * len(training) + ["validation"] * len(held_out)
    errors = [e for one, role in zip(traces, roles, strict=True) for e in _errors(one, role, final, strokes)]
    stage = Stage(
        tuple(fit.actuator for fit in fits),
        final,
        names,
        provenance={
            "dehyst": __version__,
            "records": [{"name": one.name, **one.meta} for one in training],
            "passes": passes,
            "coupling_uncertainty": coupling.uncertainty.tolist(),
        },
        is_matrix=not bool(talk.beyond.any()),
        recorded_columns=tuple(training[0].meta.get("axes", ())),
    )
    remarks += talk.sentences(names)
    parts = final, coupling.uncertainty, coupling.share, talk, tuple(errors), own, passes
    return StageFit(stage, fits, *parts, tuple(remarks), names)


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


def _errors(traces: matrix.AxisTraces, role: str, coupling: Array, strokes: Array) -> list[AxisError]:
    """Return the error of each axis; before it first moved, no model of it says anything."""
    residual = traces.residual(coupling)
    known = np.isfinite(residual).all(axis=1)
    errors = []
    for i, axis in enumerate(traces.record.axes):
        left = residual[known & ~traces.standing[:, i], i]
        if left.size:
            numbers = rms(left), largest(left), float(strokes[i]), left.size, len(residual) - left.size
            errors.append(AxisError(traces.record.name, role, axis, *numbers))
    return errors


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
