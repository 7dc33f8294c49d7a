"""Figures of uncertainty: singular values, intervals of stiffnesses and spring, the prediction band of a trajectory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from dehyst._types import Array
from dehyst.identification.diagnostics.identifiability import Identifiability
from dehyst.report.plots import FALLING, INK, MEASURED, RISING, SIMULATED, inline, length_unit
from dehyst.uncertainty import Insight
from dehyst.uncertainty.bootstrap import Intervals
from dehyst.uncertainty.prediction_band import PredictionBand

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FREE = "#BBBBBB"
# Singular values below this are rounding; drawn at the foot of the scale.
_FOOT = 1e-5


def _by_noise(noise: Intervals) -> str:
    return f"{100 * noise.level:.0f} % by noise"


def singular_values(identifiability: Identifiability, *, name: str) -> str:
    """Draw the singular value of each direction, filled if the records determine it, hollow if not."""
    return inline(name, lambda ax: draw_singular_values(ax, identifiability))


def draw_singular_values(ax: Axes, identifiability: Identifiability) -> None:
    """Draw what `singular_values` shows on axes."""
    values = identifiability.values
    number, known = np.arange(1, values.size + 1), np.arange(values.size) < identifiability.determined
    shown = np.maximum(values, _FOOT)
    for some, face, label in ((known, MEASURED, "determined"), (~known, "white", "open")):
        if some.any():
            style: dict[str, Any] = {"ls": "none", "marker": "o", "ms": 4.5, "mfc": face, "mec": MEASURED}
            ax.plot(number[some], shown[some], label=label, clip_on=False, **style)
    ax.set(yscale="log", xlabel="direction", ylabel="singular value (V/V)")
    ax.set_ylim(bottom=min(_FOOT, float(shown.min())))
    ax.set_xlim(0.5, values.size + 0.5)
    ax.locator_params(axis="x", integer=True)
    ax.legend(loc="lower left")


def stiffness_intervals(found: Insight, *, name: str) -> str:
    """Draw each stiffness with its interval by noise, and behind it its range among compatible models."""
    return inline(name, lambda ax: draw_stiffness_intervals(ax, found))


def draw_stiffness_intervals(ax: Axes, found: Insight) -> None:
    """Draw what `stiffness_intervals` shows on axes."""
    slip, noise, free, alone = found.actuator.slip, found.intervals, found.feasible_set, found.identifiability.alone
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho = slip.breakaway * factor
    if free is not None:
        ax.vlines(rho, *free.stiffness * 1e-6, color=_FREE, lw=5, label="compatible")
    if noise is not None and alone.any():
        low, high = noise.stiffness[:, alone] * 1e-6
        ax.vlines(rho[alone], low, high, color=SIMULATED, lw=1.6, label=_by_noise(noise))
    ax.plot(rho, slip.stiffness * 1e-6, ls="none", marker="o", ms=3, color=INK, label="model", clip_on=False)
    ax.set(xlabel=f"breakaway elongation ({unit})", ylabel="stiffness (V/µm)")
    ax.set_xlim(0, 1.05 * float(rho[-1]))
    ax.set_ylim(bottom=0)
    ax.legend(loc="upper right")


def spring_intervals(found: Insight, *, name: str) -> str:
    """Draw the uncertainty of the spring's voltage at its knots, by noise and among compatible models."""
    spring, noise, free = found.actuator.spring, found.intervals, found.feasible_set
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    centre = spring.voltage - spring.voltage[0]

    def draw(ax: Axes) -> None:
        y = spring.displacement * factor
        if free is not None:
            ax.fill_between(y, free.spring[0] - centre, free.spring[1] - centre, color=_FREE, lw=0, label="compatible")
        if noise is not None:
            low, high = (end - centre for end in noise.spring)
            ax.fill_between(y, low, high, color=SIMULATED, alpha=0.6, lw=0, label=_by_noise(noise))
        ax.axhline(0, color=INK, lw=0.8)
        ax.set(xlabel=f"displacement ({unit})", ylabel="spring voltage, off the model's (V)")
        ax.legend(loc="upper left")

    return inline(name, draw)


