"""Sections for plain and wider models: warnings, the prediction band of a trajectory, knowledge of the state."""

from __future__ import annotations

from dehyst.control import Homing
from dehyst.report import uncertainty_plots
from dehyst.report.html import Row, escape, figure, length, number, panel, table
from dehyst.uncertainty import Insight
from dehyst.uncertainty.prediction_band import ERRORS
from dehyst.uncertainty.wide_insight import WideInsight


def verdict(found: Insight | WideInsight, word: str, good: str) -> str:
    """Return the warnings, or the good verdict if there are none."""
    warnings = found.warnings()
    if not warnings:
        return f'<p class="outcome green"><strong>{word}</strong> {good}</p>'
    return f'<p class="outcome amber"><strong>Warning</strong> {"<br>".join(map(escape, warnings))}</p>'


def trajectory(found: Insight | WideInsight) -> str:
    """Return the prediction band along a trajectory; empty without one."""
    if found.band is None:
        return ""
    stroke, errors = found.evidence.stroke, found.band.errors()
    rows: list[Row] = [
        (ERRORS[key], f"{number(100 * error / stroke)} %", length(error))
        for key, error in errors.items()
        if error or key != "clamped"
    ]
    drawn = panel(("Along the trajectory", ""), uncertainty_plots.band(found.band, stroke, name="band"), "")
    body = f'<div class="panel"><h3>Largest error to expect</h3>\n{table(("From", "of stroke", ""), rows, 1)}</div>'
    caption = "How far the displacement may be from the wanted path if the compensating voltage is played."
    return figure("The trajectory", caption, [drawn, body])


def state(found: Insight | WideInsight) -> str:
    """Return a table of when the state becomes known, and the homing."""

    def moment(seconds: float | None) -> str:
        return "never" if seconds is None else f"{number(seconds)} s"

    rows: list[Row] = [
        (known.record, moment(known.by_displacement), moment(known.by_voltage) if known.judged else "not judged")
        for known in found.knowledge
    ]
    head = ("Record", "from the measured displacement", "from the voltage alone")
    parts = ["<h2>When the state becomes known</h2>", table(head, rows, texts=1)]
    if found.homing is not None:
        parts.append(_homing(found.homing, creeps=found.actuator.creep is not None))
    return "\n".join(parts)


def _homing(homing: Homing, *, creeps: bool) -> str:
    turns = ", ".join(number(v, 6) for v in homing.turns)
    remarks = escape(" ".join(homing.remarks))
    if homing.played is None:
        word = "certified: every state at rest ends in one" if homing.certified else "not certified"
        return f"<p>Shortest homing: {escape(turns)} V ({word}). {remarks}</p>"
    word = "certified" if homing.certified else "not certified"
    way = ", ".join(f"{v:.6g}" for v in homing.turns)
    sentence = escape(
        f"{way} V in {number(homing.played.duration)} s{', with holds at both limits' if creeps else ''} ({word}): "
        f"after any history within the limits, it makes the displacement known to {length(homing.error)}."
    )
    items = "\n".join(f"<li>{escape(remark.replace(' um', ' µm'))}</li>" for remark in homing.remarks)
    return f"<p>Homing: {sentence}</p>\n<ul>\n{items}\n</ul>"
