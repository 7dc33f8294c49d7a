"""The figures of README, documentation and paper; `loop.py` draws `docs/how_to/loop.svg` by the same functions."""

import json
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dehyst.operations import demo

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BEFORE, AFTER = "#8a8a8a", "#d55e00"
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
# The enlarged piece of the demo (its middle and half its width, as parts of the stroke), and seconds of lines shown.
PIECE, SHOWN = (0.5, 0.04), 0.7


def saved(target: Path, size: tuple[float, float], draw, columns: int, **options: str) -> None:
    """Draw on axes side by side, and write an SVG or PNG file."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained", **options)
        draw(*np.atleast_1d(figure.subplots(1, columns)))
        figure.savefig(target, dpi=200, metadata={"Date": None} if target.suffix == ".svg" else {"Software": None})
    print(target.name)


def draw_demo(left: Axes, right: Axes) -> None:
    """Draw what is reached over what is wanted, with a piece enlarged, and the error in time."""
    found = demo.journey()
    curves = (found.linear, BEFORE, "straight scale factor"), (found.compensated, AFTER, "dehyst")
    wanted = found.wanted * 1e6
    low, span = wanted.min(), np.ptp(wanted)
    middle, half = low + PIECE[0] * span, PIECE[1] * span
    for y, colour, name in curves:
        left.plot(wanted, y * 1e6, color=colour, lw=1.2, label=name)
    left.set(xlabel="wanted (µm)", ylabel="reached (µm)", title="Following a path with nine reversals")
    left.legend(loc="upper left")
    inset = left.inset_axes((0.62, 0.1, 0.36, 0.36), xlim=(middle - half, middle + half), xticks=[], yticks=[])
    inset.set_ylim(middle - 2.2 * half, middle + 2.2 * half)
    for y, colour, _ in curves:
        inset.plot(wanted, y * 1e6, color=colour, lw=1.2)
    inset.set_facecolor("white")
    left.indicate_inset_zoom(inset, edgecolor="0.4")
    for y, colour, name in curves:
        error = 100 * (y - found.wanted) / found.stroke
        right.plot(found.time, error, color=colour, lw=1.2, label=f"{name}: at most {np.abs(error).max():.2f} %")
    right.set(xlabel="time (s)", ylabel="error (% of stroke)", title="Its error")
    room_above(right, 0.3)
    right.legend(loc="upper right")


def draw_reliability(axes: Axes) -> None:
    """Draw how many paths stay within a multiple of the promise, of mechanisms that gave its factors and others."""
    parts = json.loads((ROOT / "benchmarks" / "promise.json").read_text())
    for part, label, colour in (
        ("calibrate", "ten mechanisms", BEFORE),
        ("unseen", "six others", AFTER),
        ("last", "three made last", COLOURS["feedback"]),
    ):
        factor, kept = np.array(parts[part]["reliability"]).T
        axes.semilogx(factor, 100 * kept, color=colour, marker="o", ms=3, lw=1.2, label=label)
    axes.plot(1.0, 90.0, "k+", ms=12, label="promised: 90 % within the promise itself")
    axes.set(xlabel="multiple of the promise", ylabel="paths that stay within it (%)", ylim=(0, 102))
    axes.set_xticks([0.25, 0.5, 1, 2, 3], ["0.25", "0.5", "1", "2", "3"], minor=False)
    axes.minorticks_off()
    axes.legend(loc="lower right")


def room_above(axes: Axes, share: float) -> None:
    """Mark zero, and leave room above the curves, so that the legend hides none."""
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + share * (high - low))


def draw_loop(found: dict, shown: dict, period: float) -> None:
    """Draw a raster's lines followed in three ways, and how fast each can be."""
    lines, time = shown["triangle"], period * np.arange(round(SHOWN / period))

    def draw(left: Axes, middle: Axes, right: Axes) -> None:
        followed(left, {key: value[: time.size] for key, value in lines.items()}, time)
        errors(middle, lines, time)
        responses(right, found["response"])

    saved(DOCS / "how_to" / "loop.svg", (10.5, 3.4), draw, 3)


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
        label = f"{NAMES[kind]}: at most {np.abs(shown[kind]).max():.2f} % in 4 s"
        axes.plot(time, shown[kind][: time.size], color=COLOURS[kind], lw=1, label=label)
    label = f"integral feedback: at most {np.abs(shown['feedback']).max():.0f} %, not drawn"
    axes.plot([], [], color=COLOURS["feedback"], label=label)
    room_above(axes, 0.45)
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


if __name__ == "__main__":
    saved(DOCS / "explanation" / "reliability.svg", (4.8, 3.4), draw_reliability, 1, facecolor="white")
    for target in (DOCS / "demo.svg", ROOT / "paper" / "path.png"):
        saved(target, (9, 3.6), draw_demo, 2, facecolor="white")
