"""Plots of records, actuators, fits and assessments on axes, for their `plot` methods."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from dehyst._errors import DehystError, MissingExtraError, ModelError, RecordError
from dehyst._validation import choice
from dehyst.identification import Fit, Trace
from dehyst.model import Actuator, creep_times, slow_motion
from dehyst.records import Record, of_one_axis
from dehyst.report import fit_section, trust_section
from dehyst.report.actuator_section import creep_chart, element_charts, slopes_chart, spring_charts
from dehyst.report.charts import Axis, Chart, Series
from dehyst.report.html import length_unit
from dehyst.report.pages import loop_chart, time_charts
from dehyst.report.plots import MEASURED, draw_chart, plain
from dehyst.trust import Insight, Recheck

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Kinds: TypeAlias = "Mapping[str, Callable[[], Chart]]"


def record(found: Record, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a record of one axis; `kind` is "loop" or "time"."""
    of_one_axis(found)
    kinds = {"loop": lambda: loop_chart(found), "time": lambda: time_charts(found)[1]}
    axes = _drawn(kinds, kind, ax, found.name, RecordError)
    if kind == "time":
        _voltage_behind(axes, found)
    return axes


def actuator(found: Actuator, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an actuator; see `Plotted`."""
    kinds = {
        "loop": lambda: _actuator_loops(found),
        "elements": lambda: element_charts(found)[0],
        "spring": lambda: spring_charts(found.spring)[0],
        "slopes": lambda: slopes_chart(found),
        **({"creep": lambda: creep_chart(found)} if creep_times(found).size else {}),
    }
    return _drawn(kinds, kind, ax, found.name, ModelError)


def fit(found: Fit, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a fit; see `Plotted`."""
    traces = [trace for trace in found.traces if trace.time.size]
    if not traces:
        raise ModelError(f"plot: got a fit without traces, need an identified one; it ended so: {found.outcome.value}")
    kinds = _of_traces(traces, fit_section.stroke_of(found))
    return _drawn(kinds, kind, ax, ", ".join(trace.record for trace in traces[:3]), ModelError)


def recheck(found: Recheck, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a check; see `Plotted`."""
    return _drawn(_of_traces([found.trace], found.stroke), kind or "hysteresis", ax, found.record, ModelError)


def _of_traces(traces: Sequence[Trace], stroke: float) -> Kinds:
    return {
        "loops": lambda: fit_section.loops_chart(traces),
        "hysteresis": lambda: fit_section.hysteresis_chart(traces),
        "residuals": lambda: fit_section.residual_over_displacement(traces, stroke),
        "residuals in time": lambda: fit_section.residual_in_time(traces, stroke),
    }


def insight(found: Insight, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an assessment; see `Plotted`."""
    kinds = {"directions": lambda: trust_section.directions_chart(found.identifiability)}
    if (plan := found.plan) is not None:
        kinds["band"] = lambda: trust_section.band_chart(plan)
    return _drawn(kinds, kind or list(kinds)[-1], ax, found.actuator.name, ModelError)


def _drawn(kinds: Kinds, kind: str | None, ax: Axes | None, title: str, error: type[DehystError]) -> Axes:
    """Draw one kind of picture on axes, or on those of a new figure."""
    name = next(iter(kinds)) if kind is None else kind
    choice(name, "kind", tuple(kinds), error=error)
    axes = _new_axes() if ax is None else ax
    draw_chart(axes, kinds[name]())
    if not axes.get_title():
        axes.set_title(plain(title))
    return axes


def _new_axes() -> Axes:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError.of("matplotlib", "plot", "Drawing") from error
    axes: Axes = pyplot.subplots(layout="constrained", subplot_kw={"axisbelow": True})[1]
    axes.grid(color="#ECECEC", lw=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _voltage_behind(ax: Axes, found: Record) -> None:
    """Draw the voltage behind the displacement, on an axis of its own."""
    right: Any = ax.twinx()
    right.plot(found.time, found.voltage, color="#999999", lw=0.9)
    right.set_ylabel("voltage (V)", color="#666666")
    right.grid(visible=False)
    right.spines["right"].set_visible(True)
    ax.yaxis.label.set_color(MEASURED)
    ax.set_zorder(right.get_zorder() + 1)
    ax.patch.set_visible(False)


def _actuator_loops(found: Actuator) -> Chart:
    """Return the major loop and inner loops of an actuator, as slow motion draws them."""
    factor, unit = length_unit(float(np.ptp(found.spring.displacement)))
    low, high = found.voltage_range
    peaks = low + np.array([1.0, 0.8, 0.6, 0.4, 0.2]) * (high - low)
    loops = [np.concatenate([np.linspace(low, peak, 200), np.linspace(peak, low, 200)]) for peak in peaks]
    rest = found.turned(float(found.spring.displacement[-1]), extrapolate=True)
    motion = slow_motion(found, np.concatenate([[high, low], *loops]), rest)
    parts = list(zip(loops, np.split(motion.displacement[2:] * factor, len(loops)), strict=True))
    series = [Series("major loop", *parts[0], "measured", width=1.9)]
    series += [Series("inner loops", *part, "falling", width=1.1) for part in parts[1:]]
    return Chart(found.name, Axis("voltage", "V"), Axis("displacement", unit), series)
