"""Figs. 3 to 12 of the paper for a virtual actuator: drawings and their data."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._types import Array
from dehyst.report import plots
from dehyst.report.plots import INK, Drawing
from dehyst.studies.paper.experiment import DRIVE, ELEMENTS, ENERGISED, PEAKS, RELAXED, Experiment, midpoints
from dehyst.studies.paper.tables import physical, subscript

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CYCLE = int(2 * DRIVE.rate * DRIVE.half)
_GREY = "#8A8A8A"
_TRUE = {"color": plots.MEASURED, "lw": 2.6, "alpha": 0.4, "label": "measured"}
_LINES: dict[str, dict[str, Any]] = {
    "nominal": {"color": INK, "lw": 0.9, "ls": (0, (1, 1.2)), "label": "nominal ratio"},
    "goldfarb": {"color": "#AA4499", "lw": 0.9, "ls": (0, (6, 1.5, 1, 1.5)), "label": "Goldfarb"},
    "breakpoints": {"color": plots.SIMULATED, "lw": 1.0, "label": "paper's method"},
    "record": {"color": "#117733", "lw": 1.0, "ls": (0, (4, 1.5)), "label": "whole record"},
    "record_tops": {"color": plots.FALLING, "lw": 1.0, "ls": (0, (2, 1)), "label": "whole record, tops added"},
}
_DISPLACEMENT, _VOLTAGE, _TIME = "displacement (µm)", "voltage (V)", "time (s)"


@dataclass(frozen=True, eq=False)
class Plate:
    """A figure of the paper for the virtual actuator.

    `number`: the paper's. `wide`: whether it takes two columns of a journal. `data`: tables by suffix of the file's
    name ("" for the main one), each columns by name with their units; none of a schematic.
    """

    number: int
    title: str
    wide: bool
    drawing: Drawing
    data: Mapping[str, Mapping[str, Array]]

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"fig{self.number:02d}"


def plates(found: Experiment, symmetric: Experiment) -> Iterator[Plate]:
    """Draw each figure with data, from the virtual E-280.10 and the same without its asymmetric map.

    Raise `MissingExtraError` if matplotlib is not installed.
    """
    yield _typical_loop(found)
    yield _antisymmetry(found, symmetric)
    yield _break_points(found)
    yield _initial_states(found)
    yield _loops(found)
    yield _parallel_spring(found)
    yield _right_extreme(found)
    yield _control_voltages(found)
    yield _trajectories(found)
    yield _tracking_errors(found, symmetric)


def _plate(number: int, title: str, draw: Callable[..., None], data: Any, **layout: Any) -> Plate:
    wide = layout["size"][0] > plots.COLUMN
    drawing = plots.drawing(f"paper{number}", draw, **layout)
    tables = data if "" in data else {"": data}
    return Plate(number, title, wide, drawing, tables)


def _major(found: Experiment) -> tuple[Array, Array, Array]:
    record = found.runs[RELAXED.name].cut("major")
    return record.time, record.voltage, 1e6 * record.displacement


def _letter(ax: Axes, text: str) -> None:
    ax.set_title(text, loc="left", fontsize=8.5)


def _span(ax: Axes, x: float, one: float, other: float) -> None:
    """Draw a double arrow along the ordinate."""
    arrow = {"arrowstyle": "<->", "lw": 0.8, "color": INK, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (x, one), (x, other), arrowprops=arrow)


def _legend_above(ax: Axes) -> None:
    """Set a legend above all axes, for where it would hide data inside."""
    handles, labels = ax.get_legend_handles_labels()
    ax.figure.legend(handles, labels, loc="outside upper center", ncols=2, columnspacing=1.2, handlelength=2.0)


def _typical_loop(found: Experiment) -> Plate:
    time, v, y = _major(found)
    half = _CYCLE // 2

    def draw(ax: Axes) -> None:
        plots.line(ax, v[: half + 1], y[: half + 1], color=_GREY, lw=1.0, ls=(0, (4, 1.5)), label="first rise")
        plots.line(
            ax, v[half : half + _CYCLE + 1], y[half : half + _CYCLE + 1], color=plots.MEASURED, lw=1.2, label="loop"
        )
        for k in (int(0.72 * _CYCLE), int(1.26 * _CYCLE)):
            arrow = {"arrowstyle": "-|>", "color": plots.MEASURED, "lw": 1.0}
            ax.annotate("", (v[k + 12], y[k + 12]), (v[k - 12], y[k - 12]), arrowprops=arrow)
        ax.set(xlabel=_VOLTAGE, ylabel=_DISPLACEMENT, xlim=(-5, 207))
        ax.legend(loc="upper left")

    data = {"time_s": time, "voltage_V": v, "displacement_um": y}
    return _plate(3, "A typical hysteresis loop", draw, data, size=(plots.COLUMN, 2.7))


def _antisymmetry(found: Experiment, symmetric: Experiment) -> Plate:
    _, v, y = _major(found)
    loop = found.loops[0]
    v, y = v[-_CYCLE - 1 :], y[-_CYCLE - 1 :]
    peak, ends = PEAKS["major"], 1e6 * (loop.bottom + loop.top)
    pairs = np.arange(1, ELEMENTS)
    off, off_symmetric = midpoints(found), midpoints(symmetric)

    def draw(left: Axes, right: Axes) -> None:
        plots.line(left, v, y, color=plots.MEASURED, lw=1.2, label="loop")
        plots.line(left, peak - v, ends - y, color=plots.SIMULATED, lw=0.9, ls=(0, (4, 1.5)), label="turned by 180°")
        for branch, face in ((loop.descending, INK), (loop.ascending, "white")):
            left.plot(branch[1:-1, 1], 1e6 * branch[1:-1, 0], ls="none", marker="o", ms=3, mfc=face, mec=INK, mew=0.7)
        left.plot(peak / 2, ends / 2, marker="+", ms=9, mew=1.1, color=INK, ls="none", label="centre")
        left.set(xlabel=_VOLTAGE, ylabel=_DISPLACEMENT)
        left.legend(loc="upper left")
        _letter(left, "(a)")
        right.axhline(0, color=INK, lw=0.6)
        right.plot(pairs, off, marker="o", ms=4, lw=0.8, color=plots.MEASURED, label="virtual E-280.10")
        hollow: dict[str, Any] = {
            "marker": "s",
            "ms": 3.4,
            "lw": 0.8,
            "ls": (0, (4, 1.5)),
            "mfc": "white",
            "color": plots.FALLING,
        }
        right.plot(pairs, off_symmetric, label="without its asymmetric map", **hollow)
        right.set(xlabel="pair of break points i", ylabel="midpoint less v₀/2 (V)", ylim=(None, 1.45 * off.max() + 0.5))
        right.set_xticks(pairs)
        right.legend(loc="upper right")
        _letter(right, "(b)")

    data = {
        "": {"voltage_V": v, "displacement_um": y, "turned_voltage_V": peak - v, "turned_displacement_um": ends - y},
        "-midpoints": {"i": pairs, "off_V": off, "without_map_off_V": off_symmetric},
    }
    return _plate(4, "Anti-symmetry", draw, data, size=(plots.PAGE, 2.9), columns=2)


def _break_points(found: Experiment) -> Plate:
    _, v, y = _major(found)
    v, y = v[-_CYCLE - 1 :], y[-_CYCLE - 1 :]
    loop = found.loops[0]
    down, up = (np.column_stack([1e6 * b[:, 0], b[:, 1]]) for b in (loop.descending, loop.ascending))
    step = 1e6 * loop.range / ELEMENTS
    marked = 4

    def draw(ax: Axes) -> None:
        plots.line(ax, v, y, color=plots.MEASURED, lw=3, alpha=0.35, label="measured loop")
        for branch, face, name in ((down, INK, "descending"), (up, "white", "ascending")):
            style: dict[str, Any] = {"color": INK, "lw": 0.8, "marker": "o", "ms": 3.6, "mfc": face, "mew": 0.8}
            ax.plot(branch[:, 1], branch[:, 0], label=f"break points, {name}", **style)
        for i, (place, _) in enumerate(down):
            ax.plot((-22, 222), (place, place), color="#D0D0D0", lw=0.5, zorder=0)
            if 0 < i < ELEMENTS:
                ax.text(224, place, f"Y{subscript(i)}", va="center", fontsize=8)
        for branch, word, offset, side in ((down, "v↓", (-5, 3), "right"), (up, "v↑", (6, -8), "left")):
            for i in range(1, ELEMENTS):
                place = branch[i, 1], branch[i, 0]
                ax.annotate(f"{word}{subscript(i)}", place, offset, textcoords="offset points", ha=side, fontsize=8)
        _span(ax, 213, down[marked, 0], down[marked + 1, 0])
        ax.text(210, down[marked, 0] - step / 2, f"2δ keq/km = {step:.3f} µm", ha="right", va="center", fontsize=8)
        ax.annotate(
            "y(T₀/2), v₀", (down[0, 1], down[0, 0]), (-6, 5), textcoords="offset points", ha="right", fontsize=8
        )
        ax.annotate("y(T₀)", (up[0, 1], up[0, 0]), (-6, -3), textcoords="offset points", ha="right", fontsize=8)
        ax.set(xlabel=_VOLTAGE, ylabel=_DISPLACEMENT, xlim=(-22, 236), ylim=(y.min() - 1, y.max() + 1.6))
        ax.set_xticks(np.arange(0, 201, 25))
        ax.grid(visible=False)
        ax.legend(loc="upper left", frameon=True, framealpha=1.0, edgecolor="none")

    number = np.arange(ELEMENTS + 1.0)
    data = {
        "": {"voltage_V": v, "displacement_um": y},
        "-break-points": {
            "i": number,
            "descending_displacement_um": down[:, 0],
            "descending_voltage_V": down[:, 1],
            "ascending_displacement_um": up[:, 0],
            "ascending_voltage_V": up[:, 1],
        },
    }
    return _plate(5, "Break points and segments", draw, data, size=(plots.PAGE, 4.2))


def _initial_states(found: Experiment) -> Plate:
    runs = {start.name: found.runs[start.name].cut("major") for start in (RELAXED, ENERGISED)}
    v = runs[RELAXED.name].voltage
    relaxed, energised = (1e6 * record.displacement for record in runs.values())
    moved, half = energised - relaxed, _CYCLE // 2
    measured = 1e6 * found.shift.loop
    predicted = {key: 1e6 * found.trials[key].shift for key in ("breakpoints", "record_tops")}

    def draw(left: Axes, right: Axes) -> None:
        plots.line(left, v, relaxed, color=plots.MEASURED, lw=1.2, label="relaxed")
        plots.line(left, v, energised, color=plots.SIMULATED, lw=1.0, ls=(0, (4, 1.5)), label="pre-energised at 100 V")
        left.set(xlabel=_VOLTAGE, ylabel=_DISPLACEMENT)
        left.legend(loc="upper left")
        _letter(left, "(a)")
        plots.line(right, v[: half + 1], moved[: half + 1], color=_GREY, lw=1.0, label="measured, first rise")
        plots.line(
            right, v[half:], moved[half:], color=plots.MEASURED, lw=2.4, alpha=0.6, label="measured, from T₀/2 on"
        )
        for key, value in predicted.items():
            style = {**_LINES[key], "label": f"Eq. 10, {_LINES[key]['label']}"}
            right.axhline(value, **style)
        right.set(xlabel=_VOLTAGE, ylabel="pre-energised less relaxed (µm)", ylim=(measured - 0.25, 0.25))
        right.legend(loc="upper right")
        _letter(right, "(b)")

    data = {"time_s": runs[RELAXED.name].time, "voltage_V": v, "relaxed_um": relaxed, "energised_um": energised}
    return _plate(6, "Initial states", draw, data, size=(plots.PAGE, 2.9), columns=2)


def _loops(found: Experiment) -> Plate:
    run = found.runs[RELAXED.name]
    shown = {
        "breakpoints": "(a) paper's method, N = 10",
        "record": "(b) whole record, N = 40",
        "record_tops": "(c) the same, tops added",
    }
    v, y = run.record.voltage, run.record.displacement
    dashes = {"major": "-", "medium": (0, (4, 1.5)), "small": (0, (1.5, 1))}
    colours = dict(zip(PEAKS, (plots.FALLING, plots.SIMULATED, "#117733"), strict=True))

    def draw(*axes: Axes) -> None:
        for upper, lower, (key, title) in zip(axes[:3], axes[3:], shown.items(), strict=True):
            simulated = found.trials[key].simulated
            for loop in PEAKS:
                s = run.known(loop)
                words = ("measured", "simulated") if loop == "major" else (None, None)
                plots.line(upper, v[s], 1e6 * y[s], **{**_TRUE, "label": words[0]})
                plots.line(upper, v[s], 1e6 * simulated[s], color=INK, lw=0.8, label=words[1])
                last = slice(s.stop - _CYCLE - 1, s.stop)
                miss = 100 * (y[last] - simulated[last]) / found.truth.stroke
                plots.line(lower, v[last], miss, color=colours[loop], ls=dashes[loop], lw=0.9, label=loop)
            lower.axhline(0, color=INK, lw=0.6)
            lower.set_xlabel(_VOLTAGE)
            _letter(upper, title)
        axes[0].set_ylabel(_DISPLACEMENT)
        axes[3].set_ylabel("residual (% of range)")
        axes[0].legend(loc="upper left")
        axes[3].legend(loc="upper left")

    data = {"time_s": run.record.time, "voltage_V": v, "displacement_um": 1e6 * y, "true_um": 1e6 * run.true} | {
        f"{key}_um": 1e6 * found.trials[key].simulated for key in shown
    }
    return _plate(7, "Loops measured and simulated", draw, data, size=(plots.PAGE, 4.4), rows=2, columns=3, share=True)


def _parallel_spring(found: Experiment) -> Plate:
    models = {key: physical(found, key) for key in ("breakpoints", "record_10")}
    p = models["breakpoints"]
    linear = p.equivalent_stiffness * p.deformation

    def draw(ax: Axes) -> None:
        x = 1e6 * p.deformation
        ax.plot(x, p.parallel, color=INK, lw=1.2, marker="o", ms=3, label="h = keq x + g")
        ax.plot(x, linear, color=plots.MEASURED, lw=1.0, ls=(0, (4, 1.5)), label="keq x")
        ax.plot(x, p.nonlinear, color=plots.SIMULATED, lw=1.0, marker="s", ms=2.6, label="g")
        other = models["record_10"]
        ax.plot(
            1e6 * other.deformation, other.parallel, color="#117733", lw=1.0, ls=(0, (1.5, 1)), label="h, whole record"
        )
        ax.axhline(0, color=INK, lw=0.6)
        ax.set(xlabel="deformation x (µm)", ylabel="force (N)")
        ax.legend(loc="upper left")

    data = {
        "x_um": 1e6 * p.deformation,
        "h_N": p.parallel,
        "linear_N": linear,
        "g_N": p.nonlinear,
        "whole_record_x_um": 1e6 * models["record_10"].deformation,
        "whole_record_h_N": models["record_10"].parallel,
    }
    return _plate(8, "The parallel spring", draw, data, size=(plots.COLUMN, 2.9))


def _right_extreme(found: Experiment) -> Plate:
    run = found.runs[RELAXED.name]
    s = run.known("medium")
    last = slice(s.stop - _CYCLE - 1, s.stop)
    v, y = run.record.voltage[last], 1e6 * run.record.displacement[last]
    step = 1e6 * found.loops[0].range / ELEMENTS
    peak = PEAKS["medium"]
    near = y > y.max() - 1.35 * step
    keys = ("breakpoints", "record_tops")
    simulated = {key: 1e6 * found.trials[key].simulated[last] for key in keys}

    def draw(ax: Axes) -> None:
        ax.plot(
            v[near], y[near], ls="none", marker="o", ms=3, mfc="none", mec=plots.MEASURED, mew=0.6, label="measured"
        )
        for key in keys:
            ax.plot(v[near], simulated[key][near], **_LINES[key])
        ends = (y.max() - step, y.max())
        _span(ax, peak + 2.4, *ends)
        ax.text(peak + 3.2, sum(ends) / 2, "first\nsegment", va="center", fontsize=8)
        ax.set(xlabel=_VOLTAGE, ylabel=_DISPLACEMENT, xlim=(None, peak + 15), ylim=(None, y.max() + 0.55 * step))
        ax.legend(loc="upper left")

    data = {"voltage_V": v, "displacement_um": y} | {f"{key}_um": simulated[key] for key in keys}
    return _plate(9, "Right extreme of a minor loop", draw, data, size=(plots.COLUMN, 3.0))


def _control_voltages(found: Experiment) -> Plate:
    keys = ("breakpoints", "record_tops", "goldfarb")
    nominal = found.nominal

    def draw(upper: Axes, lower: Axes) -> None:
        plots.line(upper, nominal.time, nominal.voltage, **_LINES["nominal"])
        for key in keys:
            sent = found.trials[key].tracking.voltage
            plots.line(upper, nominal.time, sent, **_LINES[key])
            plots.line(lower, nominal.time, sent - nominal.voltage, **_LINES[key])
        upper.set(ylabel=_VOLTAGE, ylim=(-8, 208))
        _legend_above(upper)
        _letter(upper, "(a)")
        lower.axhline(0, color=INK, lw=0.6)
        lower.set(xlabel=_TIME, ylabel="less nominal (V)")
        _letter(lower, "(b)")

    data = {"time_s": nominal.time, "nominal_V": nominal.voltage} | {
        f"{key}_V": found.trials[key].tracking.voltage for key in keys
    }
    return _plate(10, "Control voltages", draw, data, size=(plots.COLUMN, 4.0), rows=2, share=True)


def _trajectories(found: Experiment) -> Plate:
    nominal = found.nominal
    keys = ("goldfarb", "breakpoints", "record_tops")

    def draw(ax: Axes) -> None:
        plots.line(ax, nominal.time, 1e6 * nominal.wanted, color=_GREY, lw=3.2, alpha=0.5, label="wanted")
        plots.line(ax, nominal.time, 1e6 * nominal.reached, **_LINES["nominal"])
        for key in keys:
            plots.line(ax, nominal.time, 1e6 * found.trials[key].tracking.reached, **_LINES[key])
        ax.set(xlabel=_TIME, ylabel=_DISPLACEMENT)
        _legend_above(ax)

    data = {"time_s": nominal.time, "wanted_um": 1e6 * nominal.wanted, "nominal_um": 1e6 * nominal.reached} | {
        f"{key}_um": 1e6 * found.trials[key].tracking.reached for key in keys
    }
    return _plate(11, "Trajectories", draw, data, size=(plots.COLUMN, 3.1))


def _tracking_errors(found: Experiment, symmetric: Experiment) -> Plate:
    nominal = found.nominal
    keys = ("goldfarb", "breakpoints", "record_tops")

    def draw(upper: Axes, middle: Axes, lower: Axes) -> None:
        plots.line(upper, nominal.time, nominal.error, **_LINES["nominal"])
        for ax, shown, tried in ((upper, keys, found), (middle, keys[1:], found), (lower, keys[1:], symmetric)):
            for key in shown:
                plots.line(ax, nominal.time, tried.trials[key].tracking.error, **_LINES[key])
            ax.axhline(0, color=INK, lw=0.6)
            ax.set_ylabel("error (% of range)")
        _legend_above(upper)
        lower.set_ylim(middle.get_ylim())
        lower.set_xlabel(_TIME)
        _letter(upper, "(a)")
        _letter(middle, "(b) magnified")
        _letter(lower, "(c) without the asymmetric map")

    data = {"time_s": nominal.time, "nominal_percent": nominal.error} | {
        f"{prefix}{key}_percent": tried.trials[key].tracking.error
        for prefix, tried in (("", found), ("without_map_", symmetric))
        for key in keys
    }
    return _plate(
        12, "Tracking errors", draw, data, size=(plots.COLUMN, 5.4), rows=3, share=True, heights=(1.25, 1.0, 1.0)
    )
