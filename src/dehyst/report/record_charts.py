"""Charts of the records of a fit: before and after, loops off a straight line, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dehyst._types import Array
from dehyst.model import Fit, Trace
from dehyst.records.signals import white_noise
from dehyst.report.charts import Axis, Chart, Colour, Series
from dehyst.report.html import Charts, number
from dehyst.report.plots import length_unit, rising

Indices: TypeAlias = NDArray[np.intp]

MOST_RECORDS = 6
# Samples that are drawn of all records together.
MOST_SAMPLES = 20_000
_BINS = 40
_FEWEST_IN_BIN = 5
# The noise band holds 95 % of the samples of a perfect model.
_DEVIATIONS = 2.0


def before_and_after(fit: Fit) -> Charts | str:
    """Return the error of a straight scale factor beside that of the model, on the first record not trained on."""
    shown = _shown(fit)
    if not shown:
        return ""
    trace = next((one for one in shown if one.role == "validation"), shown[0])
    stroke = _stroke(fit)
    off, slope = _off_line(trace, trace.measured)
    factor, unit = length_unit(float(np.ptp(trace.measured)))
    curves: tuple[tuple[str, Array, Colour], ...] = (
        ("straight scale factor", off, "without"),
        ("this model", trace.residual, "simulated"),
    )
    before, after = (float(np.abs(error).max()) for _, error, _ in curves)
    at = _drawn(trace, len(shown))
    series = tuple(
        Series(name, trace.simulated[at] * factor, _broken(trace, 100 * error / stroke)[at], colour)
        for name, error, colour in curves
    )
    chart = Chart(
        trace.record,
        trace.role,
        "Error of a straight scale factor and of the model, against displacement, of",
        Axis("displacement", unit),
        Axis("error", "% of stroke"),
        series,
        right=_right("error", stroke, before),
        zero=True,
    )
    gain = number(slope * 1e6)
    caption = (
        f"How far this record lies from the best straight scale factor, {gain} µm/V, and from the model: at most "
        f"{number(100 * before / stroke)} % of the stroke before and {number(100 * after / stroke)} % after. Drag over "
        "a part of a chart to enlarge it; double-click for the whole. The pointer reads out values."
    )
    return Charts("Before and after", caption, (chart,), wide=True)


def loops(fit: Fit) -> Charts | str:
    """Return the loops off a straight line, measured and simulated, so that hysteresis fills the height."""
    shown = _shown(fit)
    charts = []
    for trace in shown:
        factor, unit = length_unit(max(float(np.ptp(_off_line(trace, trace.measured)[0])), 1e-12))
        measured, slope = _off_line(trace, trace.measured)
        simulated = measured - trace.residual
        at = _drawn(trace, len(shown))
        voltage = trace.voltage[at]
        measured, simulated = (_broken(trace, y * factor)[at] for y in (measured, simulated))
        charts.append(
            Chart(
                trace.record,
                trace.role,
                "Deviation from a straight line, measured and simulated, of",
                Axis("voltage", "V"),
                Axis(f"off a line of {number(slope * 1e6)} µm/V", unit),
                (
                    Series("measured", voltage, measured, "measured", width=3, opacity=0.5),
                    Series("simulated", voltage, simulated, "simulated", width=1),
                ),
                zero=True,
            )
        )
    caption = (
        "Displacement minus a straight line, so that the hysteresis fills the height. Where the thin line (simulated) "
        "leaves the broad one (measured), the model is wrong; look at the turning points and at the minor loops."
    )
    return Charts("Loops, off a straight line", caption + _only(fit), tuple(charts)) if charts else ""


def residuals(fit: Fit) -> Charts | str:
    """Return the residuals of the records, in time and over displacement, all on one scale."""
    shown, stroke = _shown(fit), _stroke(fit)
    if not shown:
        return ""
    limit = 1.1 * max(float(np.abs(100 * trace.residual / stroke).max()) for trace in shown) or 1.0
    residuals = [_Residual(trace, stroke, limit, _drawn(trace, len(shown))) for trace in shown]
    charts = tuple(chart for one in residuals for chart in (one.in_time(), one.in_place()))
    caption = (
        "A slow trend in time is drift or creep. A mean (line) outside of the noise band, or a distance between the "
        "means of rising and falling branches, is a limit of the model. Grey parts of the time were not compared: "
        "they are listed under what was repaired or left out. All charts share one scale."
    )
    return Charts("Residuals: measured minus simulated", caption + _only(fit), charts)


@dataclass(frozen=True, eq=False)
class _Residual:
    """The residual of a trace: the stroke [m], the limit of its axis [% of stroke], and the samples to draw."""

    trace: Trace
    stroke: float
    limit: float
    drawn: Indices

    @cached_property
    def percent(self) -> Array:
        """In % of the stroke (n,)."""
        return 100 * self.trace.residual / self.stroke

    def in_time(self) -> Chart:
        """Draw it against time, the times that were not compared shaded."""
        time, percent = self.trace.time[self.drawn], self.percent[self.drawn]
        points = Series("residual", time, percent, "measured", "points", opacity=0.6, exact=True)
        keys = (("95 % of the noise", "band"), ("not compared", "shade"))
        return self._chart("time", Axis("time", "s"), (points,), keys, _left_out(self.trace))

    def in_place(self) -> Chart:
        """Draw it against displacement, rising and falling branches apart, with the means of bins."""
        factor, unit = length_unit(float(np.ptp(self.trace.measured)))
        place, up = self.trace.simulated * factor, rising(self.trace)
        clouds, means = [], []
        branches: tuple[tuple[Colour, NDArray[np.bool_]], ...] = (("rising", up), ("falling", ~up))
        for name, branch in branches:
            some = self.drawn[branch[self.drawn]]
            clouds.append(Series(name, place[some], self.percent[some], name, "points", 2.0, 0.45))
            means.append(Series(f"mean, {name}", *_means(place[branch], self.percent[branch]), name, width=2.4))
        keys = (("95 % of the noise", "band"),)
        return self._chart("displacement", Axis("displacement", unit), (*clouds, *means), keys)

    def _chart(
        self,
        against: str,
        x: Axis,
        series: tuple[Series, ...],
        keys: tuple[tuple[str, str], ...],
        shaded: Sequence[tuple[float, float]] = (),
    ) -> Chart:
        noise = _DEVIATIONS * 100 * white_noise(self.trace.residual) / self.stroke
        return Chart(
            self.trace.record,
            self.trace.role,
            f"Residual against {against} of",
            x,
            Axis("residual", "% of stroke", (-self.limit, self.limit)),
            series,
            right=_right("residual", self.stroke, self.limit * self.stroke / 100),
            shaded=shaded,
            band=(-noise, noise),
            zero=True,
            keys=keys,
        )


def _means(place: Array, values: Array) -> tuple[Array, Array]:
    """Return the middles and the mean values of bins of equal width; NaN where samples are too few."""
    if not place.size:
        return np.zeros(0), np.zeros(0)
    edges = np.linspace(place.min(), place.max(), _BINS + 1)
    inside = np.clip(np.searchsorted(edges, place, side="right") - 1, 0, _BINS - 1)
    counts = np.bincount(inside, minlength=_BINS)
    sums = np.bincount(inside, weights=values, minlength=_BINS)
    means = np.where(counts >= _FEWEST_IN_BIN, sums / np.maximum(counts, 1), np.nan)
    return 0.5 * (edges[1:] + edges[:-1]), means


def _off_line(trace: Trace, y: Array) -> tuple[Array, float]:
    """Return a displacement less its best straight line over voltage [m], and the slope of that [m/V]."""
    if float(np.ptp(trace.voltage)) == 0.0:
        return y - y.mean(), 0.0
    voltage = trace.voltage - trace.voltage.mean()
    slope = float(voltage @ (y - y.mean()) / (voltage @ voltage))
    return y - y.mean() - slope * voltage, slope


def _left_out(trace: Trace) -> list[tuple[float, float]]:
    """Return the parts of the time that were not compared: the time before the first sample, and gaps."""
    steps = np.diff(trace.time)
    cuts = np.flatnonzero(steps > 3 * np.median(steps)) if steps.size else np.zeros(0, np.intp)
    parts = [(float(trace.time[i]), float(trace.time[i + 1])) for i in cuts]
    return [(trace.began, float(trace.time[0])), *parts] if trace.began < trace.time[0] else parts


def _broken(trace: Trace, values: Array) -> Array:
    """Return values with the last one before a gap missing, so that no line crosses it."""
    steps = np.diff(trace.time)
    out = np.array(values, dtype=np.float64)
    if steps.size:
        out[:-1][steps > 3 * np.median(steps)] = np.nan
    return out


def _drawn(trace: Trace, records: int) -> Indices:
    """Return the samples of one of so many records that are drawn."""
    most = MOST_SAMPLES // records
    size = trace.time.size
    return np.arange(size) if size <= most else np.unique(np.linspace(0, size - 1, most).astype(np.intp))


def _right(quantity: str, stroke: float, largest: float) -> tuple[float, str, str]:
    """Return the second axis for errors in % of the stroke."""
    factor, unit = length_unit(largest)
    return factor * stroke / 100, quantity, unit


def _shown(fit: Fit) -> list[Trace]:
    """Return the traces to draw."""
    return [trace for trace in fit.traces if trace.time.size > 1][:MOST_RECORDS]


def _stroke(fit: Fit) -> float:
    """Return the stroke [m] to which percentages refer."""
    if fit.errors:
        return fit.errors[0].stroke
    return max((float(np.ptp(trace.measured)) for trace in fit.traces if trace.time.size), default=0.0) or 1.0


def _only(fit: Fit) -> str:
    if len(fit.traces) <= MOST_RECORDS:
        return ""
    return f" The first {MOST_RECORDS} of {len(fit.traces)} records are drawn; the table of errors lists all."
