"""A function for each chart: pages and `plot` methods draw the same charts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst.control import PathPlan
from dehyst.identification import Fit, Trace
from dehyst.model import Actuator, creep_times, slow_motion, step_response, turned, voltages_of
from dehyst.records import Record, largest, of_one_axis, white_noise
from dehyst.report.charts import Axis, Chart, Colour, Series, broken, gaps, stems
from dehyst.report.html import length_unit, number
from dehyst.trust import Insight, Recheck, Turn, TurnPlane

if TYPE_CHECKING:
    from dehyst.calibration import TrackedPath

VOLTAGE, TIME = Axis("voltage", "V"), Axis("time", "s")
_PERCENT = "% of stroke"
_BINS = 40
_FEWEST_IN_BIN = 5
# The noise band holds 95 % of the samples of a perfect model.
_DEVIATIONS = 2.0


def record_loop(record: Record) -> Chart:
    """Return the displacement of a record of one axis over its voltage."""
    of_one_axis(record)
    factor, unit = length_unit(record.stroke)
    series = _with_events(record, record.voltage, record.displacement * factor)
    return Chart(record.name, VOLTAGE, Axis("displacement", unit), series)


def record_in_time(record: Record) -> list[Chart]:
    """Return voltage and displacement of a record of one axis over time, and its signal of fringes, if any."""
    of_one_axis(record)
    factor, unit = length_unit(record.stroke)
    quantities = [(record.voltage, VOLTAGE), (record.displacement * factor, Axis("displacement", unit))]
    quantities += [(own.values, Axis("signal", own.unit)) for own in record.others if own.name == "signal"]
    return [Chart(record.name, TIME, y, _with_events(record, record.time, values)) for values, y in quantities]


def _with_events(record: Record, x: Array, y: Array) -> list[Series]:
    """Return a line through all samples, and points at events."""
    line, at = Series("", x, broken(record.time, y), "measured"), record.measured
    return [line] if at is None else [line, Series("events", x[at], y[at], "simulated", "points", 4.0)]


def actuator_loops(found: Actuator) -> Chart:
    """Return the major loop and inner loops of an actuator in slow motion."""
    factor, unit = length_unit(float(np.ptp(found.spring.displacement)))
    low, high = voltages_of(found)
    peaks = low + np.array([1.0, 0.8, 0.6, 0.4, 0.2]) * (high - low)
    loops = [np.concatenate([np.linspace(low, peak, 200), np.linspace(peak, low, 200)]) for peak in peaks]
    rest = turned(found, float(found.spring.displacement[-1]))
    motion = slow_motion(found, np.concatenate([[high, low], *loops]), rest)
    parts = list(zip(loops, np.split(motion.displacement[2:] * factor, len(loops)), strict=True))
    series = [Series("major loop", *parts[0], "measured", width=1.9)]
    series += [Series("inner loops", *part, "falling", width=1.1) for part in parts[1:]]
    return Chart(found.name, VOLTAGE, Axis("displacement", unit), series)


def elements(actuator: Actuator) -> Chart:
    """Return the stiffness of each slip element over its breakaway elongation; for graded elements the largest."""
    slip = actuator.slip
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho, stiffness = slip.breakaway * factor, slip.friction / slip.breakaway * 1e-6
    series = [*stems("", rho, stiffness, "measured"), Series("", rho, stiffness, "measured", "points", 5)]
    axes = Axis("breakaway elongation", unit, _from_zero(rho)), Axis("stiffness", "V/µm", _from_zero(stiffness))
    return Chart("Slip elements", *axes, series)


def creep(actuator: Actuator) -> Chart:
    """Return the displacement after a sudden rise through all voltages, with the time constants marked."""
    if not creep_times(actuator).size:
        raise ModelError(argument="kind", got="'creep' of a model without creep", need="a model with creep")
    time, share = step_response(actuator)
    top = max(1.25 * 100 * float(share.max()), 1e-9)
    found = actuator.displacement_creep
    constants = np.empty(0) if found is None else found.time_constants[found.gains > 0]
    marks = stems("time constants", constants, np.full(constants.shape, top), "simulated", width=1)
    x = Axis("time since the rise", "s", (float(time[0]), float(time[-1])), log=True)
    y = Axis("further displacement", "% of the rise", (0.0, top))
    return Chart("Creep after a sudden rise", x, y, [Series("creep", time, 100 * share, "measured", width=1.8), *marks])


def _from_zero(values: Array) -> tuple[float, float]:
    return 0.0, 1.1 * float(values.max()) if values.any() else 1.0


def before_and_after(trace: Trace, stroke: float) -> Chart:
    """Return the errors of the best straight scale factor and of the model [% of the stroke in m]."""
    (off,), _ = off_line([trace])
    factor, unit = length_unit(float(np.ptp(trace.measured)))
    place = trace.simulated * factor
    before, after = (broken(trace.time, 100 * error / stroke) for error in (off, trace.residual))
    series = [Series("straight scale factor", place, before, "without")]
    series.append(Series("this model", place, after, "simulated"))
    axes = Axis("displacement", unit), Axis("error", _PERCENT)
    return Chart(trace.record, *axes, series, trace.role, _in_metres("error", stroke, largest(off)), zero=True)


def loops(traces: Sequence[Trace]) -> Chart:
    """Return measured and simulated displacement over voltage."""
    return _both(traces, [trace.measured for trace in traces], "displacement")


def hysteresis(traces: Sequence[Trace]) -> Chart:
    """Return the loops minus the best straight line through all measured loops."""
    measured, slope = off_line(traces)
    return replace(_both(traces, measured, f"displacement minus a line of {number(slope * 1e6)} µm/V"), zero=True)


def _both(traces: Sequence[Trace], measured: Sequence[Array], quantity: str) -> Chart:
    """Return a chart over voltage of measured and simulated displacement; these differ by the residual."""
    factor, unit = length_unit(max(*(float(np.ptp(y)) for y in measured), 1e-12))
    dots, lines = [], []
    for trace, shown in zip(traces, measured, strict=True):
        first, second = (broken(trace.time, length * factor) for length in (shown, shown - trace.residual))
        dots.append(Series("measured", trace.counted.voltage, first[_counts(trace)], "measured", "points", 3, 0.5))
        lines.append(Series("simulated", trace.voltage, second, "simulated", width=1.2))
    return Chart(traces[0].record, VOLTAGE, Axis(quantity, unit), [*dots, *lines], role=traces[0].role)


def _counts(trace: Trace) -> Any:
    """Return the index of the samples that count."""
    return slice(None) if trace.counts is None else trace.counts


def off_line(traces: Sequence[Trace]) -> tuple[list[Array], float]:
    """Return measured displacements minus their best straight line over voltage [m], and its slope [m/V]."""
    voltage, y = np.hstack([(trace.voltage, trace.measured) for trace in (each.counted for each in traces)])
    middle, rest = voltage.mean(), y.mean()
    slope = float((voltage - middle) @ (y - rest) / max((voltage - middle) @ (voltage - middle), 1e-300))
    return [trace.measured - rest - slope * (trace.voltage - middle) for trace in traces], slope


def residual_in_time(traces: Sequence[Trace], stroke: float, limit: float | None = None) -> Chart:
    """Return residuals [% of the stroke in m] over time; for one record, times that were not compared are shaded."""
    colours: tuple[Colour, ...] = ("measured", "simulated", "rising", "falling")
    alone, series = len(traces) == 1, []
    for trace, colour in zip(traces, cycle(colours)):
        name, y = "residual" if alone else trace.record, 100 * trace.residual / stroke
        series.append(Series(name, trace.time, broken(trace.time, y), colour, width=1))
    chart = _residual(traces, TIME, series, stroke, limit)
    left_out = _left_out(traces[0]) if alone else []
    return replace(chart, shaded=left_out, notes=(*chart.notes, *[("not compared", "shade")] * bool(left_out)))


def residual_over_displacement(traces: Sequence[Trace], stroke: float, limit: float | None = None) -> Chart:
    """Return residuals [% of the stroke in m] over displacement, by branch, with the means of bins."""
    factor, unit = length_unit(max(float(np.ptp(trace.measured)) for trace in traces))
    place = np.concatenate([trace.counted.simulated * factor for trace in traces])
    off = np.concatenate([100 * trace.counted.residual / stroke for trace in traces])
    up = np.concatenate([_rising(trace) for trace in traces])
    clouds, means = [], []
    branches: tuple[tuple[Colour, Mask], ...] = (("rising", up), ("falling", ~up))
    for name, branch in branches:
        clouds.append(Series(name, place[branch], off[branch], name, "points", 2.0, 0.45))
        means.append(Series(name, *_means(place[branch], off[branch]), name, width=2.4))
    return _residual(traces, Axis("displacement", unit), [*clouds, *means], stroke, limit)


def _residual(traces: Sequence[Trace], x: Axis, series: Sequence[Series], stroke: float, limit: float | None) -> Chart:
    """Return a chart of residuals with the noise band, up to a `limit` [%] or to the largest residual."""
    noise = _DEVIATIONS * 100 * max(white_noise(trace.counted.residual) for trace in traces) / stroke
    most = max(largest(trace.counted.residual) for trace in traces) if limit is None else limit * stroke / 100
    y = Axis("residual", _PERCENT, None if limit is None else (-limit, limit))
    right, notes = _in_metres("residual", stroke, most), [("95 % of the noise", "band")]
    chart = Chart(traces[0].record, x, y, series, traces[0].role, right, zero=True, notes=notes)
    return replace(chart, band=(-noise, noise))


def _rising(trace: Trace) -> Mask:
    """Return whether each sample that counts lies on a rising branch; a hold belongs to the branch before it."""
    # The simulated displacement moves in the direction of the voltage, and rests when the voltage rests.
    sign = np.sign(np.diff(trace.simulated, prepend=trace.simulated[:1]))
    last = np.maximum.accumulate(np.where(sign != 0, np.arange(sign.size), 0))
    return np.asarray(np.asarray(sign[last] >= 0)[_counts(trace)])


def _means(place: Array, values: Array) -> tuple[Array, Array]:
    """Return the centres and the mean values of bins of equal width; NaN for bins with too few samples."""
    if not place.size:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(place.min(), place.max(), _BINS + 1)
    inside = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(inside, minlength=_BINS)
    sums = np.bincount(inside, weights=values, minlength=_BINS)
    means = np.where(counts >= _FEWEST_IN_BIN, sums / np.maximum(counts, 1), np.nan)
    return 0.5 * (edges[1:] + edges[:-1]), means


def _left_out(trace: Trace) -> list[tuple[float, float]]:
    """Return the parts of the time that were not compared: the time before the first sample, and gaps."""
    parts = [(float(trace.time[i]), float(trace.time[i + 1])) for i in gaps(trace.time)]
    return [(trace.began, float(trace.time[0])), *parts] if trace.began < trace.time[0] else parts


def _in_metres(quantity: str, stroke: float, most: float) -> tuple[float, str, str]:
    """Return the second axis for errors in % of the stroke."""
    factor, unit = length_unit(most)
    return factor * stroke / 100, quantity, unit


def planned_path(plan: PathPlan) -> Chart:
    """Return the wanted path of a plan."""
    (axis, x), wanted = _clock(plan), plan.displacement[plan.first :]
    factor, unit = length_unit(float(np.ptp(wanted)))
    return Chart("Path", axis, Axis("displacement", unit), [Series("", x, wanted * factor, "ink", width=1.8)])


def planned_voltage(plan: PathPlan) -> Chart:
    """Return the voltage along a planned path, and its clamped samples."""
    (axis, x), volts, clamped = _clock(plan), plan.voltage[plan.first :], plan.clamped[plan.first :]
    series = [Series("voltage", x, volts, "measured")]
    if clamped.any():
        series.append(Series("clamped", x[clamped], volts[clamped], "simulated", "points", width=3))
    return Chart("Voltage", axis, Axis("voltage", "V"), series)


def error_band(plan: PathPlan) -> Chart:
    """Return the promised error along a planned path [% of the stroke]; empty without a promise."""
    axis, x = _clock(plan)
    missed, promise = (plan.expected - plan.displacement)[plan.first :], plan.promise
    series = []
    if promise is not None:
        low, high = (100 * (missed + sign * promise.half) / promise.stroke for sign in (-1, 1))
        series = [Series("promise", x, low, "measured", "area", opacity=0.3, top=high)]
    return Chart("Error", axis, Axis("error", _PERCENT), series, zero=True)


def _clock(plan: PathPlan) -> tuple[Axis, Array]:
    """Return time, or the number of each sample if no time was given."""
    if plan.time is None:
        return Axis("sample"), np.arange(plan.voltage.size - plan.first, dtype=np.float64)
    return TIME, plan.time[plan.first :] - plan.time[plan.first]


def followed_path(followed: Mapping[str, TrackedPath]) -> list[Chart]:
    """Return the wanted and the reached path, and the errors on another scale."""
    first = next(iter(followed.values()))
    factor, unit = length_unit(first.stroke)
    colours: tuple[Colour, ...] = ("simulated", "measured")
    reached, errors = [], []
    for (name, path), colour in zip(followed.items(), colours, strict=False):
        reached.append(Series(name, path.time, path.reached * factor, colour))
        error = Series("", path.time, 100 * path.error / path.stroke, colour)
        errors.append(Chart(f"Error, {name}", TIME, Axis("error", _PERCENT), [error], zero=True))
    wanted = Series("wanted", first.time, first.wanted * factor, "ink", width=1, dashed=True)
    return [Chart("Path", TIME, Axis("displacement", unit), [*reached, wanted]), *errors]


def turning_points(plane: TurnPlane, path: Sequence[Turn] = ()) -> Chart:
    """Return the plane of turning points with the tested cells, and the turning points of a path."""
    ends, cells = plane.edges[[0, -1]], plane.cells.astype(np.float64)
    series = [
        Series("", plane.edges, plane.edges, "tested", "cells", values=cells, darkest=3.0),
        Series("", ends, ends, "without", width=1),
        *_dots("records", plane.turns, "measured", 5),
        *_dots("this path", path, "simulated", 8),
    ]
    edge = 0.03 * float(np.ptp(ends))
    shown = float(ends[0]) - edge, float(ends[1]) + edge
    x, y = (Axis(f"{which} turning point", "V", shown) for which in ("lower", "upper"))
    notes = [("tested; paler: only one branch of the loop", "tested")]
    return Chart("Turning points", x, y, series, notes=notes)


def _dots(name: str, turns: Sequence[Turn], colour: Colour, width: float) -> list[Series]:
    """Return a dot for each turn."""
    if not turns:
        return []
    lower, upper = np.sort([(turn.begin, turn.end) for turn in turns]).T
    return [Series(name, lower, upper, colour, "points", width, names=tuple(turn.words for turn in turns))]


def stroke_of(fit: Fit) -> float:
    """Return the stroke [m] to which percentages refer."""
    if fit.errors:
        return fit.errors[0].stroke
    return max((float(np.ptp(trace.measured)) for trace in fit.traces if trace.time.size), default=0.0) or 1.0


def _traced(found: Fit | Recheck) -> tuple[list[Trace], float]:
    """Return the traces of a fit or a check, and the stroke [m] of its percentages."""
    if isinstance(found, Recheck):
        return [found.trace], found.stroke
    traces = [trace for trace in found.traces if trace.time.size]
    if not traces:
        need = f"an identified fit; this one ended with: {found.outcome.value}"
        raise ModelError(argument="plot", got="a fit without traces", need=need)
    return traces, stroke_of(found)


def _planned(found: Insight) -> Chart:
    if found.plan is None:
        raise ModelError(argument="kind", got="'band' without a path", need="an insight of a path: give plan=")
    return error_band(found.plan)


def _turns(found: Insight) -> Chart:
    if (plane := found.turns) is None:
        raise ModelError(argument="kind", got="'turns' of records that never turn", need="records with loops")
    return turning_points(plane)


_TRACES: Mapping[str, Callable[[Any], Chart]] = {
    "loops": lambda found: loops(_traced(found)[0]),
    "hysteresis": lambda found: hysteresis(_traced(found)[0]),
    "residuals": lambda found: residual_over_displacement(*_traced(found)),
    "residuals in time": lambda found: residual_in_time(*_traced(found)),
}
# The pictures of each class by kind, the default first.
KINDS: Mapping[str, Mapping[str, Callable[[Any], Chart]]] = {
    "Record": {"loop": record_loop, "time": lambda record: record_in_time(record)[1]},
    "Actuator": {"loop": actuator_loops, "elements": elements, "creep": creep},
    "Fit": _TRACES,
    "Recheck": {"hysteresis": _TRACES["hysteresis"], **_TRACES},
    "Insight": {"turns": _turns, "band": _planned},
}
