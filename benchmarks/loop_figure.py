"""The figure of `docs/how_to/control.md`: a raster's lines followed in three ways, and how fast each can be."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

TARGET = Path(__file__).resolve().parents[1] / "docs" / "how_to" / "loop.svg"
COLOURS = {"feedback": "#0072b2", "feedforward": "#d55e00", "both": "#009e73"}
NAMES = {"feedback": "integral feedback", "feedforward": "feedforward", "both": "both"}
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "dehyst",
    "axes.linewidth": 0.7,
    "legend.frameon": False,
}
SHOWN = 0.7


def followed(axes: Axes, shown: dict, time: np.ndarray) -> None:
    axes.plot(time, 100 * shown["wanted"], color="0.6", lw=2.5, label="wanted")
    for kind in ("feedback", "both"):
        reached = 100 * shown["wanted"] - shown[kind]
        axes.plot(time, reached, color=COLOURS[kind], lw=1, label=NAMES[kind])
    axes.set(xlabel="time (s)", ylabel="displacement (% of stroke)", title="Lines at 5 Hz", ylim=(0, 135))
    axes.set_yticks([0, 20, 40, 60, 80, 100])
    axes.legend(loc="upper center", ncols=3, fontsize=8, columnspacing=1, handlelength=1.5)


def errors(axes: Axes, shown: dict, time: np.ndarray) -> None:
    for kind in ("feedforward", "both"):
        largest = np.abs(shown[kind]).max()
        axes.plot(
            time,
            shown[kind][: time.size],
            color=COLOURS[kind],
            lw=1,
            label=f"{NAMES[kind]}: at most {largest:.2f} % in 4 s",
        )
    axes.plot(
        [],
        [],
        color=COLOURS["feedback"],
        label=f"integral feedback: at most {np.abs(shown['feedback']).max():.0f} %, not drawn",
    )
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.45 * (high - low))
    axes.set(xlabel="time (s)", ylabel="error (% of stroke)", title="Error on the lines")
    axes.legend(loc="upper left", fontsize=8)


def responses(axes: Axes, found: dict) -> None:
    for kind, colour in COLOURS.items():
        for size, line in (("small", "-"), ("large", "--")):
            f, g = np.array(found[size][kind]).T
            label = NAMES[kind] if size == "small" else None
            # Feedforward lies beneath.
            wide = {"lw": 4, "alpha": 0.4} if kind == "feedforward" else {"lw": 1.2, "marker": ".", "ms": 3}
            axes.semilogx(f, g, line, color=colour, label=label, **wide)
    axes.plot([], [], "--", color="0.3", lw=1.2, label="large sines")
    axes.axhline(-3, color="0.7", lw=0.5, zorder=0)
    axes.set(
        xlabel="frequency (Hz)", ylabel="reached over wanted (dB)", title="Sines around half the stroke", ylim=(-15, 3)
    )
    axes.legend(loc="lower right", bbox_to_anchor=(0.93, 0.05), fontsize=8)


def draw(found: dict, shown: dict, period: float) -> None:
    lines = shown["triangle"]
    part = round(SHOWN / period)
    time = period * np.arange(part)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(10.5, 3.4), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        followed(left, {key: value[:part] for key, value in lines.items()}, time)
        errors(middle, lines, time)
        responses(right, found["response"])
        figure.savefig(TARGET, metadata={"Date": None})
    print(TARGET.name)
