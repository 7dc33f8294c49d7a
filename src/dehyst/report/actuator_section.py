"""Sections on an actuator: its parts, a path that a reader drags, and measurements along a path."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array
from dehyst.control import Compensator, PossibleStart
from dehyst.exports import wasm_module
from dehyst.exports.naming import shipped
from dehyst.identification import Fit
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip
from dehyst.model.summary import parts_of
from dehyst.records.signals import turning_points
from dehyst.report import plots
from dehyst.report.html import MINUS, Applet, Row, asset, escape, figure, folded, length, number, panel, spelled, table
from dehyst.report.plots import INK, MEASURED, SIMULATED, length_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from dehyst.calibration import TrackedPath


def made_of(actuator: Actuator) -> str:
    """Return the section; empty for a plain actuator, which two other figures show completely.

    Raise `MissingExtraError` if matplotlib is not installed.
    """
    if not actuator.wide:
        return ""
    rows: list[Row] = [
        (part.name, _spelt(part.sentence), "–" if part.holds is None else f"{number(part.holds)} V")
        for part in parts_of(actuator)
    ]
    head = ("Part", "What it does", "Holds at most")
    parts = table(head, rows, texts=2), figure("", _CAPTION, _panels(actuator)), _tables(actuator)
    return "\n".join(["<h2>What the model is made of</h2>", *filter(None, parts)])


_CAPTION = (
    "The parts beyond a plain Maxwell-slip model. In a plain model this line of tau is zero, elements are even "
    "stripes, and there is no creep."
)


def _panels(actuator: Actuator) -> list[str]:
    found, slip = [], actuator.slip
    if actuator.transformer is not None:
        found.append(panel("Transformer", "tau", plots.draw_transformer, actuator.transformer, rows=2, height=4.4))
    if actuator.creep is not None:
        found.append(panel("Creep after a sudden rise", "creep", plots.draw_creep, actuator))
    if isinstance(slip, GradedSlip):
        found.append(panel("Graded elements", "graded", plots.draw_graded, slip, height=3.6))
        drawn = plots.draw_slopes, slip, actuator.spring
        found.append(panel("Stiffness along the stroke", "slopes", *drawn, height=3.6))
    if actuator.smooth is not None:
        found.append(panel("Smooth elements", "smooth", plots.draw_smooth, actuator.smooth))
    return found


def _tables(actuator: Actuator) -> str:
    tables = {"Creep branches": _branches(actuator.creep)} if actuator.creep is not None else {}
    if actuator.smooth is not None:
        tables["Smooth elements"] = _lengths(actuator.smooth)
    return folded("The parts' numbers", tables)


def _branches(creep: Creep) -> str:
    total = float(creep.stiffness.sum()) or 1.0
    rows: list[Row] = [
        (number(tau), number(c * 1e-6), f"{number(100 * c / total)} %")
        for tau, c in zip(creep.time_constants, creep.stiffness, strict=True)
    ]
    return table(("Time constant (s)", "cⱼ (V/µm)", "of all"), rows, texts=0)


def _lengths(smooth: SmoothSlip) -> str:
    rows: list[Row] = [
        (number(length * 1e6), number(closing), number(k * 1e-6), number(k * length))
        for length, closing, k in zip(smooth.length, smooth.closing, smooth.stiffness, strict=True)
    ]
    return table(("Length (µm)", "Closing", "k (V/µm)", "Holds (V)"), rows, texts=0)


def _spelt(words: str) -> str:
    return spelled(words).replace("tau(v)", "τ(v)")


def slip_and_spring(actuator: Actuator) -> str:
    """Return figures of the slip elements and of the spring."""
    slip = panel("Slip elements", "slip", plots.draw_slip_elements, _plain_slip(actuator), rows=2, height=4.4)
    spring = panel("Parallel spring", "spring", plots.draw_spring, actuator.spring, rows=2, height=4.4)
    caption = (
        "Among the slip elements, single large values between zeros (hollow circles) show that the records determine "
        "sums of stiffnesses better than single ones. The spring rises everywhere (Assumption I)."
    )
    if isinstance(actuator.slip, GradedSlip):
        caption += " These elements are graded: each is shown with its largest stiffness."
    return figure("Its slip elements and spring" if actuator.wide else "The model", caption, [slip, spring])


def _plain_slip(actuator: Actuator) -> MaxwellSlip:
    return actuator.slip if isinstance(actuator.slip, MaxwellSlip) else actuator.slip.stiffest()


def numbers(actuator: Actuator) -> str:
    """Return tables of the slip elements and of the knots of the spring."""
    slip, spring = _plain_slip(actuator), actuator.spring
    each = [str(i) for i in range(1, len(slip) + 1)]
    columns = (slip.breakaway * 1e6, slip.stiffness * 1e-6, slip.friction)
    elements = zip(each, *map(_column, columns), strict=True)
    each = [str(i) for i in range(1, spring.voltage.size + 1)]
    knots = zip(each, _column(spring.displacement * 1e6), _column(spring.voltage), strict=True)
    first = table(("i", "ρᵢ (µm)", "κᵢ (V/µm)", "fᵢ = κᵢ ρᵢ (V)"), elements, texts=0)
    second = table(("Knot", "y (µm)", "η (V)"), knots, texts=0)
    return folded("The model's numbers", {"Slip elements": first, "Knots of the parallel spring": second})


def _column(values: Array) -> list[str]:
    """Write a column with the decimals that give its largest value six digits."""
    largest = float(np.abs(values).max())
    decimals = min(12, max(0, 5 - math.floor(math.log10(largest)))) if largest > 0 else 0
    return [f"{float(value):.{decimals}f}".replace("-", MINUS) if value else "0" for value in values]


SAMPLES = 2001
_SECONDS, _LEGS, _HALVINGS = 1.0, 8, 12
# Samples in which turning points are looked for, and how far a voltage goes back at one, as a share of its range.
_ENOUGH, _BAND = 20_000, 0.1
_TITLE = "Try a path"
_PATH_CAPTION = (
    "Drag the points, or change their number and the limits: this page computes the voltage itself. The model stands "
    "for the actuator here, so that dehyst misses the path only where a voltage is clamped{moving}; {own}."
)
_MOVING = ", or where inertia or a delay is not compensated"
_KEYS = (
    "Points: drag, or Tab to one and use the arrow keys (with Shift ten times as far), Insert and Delete. A double "
    "click adds one."
)
_SHAPES = {"shrinking": "shrinking loops", "triangle": "triangle", "staircase": "staircase", "scan": "scan"}


def path_trial(fit: Fit) -> Applet | str:
    """Return the section; nothing without an actuator that has limits."""
    actuator = fit.actuator
    if not isinstance(actuator, Actuator) or actuator.limits is None:
        return ""
    made = _compensator(actuator, _duration(fit))
    if made is None:
        return ""
    (compensator, seconds), share = made, _own_share(fit)
    data = {
        "module": base64.b64encode(wasm_module(compensator)).decode("ascii"),
        "samples": SAMPLES,
        "duration": seconds,
        "band": None if share is None else share * fit.errors[0].stroke,
    }
    # One module: what these files import from each other stands before it.
    scripts = (shipped("compensator.js"), asset("plot.js"), asset("path.js"))
    return Applet(_body(fit, actuator), scripts, asset("path.css"), "path-data", data)


def _duration(fit: Fit) -> float:
    """Return how long a path may take [s]: a multiple of the legs of the first record, rounded to one digit."""
    trace = fit.traces[0] if fit.traces else None
    if trace is None or not trace.time.size:
        return _SECONDS
    voltage = trace.voltage[:: 1 + trace.voltage.size // _ENOUGH]
    turns = max(len(turning_points(voltage, _BAND * float(np.ptp(voltage)))), 1)
    seconds = _LEGS * float(trace.time[-1] - trace.time[0]) / turns
    return float(f"{seconds:.1g}") if seconds > 0 else _SECONDS


def _compensator(actuator: Actuator, seconds: float) -> tuple[Compensator, float] | None:
    """Return a compensator that begins at the bottom, and its duration: shorter if a resonance needs that."""
    start = PossibleStart.named(actuator, "bottom").state
    for _ in range(_HALVINGS):
        try:
            compensator = Compensator(actuator, period=seconds / (SAMPLES - 1), state=start)
            # Both raise where this model cannot be computed with.
            _ = compensator.tables(), compensator.reach
        except ModelError:
            seconds /= 2
        else:
            return compensator, seconds
    return None


def _body(fit: Fit, actuator: Actuator) -> str:
    moving = _MOVING if actuator.dynamics is not None or actuator.lag else ""
    caption = _PATH_CAPTION.format(moving=moving, own=_own_error(fit))
    options = "".join(f'<option value="{value}">{words}</option>' for value, words in _SHAPES.items())
    fields = (
        f'<label>Path <select name="shape">{options}</select></label>',
        '<label>Lowest voltage (V) <input name="low" type="number" step="any"></label>',
        '<label>Highest voltage (V) <input name="high" type="number" step="any"></label>',
        '<label>Slew rate (V/s) <input name="slew" type="number" min="0" step="any" placeholder="any"></label>',
        '<label>Duration (s) <input name="duration" type="number" min="0" step="any"></label>',
        '<button type="button" name="add">Add a point</button>',
        '<button type="button" name="remove">Remove the point</button>',
    )
    both = ("without", "straight scale factor"), ("simulated", "dehyst")
    band = [("band", "largest error on the records")] if _own_share(fit) is not None else []
    panels = (
        f'<div class="panel"><h3>Path</h3>\n{_legend(*both, ("ink", "wanted path"))}\n<div class="field">'
        '<canvas role="img" aria-label="Wanted path, and where both voltages lead"></canvas></div>\n'
        f'<p class="hint">{_KEYS}</p></div>',
        f'<div class="panel"><h3>Voltage</h3>\n{_legend(*both, ("measured", "clamped"), ("line", "limits"))}\n'
        '<canvas role="img" aria-label="Voltages of both, and the limits"></canvas></div>',
        f'<div class="panel"><h3>Error</h3>\n{_legend(*both, *band)}\n'
        '<canvas role="img" aria-label="Errors of both along the path"></canvas></div>',
    )
    return (
        f'<h2>{_TITLE}</h2>\n<figure id="path-trial">\n<figcaption>{escape(caption)}</figcaption>\n'
        f'<div class="controls">\n{_lines(fields)}\n</div>\n<output></output>\n'
        f'<div class="panels one">\n{_lines(panels)}\n</div>\n</figure>'
    )


def _lines(parts: tuple[str, ...]) -> str:
    return "\n".join(parts)


def _legend(*entries: tuple[str, str]) -> str:
    keys = "".join(f'<span><i style="background:var(--{colour})"></i>{name}</span>' for colour, name in entries)
    return f'<p class="keys">{keys}</p>'


def _own_error(fit: Fit) -> str:
    """Say what remains on the actuator itself."""
    share = _own_share(fit)
    if share is None:
        return "the error on the actuator itself is that of the model"
    return f"on the records the model itself was wrong by up to {number(100 * share)} % of the stroke"


def _own_share(fit: Fit) -> float | None:
    """Return the largest error on records that were not trained on, or else on all, as a share of the stroke."""
    errors = [one for one in fit.errors if one.role == "validation"] or list(fit.errors)
    shares = [one.largest / one.stroke for one in errors if one.stroke > 0]
    return max(shares) if shares and np.isfinite(max(shares)) else None


_COLOURS = (SIMULATED, MEASURED)
_WORDS = {"nominal": "by a constant ratio", "compensated": "by the model"}


def followed_sections(followed: Mapping[str, TrackedPath]) -> list[str]:
    """Return a table and figures of the wanted and the reached path and of the errors; empty without a path."""
    if not followed:
        return []
    head = ("Voltage", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        (
            (name, _WORDS.get(name, "")),
            number(path.largest_percent),
            number(path.rms_percent),
            length(float(np.abs(path.error).max())),
        )
        for name, path in followed.items()
    ]
    caption = (
        "The actuator was homed, driven along the path by each voltage, and measured: wanted and reached displacement, "
        "and reached minus wanted, each on a scale of its own. The first leg, from the homing onto the path, is "
        "left out."
    )
    return [
        "<h2>Measured along a path</h2>",
        table(head, rows, texts=1),
        figure("", caption, [panel("Path", "path", _draw_paths, followed, label="Path"), *_errors(followed)]),
    ]


def _draw_paths(ax: Axes, followed: Mapping[str, TrackedPath]) -> None:
    first = next(iter(followed.values()))
    factor, unit = length_unit(first.stroke)
    for (name, path), colour in zip(followed.items(), _COLOURS, strict=False):
        ax.plot(path.time, path.reached * factor, color=colour, lw=1.2, label=name)
    ax.plot(first.time, first.wanted * factor, color=INK, lw=0.8, ls="--", label="wanted")
    ax.set(xlabel="time (s)", ylabel=f"displacement ({unit})")
    ax.legend(loc="upper center", ncols=3)
    ax.margins(y=0.15)


def _errors(followed: Mapping[str, TrackedPath]) -> list[str]:
    """Return one panel for each voltage, on its own scale: the errors differ too much for one scale."""
    return [
        panel(name, f"error-{name}", _draw_error, path, colour, role=_WORDS.get(name, ""), label="Error of")
        for (name, path), colour in zip(followed.items(), _COLOURS, strict=False)
    ]


def _draw_error(ax: Axes, path: TrackedPath, colour: str) -> None:
    ax.plot(path.time, 100 * path.error / path.stroke, color=colour, lw=1)
    ax.axhline(0, color=INK, lw=0.8)
    ax.set(xlabel="time (s)", ylabel="error (% of the stroke)")
