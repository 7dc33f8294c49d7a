"""The README's figure: the loops of the virtual actuator, and the error of following a path. Writes `docs/demo.svg`."""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dehyst.studies import demo

MEASURED, OURS = "#0072b2", "#d55e00"
STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "dehyst",
    "axes.linewidth": 0.7,
    "legend.frameon": False,
}


def loops(axes: Axes, found: demo.Demo) -> None:
    trace = found.fit.traces[0]
    axes.plot(trace.voltage, trace.measured * 1e6, color=MEASURED, lw=2.5, alpha=0.5, label="measured")
    axes.plot(trace.voltage, trace.simulated * 1e6, color=OURS, lw=0.6, label="identified model")
    axes.set(xlabel="voltage (V)", ylabel="displacement (µm)", title="Loops, measured and simulated")
    axes.legend(loc="upper left")


def tracking(axes: Axes, found: demo.Demo) -> None:
    for reached, colour, name in ((found.linear, MEASURED, "linear feedforward"), (found.compensated, OURS, "dehyst")):
        error = 100 * (reached - found.wanted) / found.stroke
        axes.plot(found.time, error, color=colour, lw=1.2, label=f"{name}: at most {np.abs(error).max():.2f} %")
    axes.axhline(0, color="0.6", lw=0.5, zorder=0)
    axes.set(xlabel="time (s)", ylabel="error (% of stroke)", title="Following a path with nine reversals")
    # Room above the curves, so that the legend hides none.
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.3 * (high - low))
    axes.legend(loc="upper right")


def main() -> None:
    found = demo.run()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(9, 3.4), layout="constrained")
        left, right = figure.subplots(1, 2)
        loops(left, found)
        tracking(right, found)
        target = Path(__file__).resolve().parents[1] / "docs" / "demo.svg"
        target.parent.mkdir(exist_ok=True)
        figure.savefig(target, metadata={"Date": None})
    print(target.name)


if __name__ == "__main__":
    main()
