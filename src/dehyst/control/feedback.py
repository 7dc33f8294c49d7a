"""Feedback: an integral of the measured error, ahead of the compensator."""

from __future__ import annotations

import numpy as np

from dehyst import _native
from dehyst._errors import ModelError
from dehyst._native import CoreError
from dehyst._validation import number
from dehyst.control.axis import Axis
from dehyst.control.compensator import Compensator, only_axis
from dehyst.control.limits import SensorFault, sensor_bound, warn_of_sensor


class Feedback:
    """An integral of the error ahead of a compensator, for a sensor that can be read while the stage moves.

    Each reading removes a share `gain` of the error: wanted minus measured displacement, or the difference of model and
    sensor while voltages are clamped. The integral does not wind up, because the model knows the voltages that were
    really sent. A sensor may be slower than the loop: without a reading the correction is held, and after a cycle
    without a reading its mean stays. If sensor and model disagree more and more on a path that repeats, three cycles
    have no correction: they show whether the sensor is late by whole cycles::

        feedback = dehyst.Feedback(compensator)
        for wanted in path:
            dac.write(feedback.step(wanted, sensor.read()))

    This is what `dehyst_feedback_step` does on a microcontroller, bit for bit.

    Parameters
    ----------
    compensator : Compensator
        A compensator with a period, which only this feedback steps. With `preview`, its delay and resonance are
        compensated, and the gain is higher.
    margin_db : float, optional
        Gain margin [dB] with the identified resonance, see `Actuator.margins`.
    bound : float, optional
        Largest correction [`units` of the compensator], and the largest distance of a reading from the model: a reading
        farther away counts as missing. Default: a twentieth of the compensator's reach.

    Attributes
    ----------
    compensator, bound
        As given.
    gain : float
        Share of the error that each reading removes.
    bandwidth : float
        Frequency [Hz] below which disturbances are reduced by 3 dB or more, with a reading each period.

    Raise `ModelError` if the compensator has no period, the bound is not within 0 and a quarter of the reach, or a
    delay has more than 63 periods.
    """

    def __init__(self, compensator: Compensator, margin_db: float = 6.0, *, bound: float | None = None) -> None:
        axis = only_axis(compensator)
        if axis.period is None:
            raise ModelError("a feedback needs the time between steps", hint="give the period [s]", change=("period",))
        self.compensator, self.bound = compensator, sensor_bound(axis.per_metre * axis.width, bound)
        self.gain, self.bandwidth = axis.actuator.margins(axis.period, margin_db, preview=axis.previews)
        self.reset()

    def __repr__(self) -> str:
        state = "believed" if self.believed else self.fault.name
        return f"<Feedback of gain {self.gain:.3g}, {self.bandwidth:.3g} Hz, sensor {state}>"

    def step(self, wanted: float, measured: float | None = None) -> float:
        """Return the voltage [V] to send for a `wanted` displacement [m, or `units`], and commit it.

        `measured`: the displacement [m, or `units`] after all voltages sent so far, or None if there is no reading. A
        value that is not finite counts as no reading.

        Raise `ModelError` as `Compensator.step`: the memory is unchanged. Warn `ClampWarning` as `Compensator.step`,
        and `SensorWarning` once, when the sensor is no longer believed.
        """
        believed = self.believed
        if self._loop is not self.compensator._axes[0].loop:
            # The compensator was reset.
            self.reset()
        try:
            voltage = self._core.step(wanted, measured)
        except TypeError:
            plain = measured is None or isinstance(measured, np.floating)
            reading = measured if plain else number(measured, "measured")
            voltage = self._core.step(number(wanted, "wanted"), None if reading is None else float(reading))
        except CoreError as error:
            raise ModelError(argument="wanted", got=repr(wanted), need="a finite number") from error
        if believed and not self.believed:
            warn_of_sensor(self.fault, self.bound / self._axis.per_metre)
        return voltage

    @property
    def _axis(self) -> Axis:
        return only_axis(self.compensator)

    @property
    def correction(self) -> float:
        """The displacement [m, or `units`] that is added to the wanted one."""
        return self._core.correction * self._axis.per_metre

    @property
    def fault(self) -> SensorFault:
        """Why the sensor is not believed; `SensorFault.NONE` if it is."""
        return SensorFault(self._core.fault)

    @property
    def believed(self) -> bool:
        """Whether the sensor is believed; once it is not, only `reset` trusts it again."""
        return self._core.fault == 0

    def reset(self) -> None:
        """Believe the sensor again, and begin without a correction."""
        axis = self._axis
        late = axis.preview[1] if axis.previews else round(axis.actuator.delay / (axis.period or 1.0))
        self._loop = axis.loop
        try:
            self._core = _native.Feedback(self._loop, self.gain, self.bound / axis.per_metre, late)
        except CoreError as error:
            raise ModelError(
                argument="compensator", got=f"a delay of {late} periods", need="63 at most", hint="give a longer period"
            ) from error
