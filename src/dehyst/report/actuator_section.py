"""Sections on an actuator: its parts, and measurements along a path."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from dehyst._types import Array, Mask
from dehyst.model import (
    Actuator,
    GradedSlip,
    Slopes,
    SmoothSlip,
    Spring,
    Transformer,
    bend,
    parts_of,
    step_response,
)
from dehyst.records import largest
from dehyst.report import html
from dehyst.report.charts import Axis, Chart, Colour, Kind, Series, stems, steps
from dehyst.report.html import MINUS, Charts, Part, Row, length, length_unit, number

if TYPE_CHECKING:
    from dehyst.calibration import TrackedPath


def made_of(actuator: Actuator) -> list[Part]:
    """Return the section: what each part does, its charts and its numbers."""
    rows: list[Row] = [
        (
            part.name,
            html.spelled(part.sentence).replace("tau(v)", "τ(v)"),
            "–" if part.holds is None else f"{number(part.holds)} V",
        )
        for part in parts_of(actuator)
    ]
    caption = (
        "Among the slip elements, single large values between zeros (hollow circles) show that the records determine "
        "sums of stiffnesses better than single ones. The spring rises everywhere (Assumption I)."
    )
    tables, charts = _slip_and_spring(actuator), [*element_charts(actuator), *spring_charts(actuator.spring)]
    if isinstance(actuator.slip, GradedSlip):
        caption += " Graded elements are shown with their largest stiffness."
        charts += [_graded(actuator.slip), slopes_chart(actuator)]
    if actuator.transformer is not None:
        charts += _transformer(actuator.transformer)
    if (creep := actuator.displacement_creep) is not None:
        charts.append(creep_chart(actuator))
        each = ((number(tau), f"{number(100 * g)} %") for tau, g in zip(creep.time_constants, creep.gains, strict=True))
        tables["Creep branches"] = html.table(("Time constant (s)", "Gain"), each, texts=0)
    if (smooth := actuator.smooth) is not None:
        charts.append(_smooth(smooth))
        elements = zip(smooth.length, smooth.closing, smooth.stiffness, strict=True)
        numbers = (tuple(map(number, (y * 1e6, closing, k * 1e-6, k * y))) for y, closing, k in elements)
        head = ("Length (µm)", "Closing", "k (V/µm)", "Holds (V)")
        tables["Smooth elements"] = html.table(head, numbers, texts=0)
    parts = html.table(("Part", "What it does", "Holds at most"), rows, texts=2)
    return [
        f"<h2>What the model is made of</h2>\n{parts}",
        Charts("", caption, charts),
        html.folded("The model's numbers", tables),
    ]


def _transformer(tau: Transformer) -> list[Chart]:
    """Return tau(v) minus the straight line between its ends, and its slope."""
    kinds: tuple[Kind, ...] = ("line", "points")
    off = [Series("", tau.voltage, bend(tau), "measured", kind, 4) for kind in kinds]
    slope = Series("", *steps(tau.voltage, tau.slopes), "measured")
    x, y = Axis("voltage", "V"), Axis("slope of τ", "V/V", _from_zero(tau.slopes))
    return [
        Chart("Transformer", x, Axis("τ(v) less a straight line", "V"), off, zero=True),
        Chart("Transformer", x, y, [slope]),
    ]


def creep_chart(actuator: Actuator) -> Chart:
    """Return the displacement after a sudden rise through all voltages, with the time constants marked."""
    time, share = step_response(actuator)
    top = max(1.25 * 100 * float(share.max()), 1e-9)
    creep = actuator.displacement_creep
    constants = np.empty(0) if creep is None else creep.time_constants[creep.gains > 0]
    marks = stems("time constants", constants, np.full(constants.shape, top), "simulated", width=1)
    x = Axis("time since the rise", "s", (float(time[0]), float(time[-1])), log=True)
    y = Axis("further displacement", "% of the rise", (0.0, top))
    return Chart("Creep after a sudden rise", x, y, [Series("creep", time, 100 * share, "measured", width=1.8), *marks])


def _graded(slip: GradedSlip) -> Chart:
    """Return stiffness times breakaway elongation of each element over its slider position; darker is more."""
    factor, unit = length_unit(float(np.ptp(slip.knots)))
    edges = np.concatenate([[0.0], slip.breakaway]) * factor
    held = slip.stiffness * slip.breakaway[:, None]
    cells = Series("", slip.knots * factor, edges, "measured", "cells", values=held)
    notes = [(f"stiffness times breakaway elongation, darkest {number(float(held.max()))} V", "measured")]
    axes = Axis("slider position", unit), Axis("breakaway elongation", unit)
    return Chart("Graded elements", *axes, [cells], notes=notes)


def slopes_chart(actuator: Actuator) -> Chart:
    """Return the slope of slow motion: just after a turn, and when every element slides."""
    found = Slopes.of(actuator.slip, actuator.spring)
    factor, unit = length_unit(float(np.ptp(found.displacement)))
    # Those of plain elements are equal.
    same = np.array_equal(found.rising, found.falling)
    y = found.displacement * factor
    series = [
        Series("just after a turn", y, found.turned * 1e-6, "ink"),
        Series("rising", y, found.rising * 1e-6, "rising"),
        Series("falling", y, found.falling * 1e-6, "falling", dashed=same),
    ]
    slope = Axis("slope of the voltage", "V/µm", _from_zero(found.turned * 1e-6))
    return Chart("Stiffness along the stroke", Axis("displacement", unit), slope, series)


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
    axes = Axis("length", unit, _from_zero(at)), Axis("holds at most", "V", _from_zero(held))
    return Chart("Smooth elements", *axes, series)


def _from_zero(values: Array) -> tuple[float, float]:
    return 0.0, 1.1 * float(values.max()) if values.any() else 1.0


def element_charts(actuator: Actuator) -> list[Chart]:
    """Return stiffness and breakaway voltage of each element over its breakaway elongation; hollow where zero."""
    slip = actuator.slip.stiffest()
    factor, unit = length_unit(float(slip.breakaway[-1]))
    rho, charts = slip.breakaway * factor, []
    for values, quantity, in_ in (
        (slip.stiffness * 1e-6, "stiffness", "V/µm"),
        (slip.friction, "breakaway voltage", "V"),
    ):
        zero = values <= 0
        series = (
            *stems("", rho[~zero], values[~zero], "measured"),
            Series("", rho[~zero], values[~zero], "measured", "points", 5),
            Series("", rho[zero], values[zero], "measured", "points", 5, hollow=True),
        )
        axes = Axis("breakaway elongation", unit, _from_zero(rho)), Axis(quantity, in_, _from_zero(values))
        charts.append(Chart("Slip elements", *axes, [one for one in series if one.x.size]))
    return charts


def spring_charts(spring: Spring) -> list[Chart]:
    """Return the voltage of the parallel spring over displacement, and its slope with the least one marked."""
    factor, unit = length_unit(float(np.ptp(spring.displacement)))
    y, slopes = spring.displacement * factor, spring.slopes * 1e-6
    kinds: tuple[Kind, ...] = ("line", "points")
    voltage = [Series("", y, spring.voltage, "measured", kind, 3) for kind in kinds]
    least = int(np.argmin(slopes))
    marked = Series("least slope", y[least : least + 2], slopes[[least, least]], "simulated", width=3.4)
    ends = min(0.0, 1.1 * float(slopes.min())), 1.1 * max(float(slopes.max()), 0.0)
    x, slope = Axis("displacement", unit), Series("slope", *steps(y, slopes), "measured")
    return [
        Chart("Parallel spring", x, Axis("spring voltage", "V"), voltage),
        Chart("Parallel spring", x, Axis("slope", "V/µm", ends), [slope, marked], zero=True),
    ]


def _slip_and_spring(actuator: Actuator) -> dict[str, str]:
    """Return tables of the slip elements and of the knots of the spring."""

    def rows(*columns: Array) -> Iterable[Row]:
        # As many decimals as give the largest value of a column six digits.
        decimals = [5 - math.floor(math.log10(most)) if (most := largest(one)) else 0 for one in columns]
        for i, row in enumerate(zip(*columns, strict=True), 1):
            written = (
                f"{value:.{min(12, max(0, n))}f}" if value else "0" for value, n in zip(row, decimals, strict=True)
            )
            yield (str(i), *(text.replace("-", MINUS) for text in written))

    slip, spring = actuator.slip.stiffest(), actuator.spring
    elements = rows(slip.breakaway * 1e6, slip.stiffness * 1e-6, slip.friction)
    knots = rows(spring.displacement * 1e6, spring.voltage)
    return {
        "Slip elements": html.table(("i", "ρᵢ (µm)", "κᵢ (V/µm)", "fᵢ = κᵢ ρᵢ (V)"), elements, texts=0),
        "Knots of the parallel spring": html.table(("Knot", "y (µm)", "η (V)"), knots, texts=0),
    }


_COLOURS: tuple[Colour, ...] = ("simulated", "measured")
_WORDS = {"nominal": "by a constant ratio", "compensated": "by the model"}


def followed_sections(followed: Mapping[str, TrackedPath]) -> list[Part]:
    """Return a table and charts of the wanted and the reached path and of the errors; empty without a path."""
    if not followed:
        return []
    head = ("", "Largest error, % of the stroke", "RMS, %", "Largest")
    rows = [
        ((name, _WORDS.get(name, "")), number(one.largest_percent), number(one.rms_percent), length(largest(one.error)))
        for name, one in followed.items()
    ]
    caption = (
        "The actuator was homed, driven along the path by each voltage, and measured: wanted and reached displacement, "
        "and reached minus wanted, each on a scale of its own. The way from the homing onto the path is left out."
    )
    first, time = next(iter(followed.values())), Axis("time", "s")
    factor, unit = length_unit(first.stroke)
    reached, errors = [], []
    for (name, one), colour in zip(followed.items(), _COLOURS, strict=False):
        reached.append(Series(name, one.time, one.reached * factor, colour))
        # The errors differ too much for one scale.
        error = Series("", one.time, 100 * one.error / one.stroke, colour)
        role = _WORDS.get(name, "")
        errors.append(Chart(f"Error, {name}", time, Axis("error", "% of the stroke"), [error], role=role, zero=True))
    wanted = Series("wanted", first.time, first.wanted * factor, "ink", width=1, dashed=True)
    path = Chart("Path", time, Axis("displacement", unit), [*reached, wanted])
    return [
        f"<h2>Measured along a path</h2>\n{html.table(head, rows, texts=1)}",
        Charts("", caption, [path, *errors]),
    ]