def loop_interval(found: Insight, *, name: str) -> str:
    """Draw the uncertainty of the displacement by noise on the rise and the fall through the limits."""
    return inline(name, lambda ax: draw_loop_interval(ax, found))


def draw_loop_interval(ax: Axes, found: Insight) -> None:
    """Draw what `loop_interval` shows on axes."""
    loop = found.loop
    if loop is None:
        return
    low, high = (loop.noise - loop.displacement) * 1e9
    top = int(np.argmax(loop.voltage))
    for branch, colour, label in ((slice(0, top + 1), RISING, "rising"), (slice(top, None), FALLING, "falling")):
        ax.fill_between(loop.voltage[branch], low[branch], high[branch], color=colour, alpha=0.5, lw=0, label=label)
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="voltage (V)", ylabel="displacement, off the model's (nm)")
    bottom, upper = ax.get_ylim()
    ax.set_ylim(bottom, upper + 0.25 * (upper - bottom))
    ax.legend(loc="upper left", ncols=2)


def drive_interval(found: Insight, *, name: str) -> str:
    """Draw the uncertainty of tau at its knots by noise."""
    tau, noise = found.actuator.transformer, found.intervals

    def draw(ax: Axes) -> None:
        if tau is not None and noise is not None and noise.drive is not None:
            low, high = noise.drive - tau.drive
            ax.fill_between(
                tau.voltage, low, high, color=SIMULATED, alpha=0.6, lw=0, label=f"{100 * noise.level:.0f} % by noise"
            )
        ax.axhline(0, color=INK, lw=0.8)
        ax.set(xlabel="voltage (V)", ylabel="tau, off the model's (V)")
        ax.legend(loc="upper left")

    return inline(name, draw)


def creep_intervals(found: Insight, *, name: str) -> str:
    """Draw the stiffness of each creep branch with its interval by noise."""
    creep, noise = found.actuator.creep, found.intervals

    def draw(ax: Axes) -> None:
        if creep is None:
            return
        if noise is not None and noise.creep is not None:
            low, high = noise.creep * 1e-6
            ax.vlines(creep.time_constants, low, high, color=SIMULATED, lw=1.6, label=_by_noise(noise))
        ax.plot(creep.time_constants, creep.stiffness * 1e-6, ls="none", marker="o", ms=3, color=INK, label="model")
        ax.set(xscale="log", xlabel="time constant (s)", ylabel="stiffness (V/µm)")
        low, high = ax.get_ylim()
        ax.set_ylim(0, 1.3 * high)
        ax.legend(loc="upper left", ncols=2)

    return inline(name, draw)


def band(found: PredictionBand, stroke: float, *, name: str) -> str:
    """Draw the error to expect along a trajectory, part by part, and the trajectory above."""
    factor, unit = length_unit(float(np.ptp(found.displacement)))

    def draw(upper: Axes, lower: Axes) -> None:
        upper.plot(np.arange(found.displacement.size), found.wanted * factor, color=MEASURED, lw=1)
        upper.set_ylabel(f"displacement ({unit})")
        draw_band(lower, found, stroke)

    return inline(name, draw, rows=2, height=4.4)


def draw_band(ax: Axes, found: PredictionBand, stroke: float) -> None:
    """Draw the error to expect along a trajectory, part by part [% of a stroke in m], on axes."""
    sample = np.arange(found.displacement.size)

    def fill(low: Array, high: Array, colour: str, label: str) -> None:
        low, high = (100 * (edge - found.wanted) / stroke for edge in (low, high))
        ax.fill_between(sample, low, high, color=colour, lw=0, label=label)

    fill(found.lowest, found.highest, "#E5E5E5", "all")
    if found.likely is not None:
        fill(found.likely[0], found.likely[1], "#CFD8E6", f"{100 * found.level:g} %")
    if found.open is not None:
        fill(found.open[0], found.open[1], "#AAAAAA", "compatible with the records")
    fill(found.noise[0], found.noise[1], SIMULATED, "noise")
    ax.axhline(0, color=FALLING, lw=0.6)
    low, high = ax.get_ylim()
    ax.set_ylim(low, high + 0.35 * (high - low))
    ax.set(xlabel="sample", ylabel="error (% of stroke)")
    ax.legend(loc="upper left", ncols=4)
