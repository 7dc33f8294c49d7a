"""The README's figure: reached against wanted, with a piece enlarged, and the error in time. Writes `docs/demo.svg`."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dehyst.studies import demo

BEFORE, AFTER = "#8a8a8a", "#d55e00"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "dehyst",
    "axes.linewidth": 0.7,
    "legend.frameon": False,
}
# The enlarged piece: its middle and half its width, as parts of the stroke.
_PIECE = (0.5, 0.04)


def curves(found: demo.Demo) -> tuple[tuple[np.ndarray, str, str], ...]:
    return (found.linear, BEFORE, "straight scale factor"), (found.compensated, AFTER, "dehyst")


def reached(axes: Axes, found: demo.Demo) -> None:
    wanted = found.wanted * 1e6
    for y, colour, name in curves(found):
        axes.plot(wanted, y * 1e6, color=colour, lw=1.2, label=name)
    axes.set(xlabel="wanted (µm)", ylabel="reached (µm)", title="Following a path with nine reversals")
    axes.legend(loc="upper left")
    low, span = wanted.min(), np.ptp(wanted)
    middle, half = low + _PIECE[0] * span, _PIECE[1] * span
    inset = axes.inset_axes((0.62, 0.1, 0.36, 0.36), xlim=(middle - half, middle + half), xticks=[], yticks=[])
    inset.set_ylim(middle - 2.2 * half, middle + 2.2 * half)
    for y, colour, _ in curves(found):
        inset.plot(wanted, y * 1e6, color=colour, lw=1.2)
    inset.set_facecolor("white")
    axes.indicate_inset_zoom(inset, edgecolor="0.4")


def errors(axes: Axes, found: demo.Demo) -> None:
    for y, colour, name in curves(found):
        error = 100 * (y - found.wanted) / found.stroke
        axes.plot(found.time, error, color=colour, lw=1.2, label=f"{name}: at most {np.abs(error).max():.2f} %")
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    axes.set(xlabel="time (s)", ylabel="error (% of stroke)", title="Its error")
    # Room above the curves, so that the legend hides none.
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))
    axes.legend(loc="upper right")


def main() -> None:
    found = demo.run()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.6), layout="constrained", facecolor="white")
        left, right = figure.subplots(1, 2)
        reached(left, found)
        errors(right, found)
        target = Path(__file__).resolve().parents[1] / "docs" / "demo.svg"
        target.parent.mkdir(exist_ok=True)
        figure.savefig(target, metadata={"Date": None})
    print(target.name)


if __name__ == "__main__":
    main()
