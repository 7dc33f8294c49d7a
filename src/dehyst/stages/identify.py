"""Records of several axes to a stage: the coupling matrix, and the actuator of each axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from dehyst._errors import IdentifyError, RecordError
from dehyst._threads import one_thread
from dehyst._types import Array, Progress
from dehyst._version import __version__
from dehyst.identification import Fit, identify
from dehyst.records import Record
from dehyst.stages.coupling import (
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
from dehyst.stages.cross_talk import cross_talk
from dehyst.stages.fit import AxisError, CrossTalk, StageFit
from dehyst.stages.stage import Stage, apply, inverse

# Matrix and axes are identified in turn until the matrix moves no axis by more than this share of its stroke.
_MOST_PASSES, _SETTLED = 3, 2e-4
_SPANS = 24


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
