"""The limits of an axis, its present voltage (from sent voltages, times and readings), and ramps from there."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator, Sequence
from typing import TYPE_CHECKING, Self, TypeAlias

import numpy as np

from dehyst._errors import DeviceError, LinkError, RigError
from dehyst._types import Array
from dehyst._validation import for_each, interval, number
from dehyst.control import VoltageLimits
from dehyst.instruments.waves import READBACK_TOLERANCE, driver_errors

if TYPE_CHECKING:
    from dehyst.instruments.base import AbstractRig

# One value for all axes, or one for each; None for an axis: that of the device.
AxisLimits: TypeAlias = Sequence[tuple[float, float] | None] | tuple[float, float] | None
AxisSlewRates: TypeAlias = Sequence[float | None] | float | None

# Seconds for the whole range, if neither device nor user gives a slew rate.
_SHORTEST_SWEEP = 0.1
# Least range [V], and longest ramp through it [s].
_LEAST_RANGE, _LONGEST_RAMP = 1e-3, 3600.0
# Number of recent batches that determine the present place in a wave.
_RECENT_BATCHES = 5
# Least uncertainty [s] of the place in a wave.
_LEAST_DELAY = 0.05
# A voltage is reached if the reading is within this part of the range; a retreat sends its end at most this often.
_READBACK_ROUNDING, _MOST_ENDS = 1e-5, 2
# Seconds between two steps of a ramp; a host keeps no better time.
TICK = 0.01
# Least time [s] of a ramp through the whole range: its steps are then small enough for any actuator.
_LEAST_RAMP_TIME = 1.0
# A ramp through a slow link has fewer and larger steps: all answers take this time [s] at most. Least number of steps;
# largest number of refused steps that a retreat sends again.
_ANSWER_TIME, _LEAST_STEPS, _MOST_REPEATS = 0.7, 2, 3
# Number of ticks for which a stage settles after a ramp, so that its lag is not in the record.
_SETTLING_TICKS = 10
# Number of readings, a tick apart, within which the readback must reach the sent voltage; if readings take longer, the
# time [s] and the least number of readings.
_MOST_READINGS, _READBACK_TIME, _LEAST_READINGS = 100, 1.5, 3


class VoltageNote(str):
    """A note on an error that says where the voltage was left.

    `safe`: whether this is the safe voltage. `voltages`: likely voltage of each axis [V], by the voltages that were
    sent and taken; a wave that cannot be stopped leaves it. NaN where nothing was sent.
    """

    safe: bool
    voltages: tuple[float, ...]

    def __new__(cls, text: str, *, safe: bool, voltages: Sequence[float]) -> Self:
        """Return the text with its outcome."""
        note = super().__new__(cls, text)
        note.safe, note.voltages = safe, tuple(voltages)
        return note


class ReadbackError(DeviceError):
    """The voltage that is `read` [V] contradicts the voltage that was `sent` [V]."""

    def __init__(self, name: str, sent: float, read: float) -> None:
        need, hint = f"{sent:.6g} V, as was sent", "check the readback and its cable, the amplifier, servo and channel"
        super().__init__(argument=name, got=f"a reading of {read:.6g} V", need=need, hint=hint)
        self.sent, self.read = sent, read


class Output:
    """The output of the only axis of a `rig`; `read`: the voltage that was read after a retreat [V], or NaN."""

    def __init__(self, rig: AbstractRig) -> None:
        self._rig, self.read = rig, math.nan
        span = rig.limits.high - rig.limits.low
        self._tolerance, self._exact = READBACK_TOLERANCE * span, _READBACK_ROUNDING * span
        # Voltages of the present wave, or the last voltage that was sent; None before any was sent.
        self._sent: Array | None = None
        # A later voltage of which it is unknown whether the device took it; else None.
        self._unconfirmed: float | None = None
        # Rows per second, and the row of the last sample. The row at the time 0 of the clock, extrapolated at this pace
        # from the sample with the least delay, and from each of the recent samples.
        self._pace, self._row, self._soonest = 0.0, 0, 0.0
        self._recent: deque[float] = deque(maxlen=_RECENT_BATCHES)
        # Duration of the last answer [s].
        self._answer = 0.0

    def puts(self, voltage: float) -> None:
        """Take note that a `voltage` [V] was sent, and taken."""
        self.plays(np.array([voltage]), 0.0)

    def plays(self, voltage: Array, rate: float) -> None:
        """Take note of a wave (n,) [V] that begins now, at a `rate` [Hz]."""
        self._sent, self._pace, self._row, self._unconfirmed = voltage, rate, 0, None
        self._soonest = -self._pace * self._rig._now()
        self._recent.clear()

    def observe(self, count: int) -> None:
        """Take note that sample number `count` came now."""
        self._row = count - 1
        place = self._row - self._pace * self._rig._now()
        self._soonest = max(place, self._soonest) if self._recent else place
        self._recent.append(place)

    @property
    def likely(self) -> float:
        """The likeliest voltage [V] now; NaN if nothing was sent."""
        return math.nan if self._sent is None else self._present(self._sent)[0]

    def reached(self, voltage: float) -> bool:
        """Return whether a `voltage` [V] was read after the last retreat, apart from the rounding of a readback."""
        return abs(self.read - voltage) <= self._exact

    @property
    def words(self) -> str:
        """The known facts on the output, as text for a message."""
        if self._sent is None:
            return "nothing was sent yet"
        if self._unconfirmed is not None:
            return f"{self._unconfirmed:.6g} V was sent last, and no answer confirms it"
        if self._sent.size == 1:
            return f"{self.likely:.6g} V was the last voltage that it acknowledged"
        # Received samples are certain; the later voltages depend only on the clock of the device.
        left = self._sent[self._row :]
        way = f"between {left.min():.6g} and {left.max():.6g} V"
        return f"a wave went on from {left[0]:.6g} V, {way}, to its end at {left[-1]:.6g} V"

    def _present(self, sent: Array) -> tuple[float, float, float]:
        """Return the likeliest voltage, lowest and highest [V] of an output that may have stopped after a sample."""
        passed = self._pace * self._rig._now()
        # The estimate uses the recent sample with the least delay. All are late if this computer is busy.
        likely = max(self._recent) + passed if self._recent else 0.0
        last = max(likely, self._soonest + passed) + self._pace * _LEAST_DELAY
        first, middle, end = (min(max(int(place), 0), sent.size - 1) for place in (self._row, likely, last))
        return float(sent[middle]), float(sent[first : end + 1].min()), float(sent[first : end + 1].max())

    def ramp(self, end: float) -> Generator[float, float, None]:
        """Ramp to `end` [V] from the sent voltage, or else the read one; yield each wait [s], get back the longest.

        Raise `ReadbackError` if a reading before or after it contradicts what was sent.
        """
        if self._sent is None:
            present = self._standing()
        else:
            present = float(self._sent[-1])
            yield from self._confirmed(present, present, present)
        yield from self._steps(present, end, always=False)
        for _ in range(_SETTLING_TICKS * (present != end)):
            yield TICK
        yield from self._confirmed(end, end, end)

    def retreat(self, end: float) -> Generator[float, float, None]:
        """Ramp to `end` [V] whatever is read, and send it in any case.

        Raise `ReadbackError` at the end if a reading before or after it contradicts what was sent.
        """
        contradiction = None
        if self._sent is None:
            present = self._standing()
        else:
            present, low, high = self._present(self._sent)
            try:
                read = yield from self._confirmed(present, low, high)
                present = min(max(read, low), high) if low < high else present
            except ReadbackError as error:
                contradiction = error
            except RigError:
                pass
        self.read = math.nan
        # After a contradiction, one reading is enough.
        readings = 1 if contradiction else _MOST_READINGS
        for _ in range(_MOST_ENDS):
            yield from self._steps(present, end, always=True)
            present = end
            try:
                self.read = yield from self._confirmed(end, end, end, readings)
            except ReadbackError:
                raise
            except RigError:
                break
            if self.reached(end):
                break
        if contradiction is not None:
            raise contradiction

    def _steps(self, present: float, end: float, *, always: bool) -> Generator[float, float, None]:
        """Send voltages from `present` to `end` [V] within the slew rate; `always`: even if these are equal.

        A step is as large as the slew rate allows in the wait before it, which begins when the device has taken the
        last step. The ramp's own speed, if it is lower, counts from the time when the last step was sent.
        """
        limits, slew = self._rig.limits, self._rig.slew_rate
        speed = min(slew, (limits.high - limits.low) / _LEAST_RAMP_TIME)
        gentle, seconds = VoltageLimits(limits.low, limits.high, speed), abs(end - present) / speed
        sending, again, unread = self._rig._now(), _MOST_REPEATS if always else 0, False
        while present != end or always:
            # Wait before the first step too: a wave may have been stopped just now. The wait is so long that the slew
            # rate allows the ramp's speed, or that few steps suffice.
            enough = self._answer * speed / (slew - speed) if slew > speed else math.inf
            waited = yield max(TICK, min(seconds / _LEAST_STEPS, seconds * self._answer / _ANSWER_TIME, enough))
            passed = max(waited, self._rig._now() - sending)
            voltage, sending = limits.towards(gentle.towards(end, present, passed), present, waited), self._rig._now()
            try:
                with driver_errors(self._rig.name, "_put"):
                    self._rig._put(limits.nearest(voltage))
            except RigError as error:
                if not again:
                    raise
                # The error of the device may have another cause, and the voltage may have been taken.
                taken = None if unread else self._has_arrived(voltage, present)
                if taken is None and isinstance(error, LinkError):
                    # It is unknown whether the voltage was taken; the next step keeps the slew rate from both voltages.
                    unread, again, present = True, again - (voltage == end), voltage
                    self._unconfirmed = voltage
                    continue
                if not taken:
                    again -= 1
                    continue
            present, always = voltage, False
            self.puts(present)
            self._answer = self._rig._now() - sending

    def _has_arrived(self, voltage: float, present: float) -> bool | None:
        """Return whether the output is read nearer to a `voltage` [V] than to the `present` one; None if unreadable."""
        try:
            read = self._rig._voltage_read()
        except RigError:
            return None
        return abs(read - voltage) < abs(read - present) or voltage == present

    def _standing(self) -> float:
        """Return the voltage [V] before anything was sent, as it is read; raise `DeviceError` outside the limits."""
        read, limits = self._rig._voltage_read(), self._rig.limits
        # An error of the readback may put it slightly outside.
        nearest = limits.nearest(read)
        if abs(read - nearest) > self._tolerance:
            raise DeviceError(
                f"{self._rig.name}: stands at {read:.6g} V, but {limits.words} is allowed; bring it there by hand, "
                "or widen the limits if device and actuator allow it"
            )
        return nearest

    def _confirmed(
        self, sent: float, low: float, high: float, readings: int = _MOST_READINGS
    ) -> Generator[float, float, float]:
        """Return the reading [V] once it is near `low` to `high`; read at most `readings` times, and yield the waits.

        Raise `ReadbackError`, which says what was `sent`, if it does not come near in time.
        """
        begin, read = self._rig._now(), math.nan
        for count in range(readings):
            asked = self._rig._now()
            try:
                read = self._rig._voltage_read()
            finally:
                self._answer = self._rig._now() - asked
            if low - self._tolerance <= read <= high + self._tolerance:
                return read
            if count + 1 >= _LEAST_READINGS and self._rig._now() - begin > _READBACK_TIME:
                break
            yield TICK
        raise ReadbackError(self._rig.name, sent, read)


def bounds_of_axes(
    limits: AxisLimits, slew_rate: AxisSlewRates, count: int
) -> list[tuple[tuple[float, float] | None, float | None]]:
    """Return limits [V] and slew rate [V/s] that the user allows for each of `count` axes, given once or for each.

    Raise `RigError` for a wrong number of values, or for a value that is no interval or no number.
    """
    pairs, rates = (
        for_each(given, count, what, error=RigError) for what, given in (("limits", limits), ("slew_rate", slew_rate))
    )
    return [
        (
            None if pair is None else interval(pair, error=RigError),
            None if rate is None else number(rate, "slew_rate", error=RigError),
        )
        for pair, rate in zip(pairs, rates, strict=True)
    ]


def common_limits(device: VoltageLimits, limits: tuple[float, float] | None, slew_rate: float | None) -> VoltageLimits:
    """Return the limits that device and user both allow, always with a slew rate; refuse ramps of over an hour."""
    given = VoltageLimits(*((device.low, device.high) if limits is None else limits), slew_rate)
    low, high = max(device.low, given.low), min(device.high, given.high)
    if not low + _LEAST_RANGE <= high:
        hint = f"give limits that have {_LEAST_RANGE:g} V or more in common with those of the device"
        raise RigError(f"got {given.words}, but the device has {device.words}", argument="limits", hint=hint)
    rates = [rate for rate in (device.slew_rate, slew_rate) if rate is not None]
    rate = min(rates, default=(high - low) / _SHORTEST_SWEEP)
    if high - low > _LONGEST_RAMP * rate:
        least = (high - low) / _LONGEST_RAMP
        raise RigError(
            f"slew rate: {rate:g} V/s takes more than an hour from {low:g} to {high:g} V, and so would a stop; "
            f"give {least:.3g} V/s at least, or narrower limits"
        )
    return VoltageLimits(low, high, rate)
