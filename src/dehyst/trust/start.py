"""The state at the end of a record."""

from __future__ import annotations

from dehyst._errors import ModelError
from dehyst._text import digits
from dehyst.control import PossibleStart, model_error, outside_identified
from dehyst.identification import state_after
from dehyst.model import Actuator, stroke_of, voltages_of
from dehyst.records import Record


def start_of(actuator: Actuator, record: Record, *, limits: tuple[float, float] | None = None) -> PossibleStart:
    """Return the state at the end of a record, which its measured displacement determines.

    Parameters
    ----------
    actuator : Actuator
    record : Record
        A record of what was played before; the sensor's zero does not matter.
    limits : (float, float), optional
        Allowed voltages [V], in addition to those of the records.

    Returns
    -------
    PossibleStart
        One state; its remarks name voltages that are offset from those of the records or lie outside of them.

    Raises
    ------
    ModelError
        If displacements or voltages lie far outside of the model's range.
    RecordError
        If the record is too short for a comparison with the model.
    """
    outside = outside_identified(actuator, record.voltage, limits, name=record.name)
    if reason := actuator._implausibility(record.displacement):
        raise ModelError(f"{record.name}: {reason}")
    state, offset = state_after(actuator, record)
    low, high = voltages_of(actuator)
    share = 100 * abs(offset) / (high - low)
    remarks = [*outside.warnings]
    if 0.01 * share * stroke_of(actuator) > model_error(actuator):
        remarks.append(
            f"{record.name}: its voltages differ from the model's by {offset:.4g} V, {digits(share)} % of the range: "
            "expect displacements to differ from the sensor's by as much"
        )
    return PossibleStart(record.name, (state,), tuple(remarks))
