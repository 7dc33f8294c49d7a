"""Figs. 3 to 12 of the paper for a virtual actuator; its schematics are on the theory page of the documentation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from inspect import getdoc
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import numpy as np

from dehyst._types import Array, Progress
from dehyst.paper.experiment import CYCLE, ELEMENTS, ENERGISED, PEAKS, RELAXED, Experiment
from dehyst.paper.tables import physical
from dehyst.report import COLUMN, INK, PAGE, Drawing, plots

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_GREY, _GREEN = "#8A8A8A", "#117733"
_DASHED, _DOTTED = (0, (4, 1.5)), (0, (1.5, 1))
_LINES: dict[str, dict[str, Any]] = {
    "nominal": {"color": INK, "lw": 0.9, "ls": (0, (1, 1.2)), "label": "nominal ratio"},
    "breakpoints": {"color": plots.SIMULATED, "lw": 1.0, "label": "paper's method"},
    "record": {"color": plots.FALLING, "lw": 1.0, "ls": (0, (2, 1)), "label": "whole records"},
}
_TRACKED = ("breakpoints", "record")
_DISPLACEMENT, _VOLTAGE, _TIME = "displacement (µm)", "voltage (V)", "time (s)"
_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")
_Draw = TypeVar("_Draw", bound=Callable[..., None])
_Place: TypeAlias = Literal["", "upper left", "upper right"]
_FIGURES: dict[int, tuple[Callable[..., None], dict[str, Any]]] = {}


@dataclass(frozen=True, eq=False)
class Plate:
    """A figure of the paper for the virtual actuator, with the paper's `number`; `wide`: over two columns."""

    number: int
    title: str
    caption: str
    wide: bool
    drawing: Drawing

    @property
    def name(self) -> str:
        """Name of its files."""
        return f"fig{self.number:02d}"


def plates(found: Experiment, symmetric: Experiment, progress: Progress) -> Iterator[Plate]:
    """Draw the figures of the virtual E-280.10, with and without its asymmetric map; report each before it is drawn.

    Raise `MissingExtraError` if matplotlib is not installed.
    """
    for number, (draw, layout) in _FIGURES.items():
        progress(f"drawing Fig. {number} of {max(_FIGURES)}")
        drawn = plots.drawing(f"paper{number}", partial(draw, found, symmetric), **layout)
        title, _, caption = (getdoc(draw) or "").removeprefix("Draw ").partition(".\n\n")
        yield Plate(number, title.capitalize(), " ".join(caption.split()), layout["size"][0] > COLUMN, drawn)


def _figure(number: int, **layout: Any) -> Callable[[_Draw], _Draw]:
    """Register a function that draws a figure on axes of a layout; its docstring is the title and the caption."""

    def register(draw: _Draw) -> _Draw:
        _FIGURES[number] = draw, layout
        return draw

    return register


def _major(found: Experiment, start: str = RELAXED) -> tuple[Array, Array]:
    """Return voltage [V] and displacement [um] of the major loop."""
    record = found.runs[start].cut("major")
    return record.voltage, 1e6 * record.displacement


def _finish(
    ax: Axes, x: str, y: str, legend: _Place = "", letter: str = "", *, zero: bool = False, **limits: Any
) -> None:
    """Label axes; add a legend at a place, a letter above, and a line at zero, if requested."""
    ax.set(xlabel=x, ylabel=y, **limits)
    if legend:
        ax.legend(loc=legend)
    if letter:
        ax.set_title(letter, loc="left", fontsize=8.5)
    if zero:
        ax.axhline(0, color=INK, lw=0.6)


def _span(ax: Axes, x: float, low: float, other: float) -> None:
    """Draw a double arrow in the direction of the ordinate."""
    arrow = {"arrowstyle": "<->", "lw": 0.8, "color": INK, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (x, low), (x, other), arrowprops=arrow)


def _legend_above(ax: Axes) -> None:
    """Set a legend above all axes, for figures where it would hide data inside."""
    handles, labels = ax.get_legend_handles_labels()
    ax.figure.legend(handles, labels, loc="outside upper center", ncols=2, columnspacing=1.2, handlelength=2.0)


