"""Pictures of records, actuators, fits and assessments on axes: what their `plot` methods draw."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from dehyst._errors import DehystError, MissingExtraError, ModelError, RecordError
from dehyst._text import escaped
from dehyst._types import Array
from dehyst._validation import choice
from dehyst.identification import Fit, Trace
from dehyst.model import Actuator, GradedSlip, State
from dehyst.records import Record
from dehyst.report.plots import (
    FALLING,
    INK,
    MEASURED,
    RISING,
    draw_both,
    draw_creep,
    draw_slopes,
    length_unit,
    points,
    rising,
    some_samples,
    stems,
    thinned,
)
from dehyst.report.uncertainty_section import (
    draw_band,
    draw_loop_interval,
    draw_singular_values,
    draw_stiffness_intervals,
)
from dehyst.trust import Insight

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Thing = TypeVar("Thing")
_VOLTAGE = "#999999"
# Of the loops of an actuator: their tops as parts of the largest one, and samples of a leg.
_TOPS, _LEG = (0.8, 0.6, 0.4, 0.2), 200


def record(found: Record, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a record; `kind` is "loop" or "time"."""
    return _drawn(found, {"loop": _record_loop, "time": _record_in_time}, kind, ax, found.name, RecordError)


def actuator(found: Actuator, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an actuator; `kind` as in `Actuator.plot`."""
    kinds = {
        "loop": _actuator_loops,
        "elements": _elements,
        "spring": _spring,
        "slopes": lambda ax, found: draw_slopes(ax, found.slip, found.spring),
        "creep": draw_creep,
    }
    if kind == "creep" and not found.creep:
        raise ModelError(
            f"got 'creep' of an actuator without creep, '{found.name}'", argument="kind", hint="try 'loop'"
        )
    return _drawn(found, kinds, kind, ax, found.name, ModelError)


def fit(found: Fit, kind: str | None, ax: Axes | None) -> Axes:
    """Draw a fit; `kind` as in `Fit.plot`."""
    kinds = {
        "loops": _loops,
        "hysteresis": _hysteresis,
        "residuals": _residuals,
        "residuals in time": _residuals_in_time,
    }
    if not any(trace.time.size for trace in found.traces):
        raise ModelError(f"plot: got a fit without traces, need an identified one; it ended so: {found.outcome.value}")
    return _drawn(found, kinds, kind, ax, ", ".join(trace.record for trace in found.traces[:3]), ModelError)


def insight(found: Insight, kind: str | None, ax: Axes | None) -> Axes:
    """Draw an assessment; `kind` as in `Insight.plot`."""
    kinds: dict[str, Callable[[Axes, Insight], None]] = {
        "directions": lambda ax, found: draw_singular_values(ax, found.identifiability)
    }
    if found.loop is not None:
        kinds["loop"] = draw_loop_interval
    if found.feasible_set is not None or (found.intervals is None and not found.actuator.wide):
        kinds["stiffnesses"] = draw_stiffness_intervals
    if (band := found.band) is not None:
        kinds["band"] = lambda ax, found: draw_band(ax, band, found.evidence.stroke)
    return _drawn(found, kinds, kind or list(kinds)[-1], ax, found.actuator.name, ModelError)


def _drawn(
    found: Thing,
    kinds: Mapping[str, Callable[[Axes, Thing], None]],
    kind: str | None,
    ax: Axes | None,
    title: str,
    error: type[DehystError],
) -> Axes:
    """Draw one kind of picture on axes, or on those of a new figure."""
    name = next(iter(kinds)) if kind is None else kind
    choice(name, "kind", tuple(kinds), error=error)
    axes = _new_axes() if ax is None else ax
    kinds[name](axes, found)
    if not axes.get_title():
        axes.set_title(_words(title))
    return axes


def _new_axes() -> Axes:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtraError.of("matplotlib", "report", "Drawing") from error
    axes: Axes = pyplot.subplots(layout="constrained")[1]
    axes.grid(color="#ECECEC", lw=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return axes


def _words(name: str) -> str:
    """Return a name as plain text: no formula, no hidden label, and not too long."""
    text = escaped(name)
    text = text if len(text) <= 60 else f"{text[:57]}..."
    return f"{' ' if text.startswith('_') else ''}{text}".replace("$", r"\$")


def _record_loop(ax: Axes, found: Record) -> None:
    factor, unit = length_unit(found.stroke)
    v, y = thinned(found.time, found.voltage, found.displacement * factor)
    ax.plot(v, y, color=MEASURED, lw=0.9)
    ax.set(xlabel="voltage (V)", ylabel=f"displacement ({unit})")


def _record_in_time(ax: Axes, found: Record) -> None:
    factor, unit = length_unit(found.stroke)
    right: Any = ax.twinx()
    right.plot(*thinned(found.time, found.time, found.voltage), color=_VOLTAGE, lw=0.9)
    right.set_ylabel("voltage (V)", color="#666666")
    right.grid(visible=False)
    right.spines["right"].set_visible(True)
    ax.plot(*thinned(found.time, found.time, found.displacement * factor), color=MEASURED, lw=1.1)
    ax.set_xlabel("time (s)")
    ax.set_ylabel(f"displacement ({unit})", color=MEASURED)
    # The displacement is in front of the voltage.
    ax.set_zorder(right.get_zorder() + 1)
    ax.patch.set_visible(False)


def _actuator_loops(ax: Axes, found: Actuator) -> None:
    factor, unit = length_unit(float(np.ptp(found.spring.displacement)))
    low, high = found.voltage_range
    rest = found.turned(float(found.spring.displacement[-1]), extrapolate=True)
    bare = State(rest.displacement, rest.carts, (), (), rest.smooth)
    slow = replace(found, creep=None, dynamics=None, lag=0.0, state=bare)
    start = slow.simulate(np.array([high, low]), extrapolate=True).state
    for top, width, label in ((1.0, 1.4, "major loop"), *((part, 0.8, "inner loops") for part in _TOPS)):
        peak = low + top * (high - low)
        voltage = np.concatenate([np.linspace(low, peak, _LEG), np.linspace(peak, low, _LEG)])
        motion = slow.simulate(voltage, state=start, extrapolate=True)
        start = motion.state
        colour = MEASURED if top == 1 else FALLING
        shown = label if top in (1.0, _TOPS[0]) else None
        ax.plot(voltage, motion.displacement * factor, color=colour, lw=width, label=shown)
    ax.set(xlabel="voltage (V)", ylabel=f"displacement ({unit})")
    ax.legend(loc="upper left")


def _elements(ax: Axes, found: Actuator) -> None:
    slip = found.slip.stiffest() if isinstance(found.slip, GradedSlip) else found.slip
    factor, unit = length_unit(float(slip.breakaway[-1]))
    stems(ax, slip.breakaway * factor, slip.stiffness * 1e-6, "stiffness (V/µm)")
    ax.set_xlabel(f"breakaway elongation ({unit})")
    ax.set_xlim(0, 1.05 * float(slip.breakaway[-1]) * factor)


def _spring(ax: Axes, found: Actuator) -> None:
    spring = found.spring
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    ax.plot(spring.displacement * factor, spring.voltage, color=MEASURED, lw=1, marker="o", ms=2.6)
    ax.set(xlabel=f"displacement ({unit})", ylabel="spring voltage (V)")


def _loops(ax: Axes, found: Fit) -> None:
    factor, unit = _length_unit(found)
    for k, trace in enumerate(found.traces):
        draw_both(ax, trace, trace.measured * factor, trace.simulated * factor, labels=not k)
    ax.set(xlabel="voltage (V)", ylabel=f"displacement ({unit})")
    ax.legend(loc="upper left")


def _hysteresis(ax: Axes, found: Fit) -> None:
    voltage = np.concatenate([trace.voltage for trace in found.traces])
    slope, start = np.polyfit(voltage, np.concatenate([trace.measured for trace in found.traces]), 1)

    def off(trace: Trace, y: Array) -> Array:
        return np.asarray(y - start - slope * trace.voltage)

    factor, unit = length_unit(max(float(np.ptp(off(trace, trace.measured))) for trace in found.traces))
    for k, trace in enumerate(found.traces):
        curves = (off(trace, y) * factor for y in (trace.measured, trace.simulated))
        draw_both(ax, trace, *curves, labels=not k)
    ax.axhline(0, color=INK, lw=0.6)
    ax.set(xlabel="voltage (V)", ylabel=f"off a line of {slope * 1e6:.3g} µm/V ({unit})")
    _room_above(ax)
    ax.legend(loc="upper left", ncols=2)


def _residuals(ax: Axes, found: Fit) -> None:
    (factor, unit), (small, small_unit) = _length_unit(found), _residual_unit(found)
    measured = np.concatenate([trace.measured for trace in found.traces]) * factor
    residual = np.concatenate([trace.residual for trace in found.traces]) * small
    up, some = np.concatenate([rising(trace) for trace in found.traces]), some_samples(measured.size)
    for branch, colour, label in ((some & up, RISING, "rising"), (some & ~up, FALLING, "falling")):
        points(ax, measured[branch], residual[branch], colour, of=int(some.sum()), label=label)
    ax.axhline(0, color=INK, lw=0.6)
    ax.set(xlabel=f"displacement ({unit})", ylabel=f"measured minus simulated ({small_unit})")
    _legend_of_points(ax)


def _residuals_in_time(ax: Axes, found: Fit) -> None:
    small, unit = _residual_unit(found)
    for k, trace in enumerate(found.traces):
        points(ax, trace.time, trace.residual * small, f"C{k}", of=trace.time.size, label=_words(trace.record))
    ax.axhline(0, color=INK, lw=0.6)
    ax.set(xlabel="time (s)", ylabel=f"measured minus simulated ({unit})")
    _legend_of_points(ax)


def _legend_of_points(ax: Axes) -> None:
    """Set a legend above the points, with marks that can be seen."""
    _room_above(ax)
    legend = ax.legend(loc="upper left", ncols=3, handlelength=0.8)
    for handle in legend.legend_handles:
        if handle is not None:
            handle.set(alpha=1.0, markersize=6)


def _room_above(ax: Axes) -> None:
    """Leave room for a legend above what is drawn."""
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.15 * (high - low))


def _length_unit(found: Fit) -> tuple[float, str]:
    return length_unit(max(float(np.ptp(trace.measured)) for trace in found.traces))


def _residual_unit(found: Fit) -> tuple[float, str]:
    return length_unit(max(float(np.abs(trace.residual).max()) for trace in found.traces))
