"""Figures of the parts of a wider actuator: its transformer, its creep, its graded and its smooth elements."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dehyst.model import Actuator, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.summary import Slopes, bend, step_response
from dehyst.report.plots import FALLING, INK, MEASURED, RISING, SIMULATED, inline, length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def transformer(tau: Transformer, *, name: str) -> str:
    """Draw tau(v) minus the straight line between its ends, its slope beneath."""

    def draw(upper: Axes, lower: Axes) -> None:
        upper.plot(tau.voltage, bend(tau), color=MEASURED, lw=1, marker="o", ms=2.6)
        upper.axhline(0, color=INK, lw=0.6)
        upper.set_ylabel("tau(v) less a straight line (V)")
        lower.stairs(tau.slopes, tau.voltage, baseline=None, color=MEASURED, lw=1)
        lower.axhline(1, color=INK, lw=0.6)
        lower.set_ylim(bottom=0)
        lower.set(xlabel="voltage (V)", ylabel="slope of tau (V/V)")

    return inline(name, draw, rows=2, height=4.4)


def creep(actuator: Actuator, *, name: str) -> str:
    """Draw the displacement after a sudden rise through all voltages, with the time constants marked."""
    return inline(name, lambda ax: draw_creep(ax, actuator))


def draw_creep(ax: Axes, actuator: Actuator) -> None:
    """Draw what `creep` shows on axes."""
    time, share = step_response(actuator)
    branches = actuator.creep
    ax.plot(time, 100 * share, color=MEASURED, lw=1.2)
    ax.set(xscale="log", xlabel="time since the rise (s)", ylabel="further displacement (% of the rise)")
    ax.set_ylim(bottom=0, top=max(1.25 * 100 * float(share.max()), 1e-9))
    if branches is not None:
        for k, constant in enumerate(branches.time_constants[branches.stiffness > 0]):
            ax.axvline(constant, color=SIMULATED, lw=0.6, ls=":", label=None if k else "time constants")
    ax.set_xlim(time[0], time[-1])
    ax.legend(loc="upper left")


def graded(slip: GradedSlip, *, name: str) -> str:
    """Draw stiffness times breakaway elongation of each element over the position of its cart; darker is more."""
    factor, unit = length_unit(float(np.ptp(slip.knots)))
    edges = np.concatenate([[0.0], slip.breakaway]) * factor

    def draw(ax: Axes) -> None:
        held = slip.stiffness * slip.breakaway[:, None]
        shades = ax.pcolormesh(slip.knots * factor, edges, held, cmap="Blues", lw=0, rasterized=True)
        ax.set(xlabel=f"position of the cart ({unit})", ylabel=f"breakaway elongation ({unit})")
        ax.grid(visible=False)
        bar = ax.figure.colorbar(shades, ax=ax, pad=0.02)
        bar.set_label("stiffness times breakaway elongation (V)")
        bar.outline.set_linewidth(0.6)

    return inline(name, draw, height=3.6)


def slopes(slip: GradedSlip | MaxwellSlip, spring: Spring, *, name: str) -> str:
    """Draw the slope of slow motion: just after a turn, and when every element slides."""
    return inline(name, lambda ax: draw_slopes(ax, slip, spring), height=3.6)


def draw_slopes(ax: Axes, slip: GradedSlip | MaxwellSlip, spring: Spring) -> None:
    """Draw what `slopes` shows on axes."""
    steepness = Slopes.of(slip, spring)
    factor, unit = length_unit(float(np.ptp(steepness.displacement)))
    # Those of plain elements are equal.
    dashes = "--" if np.array_equal(steepness.rising, steepness.falling) else "-"
    for values, colour, label, style in (
        (steepness.turned, INK, "just after a turn", "-"),
        (steepness.rising, RISING, "rising", "-"),
        (steepness.falling, FALLING, "falling", dashes),
    ):
        ax.plot(steepness.displacement * factor, values * 1e-6, color=colour, lw=1, ls=style, label=label)
    ax.set(xlabel=f"displacement ({unit})", ylabel="slope of the voltage (V/µm)")
    ax.set_ylim(0, 1.3 * float(steepness.turned.max()) * 1e-6)
    ax.legend(loc="upper left", ncols=3)


def smooth(elements: SmoothSlip, *, name: str) -> str:
    """Draw the largest voltage that each smooth element holds, over its length."""
    factor, unit = length_unit(float(elements.length.max()))

    def draw(ax: Axes) -> None:
        held, length = elements.stiffness * elements.length, elements.length * factor
        dahl = elements.closing > 0.75
        for kind, colour, aside, label in (
            (~dahl, MEASURED, -1, "back on a straight line"),
            (dahl, SIMULATED, 1, "back on a curve (Dahl)"),
        ):
            if kind.any():
                x = length[kind] + 0.008 * aside * length.max()
                ax.vlines(x, 0, held[kind], color=colour, lw=1.2)
                ax.plot(x, held[kind], ls="none", marker="o", ms=4, color=colour, label=label)
        ax.set(xlabel=f"length ({unit})", ylabel="holds at most (V)")
        ax.set_xlim(0, 1.08 * float(length.max()))
        ax.set_ylim(0, 1.3 * float(held.max()) if held.any() else 1.0)
        ax.legend(loc="upper left")

    return inline(name, draw)
