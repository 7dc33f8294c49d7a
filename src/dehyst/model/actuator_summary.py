"""An actuator in words: its line, the lines of `Actuator.summary`, and its HTML."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from dehyst._text import counted, escaped
from dehyst._views import html
from dehyst._views.lines import length, span_of
from dehyst.model.actuator import Actuator
from dehyst.model.elements import GradedSlip
from dehyst.model.summary import parts_of

_FURTHER = {"transformer": "transformer", "creep": "creep", "smooth": "smooth elements", "dynamics": "inertia"}


def one_line(actuator: Actuator) -> str:
    """Return name, parts, voltages and displacements; nothing is computed that could fail."""
    graded = "graded " if isinstance(actuator.slip, GradedSlip) else ""
    further = [words for name, words in _FURTHER.items() if getattr(actuator, name) is not None]
    parts = ", ".join([f"{graded}{counted(len(actuator.slip), 'slip element')}", *further])
    return f"<Actuator '{escaped(actuator.name)}': {parts}, {_limits(actuator)}, {_knots(actuator, 'um')}>"


def lines(actuator: Actuator) -> Iterator[str]:
    """Yield the lines of a summary: ranges, then each part with its sentence."""
    yield f"{escaped(actuator.name)}: {_limits(actuator)}, {_knots(actuator, 'um')} ({_stroke(actuator)})"
    for part in parts_of(actuator):
        holds = "" if part.holds is None else f" Holds {part.holds:.3g} V at most."
        yield f"  {part.name + ':':<18}{part.sentence}{holds}"


def as_html(actuator: Actuator) -> str:
    """Return an actuator for a notebook: ranges, and a table of its parts."""
    rows = [("voltage", _limits(actuator)), ("displacement", f"{_knots(actuator, 'µm')} ({_stroke(actuator)})")]
    rows += [(part.name, part.sentence.replace("um", "µm")) for part in parts_of(actuator)]
    return html.block(f"Actuator '{actuator.name}'", html.facts(rows))


def _limits(actuator: Actuator) -> str:
    return "no voltage limits" if actuator.limits is None else "{:.4g} to {:.4g} V".format(*actuator.limits)


def _knots(actuator: Actuator, unit: str) -> str:
    return span_of(actuator.spring.displacement[[0, -1]], unit, 1e6)


def _stroke(actuator: Actuator) -> str:
    return f"a range of {length(float(np.ptp(actuator.spring.displacement)))}"
