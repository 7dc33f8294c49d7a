"""The section where a reader drags a path and sees voltage, clamps and errors, computed by WebAssembly in the page."""

from __future__ import annotations

import base64

import numpy as np

from dehyst._errors import ModelError
from dehyst.control import Compensator, PossibleStart
from dehyst.exports import wasm_module
from dehyst.exports.shipped import shipped
from dehyst.model import Actuator, Fit
from dehyst.records.signals import turning_points
from dehyst.report.html import Applet, asset, escape, number

SAMPLES = 2001
_SECONDS, _LEGS, _HALVINGS = 1.0, 8, 12
# Samples in which turning points are looked for, and how far a voltage goes back at one, as a share of its range.
_ENOUGH, _BAND = 20_000, 0.1
_TITLE = "Try a path"
_CAPTION = (
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
    """Return how long a path may take [s]: so many legs of the first record, rounded to one digit."""
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
    caption = _CAPTION.format(moving=moving, own=_own_error(fit))
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
