"""The figures of README, documentation and paper."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dehyst.operations import demo

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
BEFORE, AFTER, LAST = "#8a8a8a", "#d55e00", "#0072b2"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "dehyst",
    "axes.linewidth": 0.7,
    "legend.frameon": False,
}
# The enlarged part of the demo: its middle and half width, as parts of the stroke.
PIECE = (0.5, 0.04)


def saved(target: Path, size: tuple[float, float], draw, columns: int, **options: str) -> None:
    """Draw on axes side by side, and write an SVG or PNG file."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained", **options)
        draw(*np.atleast_1d(figure.subplots(1, columns)))
        figure.savefig(target, dpi=200, metadata={"Date": None} if target.suffix == ".svg" else {"Software": None})
    print(target.name)


def draw_demo(left: Axes, right: Axes) -> None:
    """Draw the reached over the wanted displacement, with an enlarged part, and the error in time."""
    _, _, path = demo.journey()
    curves = (path["linear_um"], BEFORE, "straight scale factor"), (path["compensated_um"], AFTER, "dehyst")
    low, span = (wanted := path["wanted_um"]).min(), np.ptp(wanted)
    middle, half = low + PIECE[0] * span, PIECE[1] * span
    for y, colour, name in curves:
        left.plot(wanted, y, color=colour, lw=1.2, label=name)
    left.set(xlabel="wanted (µm)", ylabel="reached (µm)", title="Following a path with nine reversals")
    left.legend(loc="upper left")
    inset = left.inset_axes((0.62, 0.1, 0.36, 0.36), xlim=(middle - half, middle + half), xticks=[], yticks=[])
    inset.set_ylim(middle - 2.2 * half, middle + 2.2 * half)
    for y, colour, _ in curves:
        inset.plot(wanted, y, color=colour, lw=1.2)
    inset.set_facecolor("white")
    left.indicate_inset_zoom(inset, edgecolor="0.4")
    for y, colour, name in curves:
        error = 100 * (y - wanted) / (1e6 * demo.PlayActuator().stroke)
        right.plot(path["time_s"], error, color=colour, lw=1.2, label=f"{name}: at most {np.abs(error).max():.2f} %")
    right.set(xlabel="time (s)", ylabel="error (% of stroke)", title="Its error")
    room_above(right, 0.3)
    right.legend(loc="upper right")


def room_above(axes: Axes, share: float) -> None:
    """Mark zero, and leave room above the curves, so that the legend hides none."""
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + share * (high - low))


if __name__ == "__main__":
    for target in (DOCS / "demo.svg", ROOT / "paper" / "path.png"):
        saved(target, (9, 3.6), draw_demo, 2, facecolor="white")
