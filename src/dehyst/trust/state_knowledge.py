"""When the hysteresis state becomes known from a record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dehyst._views.fields import json_values
from dehyst.control import StateBounds, first_known_by_displacement, least_width, time_dependence
from dehyst.identification import RecordComparison
from dehyst.model import Actuator, GradedSlip, MaxwellSlip

# An element that holds less of the voltage than this has nothing to be homed for.
_SMALL = 1e-9


@dataclass(frozen=True)
class StateKnowledge:
    """Time after which the hysteresis state is observable from a record.

    Attributes
    ----------
    record : str
    by_displacement, by_voltage : float or None
        Time since the record's start [s] after which every element with stiffness is known, from the measured
        displacement and from the voltage alone; None if never.
    judged : bool
        Whether `by_voltage` was judged: the order of voltages does not determine it with creep, inertia, a lag or
        smooth elements.
    """

    record: str
    by_displacement: float | None
    by_voltage: float | None
    judged: bool = True

    @classmethod
    def of(cls, actuator: Actuator, compared: RecordComparison) -> StateKnowledge:
        """Return the state knowledge from a record that was compared with an actuator."""
        stiff, record = _stiff(actuator), compared.record.record
        # Noise widens a range by its extremes; what it adds is no excursion.
        reach = 2 * stiff.slip.breakaway + 4 * compared.record.noise
        ordered = not time_dependence(actuator)
        if not reach.size:
            return cls(record.name, 0.0, 0.0 if ordered else None, ordered)
        # With inertia the elements see what the resonance had to follow, which the pieces hold.
        path = record.displacement if actuator.dynamics is None else compared.pieces[0][1].displacement
        seen = first_known_by_displacement(0.5 * reach, path)
        played = None
        if ordered:
            bounds = StateBounds.at_rest(stiff, float(record.voltage[0]))
            played = bounds.propagate(stiff, record.voltage).first_known(least_width(stiff))

        def time(sample: int | None) -> float | None:
            return None if sample is None else float(record.time[sample] - record.time[0])

        return cls(record.name, time(seen), time(played), ordered)

    def as_dict(self) -> dict[str, object]:
        """JSON values."""
        return json_values(self, "record known_by_displacement_s=by_displacement known_by_voltage_s=by_voltage")


def _stiff(actuator: Actuator) -> Actuator:
    """Return the actuator with only spring, transformer and the slip elements that have stiffness."""
    slip = actuator.slip
    keep = slip.friction > _SMALL * float(np.ptp(actuator.spring.voltage))
    rho, kappa = slip.breakaway[keep], slip.stiffness[keep]
    kept = GradedSlip(rho, slip.knots, kappa) if isinstance(slip, GradedSlip) else MaxwellSlip(rho, kappa)
    return Actuator(kept, actuator.spring, limits=actuator.limits, transformer=actuator.transformer)