@_figure(3, size=(COLUMN, 2.7))
def _typical_loop(found: Experiment, _: Experiment, ax: Axes) -> None:
    """Draw a typical hysteresis loop.

    The loop starts from the relaxed state. At 0 V the residual displacement is left.
    """
    v, y = _major(found)
    rise, loop = slice(0, CYCLE // 2 + 1), slice(CYCLE // 2, CYCLE // 2 + CYCLE + 1)
    plots.line(ax, v[rise], y[rise], color=_GREY, lw=1.0, ls=_DASHED, label="first rise")
    plots.line(ax, v[loop], y[loop], color=plots.MEASURED, lw=1.2, label="loop")
    for k in (int(0.72 * CYCLE), int(1.26 * CYCLE)):
        arrow = {"arrowstyle": "-|>", "color": plots.MEASURED, "lw": 1.0}
        ax.annotate("", (v[k + 12], y[k + 12]), (v[k - 12], y[k - 12]), arrowprops=arrow)
    _finish(ax, _VOLTAGE, _DISPLACEMENT, "upper left", xlim=(-5, 207))


@_figure(4, size=(PAGE, 2.9), columns=2)
def _antisymmetry(found: Experiment, symmetric: Experiment, left: Axes, right: Axes) -> None:
    """Draw anti-symmetry.

    (a) The loop and its image under a half-turn about its centre; break points of the descending (full) and the
    ascending branch (hollow). Lemma 2: without the nonlinear spring, loop and image coincide. (b) Distance of the
    midpoints of pairs of break points from the centre, with and without the asymmetric map.
    """
    v, y = (column[-CYCLE - 1 :] for column in _major(found))
    loop, pairs = found.loops[0], np.arange(1, ELEMENTS)
    peak, ends = PEAKS["major"], 1e6 * (loop.bottom + loop.top)
    hollow: dict[str, Any] = {"marker": "s", "ms": 3.4, "lw": 0.8, "ls": _DASHED, "mfc": "white"}
    plots.line(left, v, y, color=plots.MEASURED, lw=1.2, label="loop")
    plots.line(left, peak - v, ends - y, color=plots.SIMULATED, lw=0.9, ls=_DASHED, label="turned by 180°")
    for branch, face in ((loop.descending, INK), (loop.ascending, "white")):
        left.plot(branch[1:-1, 1], 1e6 * branch[1:-1, 0], ls="none", marker="o", ms=3, mfc=face, mec=INK, mew=0.7)
    left.plot(peak / 2, ends / 2, marker="+", ms=9, mew=1.1, color=INK, ls="none", label="centre")
    _finish(left, _VOLTAGE, _DISPLACEMENT, "upper left", "(a)")
    right.plot(pairs, found.midpoints, marker="o", ms=4, lw=0.8, color=plots.MEASURED, label="virtual E-280.10")
    right.plot(pairs, symmetric.midpoints, label="without its asymmetric map", color=plots.FALLING, **hollow)
    ends_of_y = (None, 1.45 * found.midpoints.max() + 0.5)
    x, y_label = "pair of break points i", "midpoint − v₀/2 (V)"
    _finish(right, x, y_label, "upper right", "(b)", zero=True, ylim=ends_of_y, xticks=pairs)


@_figure(5, size=(PAGE, 4.2))
def _break_points(found: Experiment, _: Experiment, ax: Axes) -> None:
    """Draw break points and segments.

    Break points divide the range from y(T₀) to y(T₀/2) into N equal parts. The paper's method uses only these points.
    Between a turning point and the first break point its model is straight, but the measured loop is not.
    """
    v, y = (column[-CYCLE - 1 :] for column in _major(found))
    loop = found.loops[0]
    down, up = (np.column_stack([1e6 * b[:, 0], b[:, 1]]) for b in (loop.descending, loop.ascending))
    step, marked, inner = 1e6 * loop.range / ELEMENTS, 4, range(1, ELEMENTS)
    subscripts = [str(i).translate(_SUBSCRIPTS) for i in range(ELEMENTS + 1)]

    def note(text: str, place: Array, offset: tuple[int, int], side: str) -> None:
        ax.annotate(text, (place[1], place[0]), offset, textcoords="offset points", ha=side, fontsize=8)

    plots.line(ax, v, y, color=plots.MEASURED, lw=3, alpha=0.35, label="measured loop")
    for branch, face, name in ((down, INK, "descending"), (up, "white", "ascending")):
        style: dict[str, Any] = {"color": INK, "lw": 0.8, "marker": "o", "ms": 3.6, "mfc": face, "mew": 0.8}
        ax.plot(branch[:, 1], branch[:, 0], label=f"break points, {name}", **style)
    for i, place in enumerate(down[:, 0]):
        ax.plot((-22, 222), (place, place), color="#D0D0D0", lw=0.5, zorder=0)
        if i in inner:
            ax.text(224, place, f"Y{subscripts[i]}", va="center", fontsize=8)
    for branch, word, offset, side in ((down, "v↓", (-5, 3), "right"), (up, "v↑", (6, -8), "left")):
        for i in inner:
            note(f"{word}{subscripts[i]}", branch[i], offset, side)
    _span(ax, 213, down[marked, 0], down[marked + 1, 0])
    ax.text(210, down[marked, 0] - step / 2, f"2δ keq/km = {step:.3f} µm", ha="right", va="center", fontsize=8)
    note("y(T₀/2), v₀", down[0], (-6, 5), "right")
    note("y(T₀)", up[0], (-6, -3), "right")
    limits: dict[str, Any] = {"xlim": (-22, 236), "ylim": (y.min() - 1, y.max() + 1.6)}
    _finish(ax, _VOLTAGE, _DISPLACEMENT, "upper left", xticks=np.arange(0, 201, 25), **limits)
    ax.grid(visible=False)


@_figure(6, size=(PAGE, 2.9), columns=2)
def _initial_states(found: Experiment, _: Experiment, left: Axes, right: Axes) -> None:
    """Draw initial states.

    (a) The same voltage from the relaxed state, and after another voltage was applied and removed. (b) The
    difference of the two loops, constant from the first peak on (Eq. 10), and its predictions by the models.
    """
    (v, relaxed), energised, half = _major(found), _major(found, ENERGISED)[1], CYCLE // 2
    moved = energised - relaxed
    plots.line(left, v, relaxed, color=plots.MEASURED, lw=1.2, label="relaxed")
    plots.line(left, v, energised, color=plots.SIMULATED, lw=1.0, ls=_DASHED, label="pre-energised at 100 V")
    _finish(left, _VOLTAGE, _DISPLACEMENT, "upper left", "(a)")
    measured = {"color": plots.MEASURED, "lw": 2.4, "alpha": 0.6, "label": "measured, from T₀/2 on"}
    plots.line(right, v[: half + 1], moved[: half + 1], color=_GREY, lw=1.0, label="measured, first rise")
    plots.line(right, v[half:], moved[half:], **measured)
    for key in _TRACKED:
        style = {**_LINES[key], "label": f"Eq. 10, {_LINES[key]['label']}"}
        right.axhline(1e6 * found.trials[key].shift, **style)
    lowest = 1e6 * found.shift.mean() - 0.25
    _finish(right, _VOLTAGE, "pre-energised − relaxed (µm)", "upper right", "(b)", ylim=(lowest, 0.25))


@_figure(7, size=(PAGE, 4.4), rows=2, columns=2, share=True)
def _loops(found: Experiment, _: Experiment, *axes: Axes) -> None:
    """Draw loops measured and simulated.

    Both methods fitted the major and the small loop; (b) also fitted descending tops. The medium loop was held out.
    Below: measured minus simulated in the last cycle.
    """
    run = found.runs[RELAXED]
    shown = {"breakpoints": "(a) paper's method, N = 10", "record": "(b) whole records, N = 40"}
    v, y = run.record.voltage, run.record.displacement
    styles = dict(zip(PEAKS, ((plots.FALLING, "-"), (plots.SIMULATED, _DASHED), (_GREEN, _DOTTED)), strict=True))
    for upper, lower, (key, title) in zip(axes[:2], axes[2:], shown.items(), strict=True):
        simulated = found.trials[key].simulated
        for loop, (colour, dashes) in styles.items():
            s = run.known(loop)
            words = ("measured", "simulated") if loop == "major" else (None, None)
            plots.line(upper, v[s], 1e6 * y[s], color=plots.MEASURED, lw=2.6, alpha=0.4, label=words[0])
            plots.line(upper, v[s], 1e6 * simulated[s], color=INK, lw=0.8, label=words[1])
            last = slice(s.stop - CYCLE - 1, s.stop)
            miss = 100 * (y[last] - simulated[last]) / found.truth.stroke
            plots.line(lower, v[last], miss, color=colour, ls=dashes, lw=0.9, label=loop)
        legend: _Place = "upper left" if upper is axes[0] else ""
        _finish(upper, "", _DISPLACEMENT if legend else "", legend, title)
        _finish(lower, _VOLTAGE, "residual (% of range)" if legend else "", legend, zero=True)


@_figure(8, size=(COLUMN, 2.9))
def _parallel_spring(found: Experiment, _: Experiment, ax: Axes) -> None:
    """Draw the parallel spring.

    h = keq x + g rises everywhere: Assumption I holds. With the paper's constants g is strongly negative, but only h
    has an effect.
    """
    p = physical(found)
    x, linear = 1e6 * p.deformation, p.equivalent_stiffness * p.deformation
    ax.plot(x, p.parallel, color=INK, lw=1.2, marker="o", ms=3, label="h = keq x + g")
    ax.plot(x, linear, color=plots.MEASURED, lw=1.0, ls=_DASHED, label="keq x")
    ax.plot(x, p.nonlinear, color=plots.SIMULATED, lw=1.0, marker="s", ms=2.6, label="g")
    _finish(ax, "deformation x (µm)", "force (N)", "upper left", zero=True)


@_figure(9, size=(COLUMN, 3.0))
def _right_extreme(found: Experiment, _: Experiment, ax: Axes) -> None:
    """Draw right extreme of a minor loop.

    The turning point of the medium loop. The model is straight until the first element slips.
    """
    run = found.runs[RELAXED]
    last = slice(run.known("medium").stop - CYCLE - 1, run.known("medium").stop)
    v, y = run.record.voltage[last], 1e6 * run.record.displacement[last]
    step, peak = 1e6 * found.loops[0].range / ELEMENTS, PEAKS["medium"]
    near = y > y.max() - 1.35 * step
    dots: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 3, "mfc": "none", "mec": plots.MEASURED, "mew": 0.6}
    ax.plot(v[near], y[near], label="measured", **dots)
    for key in _TRACKED:
        ax.plot(v[near], 1e6 * found.trials[key].simulated[last][near], **_LINES[key])
    ends = (y.max() - step, y.max())
    _span(ax, peak + 2.4, *ends)
    ax.text(peak + 3.2, sum(ends) / 2, "first\nsegment", va="center", fontsize=8)
    limits: dict[str, Any] = {"xlim": (None, peak + 15), "ylim": (None, y.max() + 0.55 * step)}
    _finish(ax, _VOLTAGE, _DISPLACEMENT, "upper left", **limits)


