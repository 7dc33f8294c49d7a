"""Sections on an actuator: its parts, a path that a reader drags, and measurements along a path."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dehyst._errors import ModelError
from dehyst._types import Array, Mask
from dehyst._views.html import escape
from dehyst.control import Compensator, PossibleStart
from dehyst.exports import wasm_module
from dehyst.identification import Fit
from dehyst.model import Actuator, Creep, GradedSlip, MaxwellSlip, SmoothSlip, Spring, Transformer
from dehyst.model.summary import Slopes, bend, parts_of, step_response
from dehyst.records.signals import largest, turning_points
from dehyst.report.charts import Axis, Chart, Colour, Series, stems, steps
from dehyst.report.html import (
    MINUS,
    Applet,
    Charts,
    Part,
    Row,
    folded,
    length,
    length_unit,
    number,
    spelled,
    table,
)
from dehyst.trust.turn_plane import turn_plane

if TYPE_CHECKING:
    from dehyst.calibration import TrackedPath


def made_of(actuator: Actuator) -> list[Part]:
    """Return the section; empty for an actuator without further parts, which two other charts show completely."""
    if not actuator.wide:
        return []
    rows: list[Row] = [
        (
            part.name,
            spelled(part.sentence).replace("tau(v)", "τ(v)"),
            "–" if part.holds is None else f"{number(part.holds)} V",
        )
        for part in parts_of(actuator)
    ]
    tables = {} if actuator.creep is None else {"Creep branches": _branches(actuator.creep)}
    charts = [] if actuator.transformer is None else transformer_charts(actuator.transformer)
    if actuator.creep is not None:
        charts.append(creep_chart(actuator))
    if isinstance(actuator.slip, GradedSlip):
        charts += [_graded(actuator.slip), slopes_chart(actuator)]
    if actuator.smooth is not None:
        charts.append(_smooth(actuator.smooth))
        tables["Smooth elements"] = _lengths(actuator.smooth)
    head = ("Part", "What it does", "Holds at most")
    caption = (
        "The parts beyond a plain Maxwell-slip model. In a plain model this line of tau is zero, elements are even "
        "stripes, and there is no creep."
    )
    return [
        f"<h2>What the model is made of</h2>\n{table(head, rows, texts=2)}",
        Charts("", caption, tuple(charts)),
        folded("The parts' numbers", tables),
    ]


def transformer_charts(tau: Transformer) -> list[Chart]:
    """Return tau(v) minus the straight line between its ends, and its slope."""
    off = Series("", tau.voltage, bend(tau), "measured"), Series("", tau.voltage, bend(tau), "measured", "points", 5)
    slope = Series("", *steps(tau.voltage, tau.slopes), "measured")
    x, title = Axis("voltage", "V"), "Transformer"
    return [
        Chart(title, "", "tau less a straight line,", x, Axis("τ(v) less a straight line", "V"), off, zero=True),
        Chart(title, "", "slope of tau,", x, Axis("slope of τ", "V/V", (0.0, 1.1 * float(tau.slopes.max()))), (slope,)),
    ]


def creep_chart(actuator: Actuator) -> Chart:
    """Return the displacement after a sudden rise through all voltages, with the time constants marked."""
    time, share = step_response(actuator)
    top = max(1.25 * 100 * float(share.max()), 1e-9)
    creep = actuator.creep
    constants = np.empty(0) if creep is None else creep.time_constants[creep.stiffness > 0]
    marks = stems("time constants", constants, np.full(constants.shape, top), "simulated", width=1)
    x = Axis("time since the rise", "s", (float(time[0]), float(time[-1])), log=True)
    y = Axis("further displacement", "% of the rise", (0.0, top))
    series = (Series("creep", time, 100 * share, "measured", width=1.8), *marks)
    return Chart("Creep after a sudden rise", "", "displacement over time,", x, y, series)


def _graded(slip: GradedSlip) -> Chart:
    """Return stiffness times breakaway elongation of each element over its slider position; darker is more."""
    factor, unit = length_unit(float(np.ptp(slip.knots)))
    edges = np.concatenate([[0.0], slip.breakaway]) * factor
    held = slip.stiffness * slip.breakaway[:, None]
    axes = Axis("slider position", unit), Axis("breakaway elongation", unit)
    cells = Series("", slip.knots * factor, edges, "measured", "cells", values=held)
    notes = ((f"stiffness times breakaway elongation, darkest {number(float(held.max()))} V", "measured"),)
    return Chart("Graded elements", "", "what each element holds over its position,", *axes, (cells,), notes=notes)


def slopes_chart(actuator: Actuator) -> Chart:
    """Return the slope of slow motion: just after a turn, and when every element slides."""
    steepness = Slopes.of(actuator.slip, actuator.spring)
    factor, unit = length_unit(float(np.ptp(steepness.displacement)))
    curves: tuple[tuple[str, Array, Colour], ...] = (
        ("just after a turn", steepness.turned, "ink"),
        ("rising", steepness.rising, "rising"),
        ("falling", steepness.falling, "falling"),
    )
    # Those of plain elements are equal.
    same = np.array_equal(steepness.rising, steepness.falling)
    series = tuple(
        Series(name, steepness.displacement * factor, values * 1e-6, colour, dashed=same and name == "falling")
        for name, values, colour in curves
    )
    y = Axis("slope of the voltage", "V/µm", (0.0, 1.1e-6 * float(steepness.turned.max())))
    return Chart("Stiffness along the stroke", "", "slopes over", Axis("displacement", unit), y, series)


def _smooth(elements: SmoothSlip) -> Chart:
    """Return the largest voltage that each smooth element holds, over its length."""
    factor, unit = length_unit(float(elements.length.max()))
    held, at = elements.stiffness * elements.length, elements.length * factor
    dahl = elements.closing > 0.75
    kinds: tuple[tuple[Mask, str, Colour, int], ...] = (
        (~dahl, "back on a straight line", "measured", -1),
        (dahl, "back on a curve (Dahl)", "simulated", 1),
    )
    series = [
        one
        for kind, name, colour, aside in kinds
        for x in [at[kind] + 0.008 * aside * at.max()]
        for one in (*stems("", x, held[kind], colour), Series(name, x, held[kind], colour, "points", 6))
    ]
    axes = Axis("length", unit, (0.0, 1.08 * float(at.max()))), Axis("holds at most", "V", _from_zero(held))
    return Chart("Smooth elements", "", "what each holds over its length,", *axes, tuple(series))


def _from_zero(values: Array) -> tuple[float, float]:
    return 0.0, 1.12 * float(values.max()) if values.any() else 1.0


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


def slip_and_spring(actuator: Actuator) -> Charts:
    """Return charts of the slip elements and of the spring."""
    caption = (
        "Among the slip elements, single large values between zeros (hollow circles) show that the records determine "
        "sums of stiffnesses better than single ones. The spring rises everywhere (Assumption I)."
    )
    if isinstance(actuator.slip, GradedSlip):
        caption += " These elements are graded: each is shown with its largest stiffness."
    title = "Its slip elements and spring" if actuator.wide else "The model"
    return Charts(title, caption, (*element_charts(actuator), *spring_charts(actuator.spring)))


def _plain_slip(actuator: Actuator) -> MaxwellSlip:
    return actuator.slip if isinstance(actuator.slip, MaxwellSlip) else actuator.slip.stiffest()


def element_charts(actuator: Actuator) -> tuple[Chart, Chart]:
    """Return stiffness and breakaway voltage of each element over its breakaway elongation; hollow where zero."""
    slip = _plain_slip(actuator)
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho = slip.breakaway * factor

    def chart(values: Array, quantity: str, unit_: str) -> Chart:
        zero = values <= 0
        series = (
            *stems("", rho[~zero], values[~zero], "measured"),
            Series("", rho[~zero], values[~zero], "measured", "points", 5),
            Series("", rho[zero], values[zero], "measured", "points", 5, hollow=True),
        )
        x = Axis("breakaway elongation", unit, (0.0, 1.05 * float(rho[-1])))
        y = Axis(quantity, unit_, _from_zero(values))
        return Chart("Slip elements", "", f"{quantity} of", x, y, tuple(one for one in series if one.x.size))

    return chart(slip.stiffness * 1e-6, "stiffness", "V/µm"), chart(slip.friction, "breakaway voltage", "V")


def spring_charts(spring: Spring) -> tuple[Chart, Chart]:
    """Return the voltage of the parallel spring over displacement, and its slope with the least one marked."""
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    y, slopes = spring.displacement * factor, spring.slopes * 1e-6
    voltage = Series("", y, spring.voltage, "measured"), Series("", y, spring.voltage, "measured", "points", 4)
    least = int(np.argmin(slopes))
    marked = Series("least slope", y[least : least + 2], slopes[[least, least]], "simulated", width=3.4)
    ends = min(0.0, 1.1 * float(slopes.min())), 1.1 * max(float(slopes.max()), 0.0)
    x, title, slope = Axis("displacement", unit), "Parallel spring", Axis("slope", "V/µm", ends)
    return (
        Chart(title, "", "voltage of", x, Axis("spring voltage", "V"), voltage),
        Chart(title, "", "slope of", x, slope, (Series("slope", *steps(y, slopes), "measured"), marked), zero=True),
    )


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


def path_trial(fit: Fit) -> Applet | str:
    """Return the section; nothing without an actuator that has limits."""
    actuator = fit.actuator
    if not isinstance(actuator, Actuator) or actuator.limits is None:
        return ""
    made = _compensator(actuator, _duration(fit))
    if made is None:
        return ""
    (compensator, seconds), share = made, _own_share(fit)
    own = "the error on the actuator itself is that of the model"
    if share is not None:
        own = f"on the records the model itself was wrong by up to {number(100 * share)} % of the stroke"
    moving = ", or where inertia or a delay is not compensated" if actuator.dynamics is not None or actuator.lag else ""
    caption = (
        "Drag the points, or change the limits: this page computes the voltage itself. The model stands for the "
        f"actuator here, so that dehyst misses the path only where a voltage is clamped{moving}; {own}. The last "
        "picture shows between which voltages records and path turn: elsewhere the model is not tested."
    )
    tested = turn_plane([(one.record, one.time, one.voltage) for one in fit.traces], actuator.limits)
    data = {
        "module": base64.b64encode(wasm_module(compensator)).decode("ascii"),
        "samples": SAMPLES,
        "duration": seconds,
        "band": None if share is None else 1e6 * share * fit.errors[0].stroke,
        "tested": None if tested is None else tested.as_dict(),
    }
    body = f'<h2>Try a path</h2>\n<p class="caption">{escape(caption)}</p>\n<section id="path-trial"></section>'
    return Applet(body, "path_trial.js", "path-data", data)


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


def _own_share(fit: Fit) -> float | None:
    """Return the largest error on records that were not trained on, or else on all, as a share of the stroke."""
    errors = [one for one in fit.errors if one.role == "validation"] or list(fit.errors)
    shares = [one.largest / one.stroke for one in errors if one.stroke > 0]
    return max(shares) if shares and np.isfinite(max(shares)) else None


_COLOURS: tuple[Colour, ...] = ("simulated", "measured")
_WORDS = {"nominal": "by a constant ratio", "compensated": "by the model"}


def followed_sections(followed: Mapping[str, TrackedPath]) -> list[Part]:
    """Return a table and charts of the wanted and the reached path and of the errors; empty without a path."""
    if not followed:
        return []
    head = ("Voltage", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        (
            (name, _WORDS.get(name, "")),
            number(path.largest_percent),
            number(path.rms_percent),
            length(largest(path.error)),
        )
        for name, path in followed.items()
    ]
    caption = (
        "The actuator was homed, driven along the path by each voltage, and measured: wanted and reached displacement, "
        "and reached minus wanted, each on a scale of its own. The first leg, from the homing onto the path, is "
        "left out."
    )
    first, time = next(iter(followed.values())), Axis("time", "s")
    factor, unit = length_unit(first.stroke)
    coloured = list(zip(followed.items(), _COLOURS, strict=False))
    reached = [Series(name, path.time, path.reached * factor, colour, exact=True) for (name, path), colour in coloured]
    wanted = Series("wanted", first.time, first.wanted * factor, "ink", exact=True, width=1, dashed=True)
    paths = Chart("Path", "", "wanted and reached displacement,", time, Axis("displacement", unit), (*reached, wanted))
    # The errors differ too much for one scale.
    errors = [
        Chart(
            name,
            _WORDS.get(name, ""),
            "error of",
            time,
            Axis("error", "% of the stroke"),
            (Series("", path.time, 100 * path.error / path.stroke, colour, exact=True),),
            zero=True,
        )
        for (name, path), colour in coloured
    ]
    return [
        f"<h2>Measured along a path</h2>\n{table(head, rows, texts=1)}",
        Charts("", caption, (paths, *errors)),
    ]