@_figure(10, size=(COLUMN, 4.0), rows=2, share=True)
def _control_voltages(found: Experiment, _: Experiment, upper: Axes, lower: Axes) -> None:
    """Draw control voltages.

    (a) Voltages for a raised cosine over the full range. (b) Inverse control minus the nominal ratio.
    """
    time, nominal = found.nominal.time, found.nominal.voltage
    plots.line(upper, time, nominal, **_LINES["nominal"])
    for key in _TRACKED:
        voltage = found.trials[key].tracking.voltage
        plots.line(upper, time, voltage, **_LINES[key])
        plots.line(lower, time, voltage - nominal, **_LINES[key])
    _finish(upper, "", _VOLTAGE, letter="(a)", ylim=(-8, 208))
    _finish(lower, _TIME, "less nominal (V)", letter="(b)", zero=True)
    _legend_above(upper)


@_figure(11, size=(COLUMN, 3.1))
def _trajectories(found: Experiment, _: Experiment, ax: Axes) -> None:
    """Draw trajectories.

    The wanted path, and the true displacement with the voltages of Fig. 10, after one cycle that makes the state
    known.
    """
    time, wanted = found.nominal.time, 1e6 * found.nominal.wanted
    tried = {"nominal": found.nominal} | {key: found.trials[key].tracking for key in _TRACKED}
    plots.line(ax, time, wanted, color=_GREY, lw=3.2, alpha=0.5, label="wanted")
    for key, tracking in tried.items():
        plots.line(ax, time, 1e6 * tracking.reached, **_LINES[key])
    _finish(ax, _TIME, _DISPLACEMENT)
    _legend_above(ax)


@_figure(12, size=(COLUMN, 5.4), rows=3, share=True, heights=(1.25, 1.0, 1.0))
def _tracking_errors(found: Experiment, symmetric: Experiment, upper: Axes, middle: Axes, lower: Axes) -> None:
    """Draw tracking errors.

    Reached minus wanted displacement. In (c) the actuator has no asymmetric map and is otherwise the same: the
    difference from (b) is due to the model class.
    """
    time = found.nominal.time
    plots.line(upper, time, found.nominal.error, **_LINES["nominal"])
    for ax, tried in ((upper, found), (middle, found), (lower, symmetric)):
        for key in _TRACKED:
            plots.line(ax, time, tried.trials[key].tracking.error, **_LINES[key])
    for ax, text in ((upper, "(a)"), (middle, "(b) magnified"), (lower, "(c) without the asymmetric map")):
        _finish(ax, _TIME if ax is lower else "", "error (% of range)", letter=text, zero=True)
    _legend_above(upper)
    lower.set_ylim(middle.get_ylim())
