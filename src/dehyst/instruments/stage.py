"""A rig of several axes on one body: voltages of all axes are checked, played, read and brought back together."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from types import TracebackType
from typing import Any, NamedTuple, Self, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dehyst._errors import RecordError, RigError
from dehyst._types import Array
from dehyst._validation import matrix
from dehyst.instruments.base import LEAST_WATCHED, TICK, AbstractRig
from dehyst.instruments.driver_errors import arrivals, pieces
from dehyst.instruments.interrupts import retreated, retreating, shielded
from dehyst.instruments.samples import Inspection, Samples
from dehyst.instruments.sensor_watch import SensorWatch
from dehyst.waveforms import Excitation


class StageSamples(NamedTuple):
    """Consecutive samples of all axes: `time` (n,) [s], `voltage` (n, axes) [V], `displacement` (n, axes) [m]."""

    time: Array
    voltage: Array
    displacement: Array


StageListener = Callable[[StageSamples], None]
# Of all axes, or of each; None for an axis: those of the device.
AxisLimits: TypeAlias = Sequence[tuple[float, float] | None] | tuple[float, float] | None
AxisSlewRates: TypeAlias = Sequence[float | None] | float | None


class AbstractStageRig(ABC):
    """Axes with an amplifier and a sensor each, whose waves begin together and whose samples have one time.

    A driver opens its link, makes a rig of each axis and implements `_wave`. All methods that send a voltage are final.
    Limits, slew rate, reading, ramps and stops are those of the rig of each axis.

    Parameters
    ----------
    name : str
    rigs : sequence of AbstractRig
        The axes. They share one link: `close` closes all.
    longest : int, optional
        Most samples of one `_wave`; default any number.
    identity : str, optional
        As of `AbstractRig`.

    Attributes
    ----------
    axes : tuple of str
        Names of the axes.
    limits : tuple of VoltageLimits
        In force for each axis.
    slew_rate : (axes,) array
        [V/s].
    safe : (axes,) array
        The voltages [V] to retreat to.

    Raises
    ------
    RigError
        If there are no axes, two of one name, or they play at different rates.
    """

    def __init__(
        self, name: str, rigs: Sequence[AbstractRig], *, longest: int | None = None, identity: str | None = None
    ) -> None:
        self.name, self.rigs, self.longest, self.identity = name, tuple(rigs), longest, identity or name
        self.axes = tuple(rig.axis for rig in rigs)
        if not rigs or len(set(self.axes)) < len(self.axes):
            raise RigError(f"{name}: got the axes {', '.join(self.axes) or 'none'}, need each once")
        self.limits = tuple(rig.limits for rig in rigs)
        self.slew_rate = np.array([rig.slew_rate for rig in rigs])
        self.safe = np.array([rig.safe for rig in rigs])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        words = "; ".join(f"{rig.axis}: {rig.limits.words}, {rig.slew_rate:.6g} V/s" for rig in self.rigs)
        return f"<{type(self).__name__} '{self.name}', {words}>"

    @final
    def read(self) -> StageSamples:
        """Read all axes once, one after the other, as one sample; raises as `AbstractRig.read`."""
        readings = [rig.read() for rig in self.rigs]
        rows = np.array(readings).T
        return StageSamples(rows[0, -1:], rows[1:2], rows[2:3])

    @final
    def nearest_rate(self, sample_rate: float) -> float:
        """Return the rate [Hz] nearest to `sample_rate` at which all axes play; raises RigError if none is."""
        rates = {rig.nearest_rate(sample_rate) for rig in self.rigs}
        if len(rates) > 1:
            raise RigError(f"{self.name}: its axes play at {sorted(rates)} Hz, need one rate")
        return rates.pop()

    @final
    def check(self, voltage: ArrayLike, sample_rate: float, name: str = "voltage") -> float:
        """Return the rate [Hz] at which `play` would play; raises its RecordError, sends nothing.

        `voltage` (n, axes) [V], `sample_rate` [Hz] and `name` as of `play`.
        """
        return self._checked(voltage, sample_rate, name)[1]

    @final
    def play(
        self,
        voltage: ArrayLike,
        sample_rate: float,
        listen: StageListener = lambda _: None,
        *,
        name: str = "voltage",
    ) -> StageSamples:
        """Ramp all axes to their first voltages and play them together, at the rate nearest to `sample_rate`.

        Returns what the device recorded, in its own time. After any error, in `listen` too, and on Ctrl-C or SIGTERM,
        all waves are stopped and all voltages ramped to `safe`; `listen` has received all samples that arrived.

        Parameters
        ----------
        voltage : (n, axes) array_like
            [V].
        sample_rate : float
            [Hz].
        listen : callable, optional
            Called with each batch of `StageSamples` as it arrives.
        name : str, optional
            Used in messages.

        Raises
        ------
        RecordError
            If a voltage leaves the limits of its axis or is too steep; nothing was sent.
        RigError
            If the device, its link or a sensor fails.
        """
        rows, rate = self._checked(voltage, sample_rate, name)
        spans = [limits.high - limits.low for limits in self.limits]
        inspections = [
            Inspection(f"{self.name}, axis {axis}", span) for axis, span in zip(self.axes, spans, strict=True)
        ]
        sensors = [
            SensorWatch(max(float(np.ptp(column)), LEAST_WATCHED * span), f"the sensor of axis {axis}")
            for axis, column, span in zip(self.axes, rows.T, spans, strict=True)
        ]
        batches: list[StageSamples] = []
        with self.safely():
            self._ramp(rows[0])
            for piece in pieces(rows, self.longest):
                # Closed before the retreat: what a driver does at the end of a wave must not come after it.
                with closing(self._piece(piece, rate, inspections)) as arriving:
                    for samples in arriving:
                        batches.append(samples)
                        for j, rig in enumerate(self.rigs):
                            rig._last_voltage = float(samples.voltage[-1, j])
                        listen(samples)
                        for j, sensor in enumerate(sensors):
                            sensor.observe(samples.voltage[:, j], samples.displacement[:, j])
        return StageSamples(*(np.concatenate(columns) for columns in zip(*batches, strict=True)))

    @final
    @contextmanager
    def safely(self) -> Iterator[None]:
        """Retreat on all axes after any error within, Ctrl-C too, and add a note on the voltages to the error."""
        with retreating(self):
            yield

    @final
    def retreat(self) -> Array:
        """Stop all waves and ramp all axes to their safe voltages (axes,) [V], which are returned; Ctrl-C waits.

        An axis that fails does not keep the others from it. Raise `RigError` if one has failed.
        """
        with shielded(defer=True):
            errors = [error for rig in self.rigs if (error := _error_of(rig._stop_wave)) is not None]
            errors += self._ramped([rig._ramping(rig.safe, rig._last_voltage) for rig in self.rigs])
        if errors:
            raise errors[0]
        return self.safe

    @final
    def close(self) -> None:
        """Close the link and leave the voltages where they are. May be called twice."""
        for rig in self.rigs:
            rig.close()

    @final
    def rows(self, count: int) -> NDArray[np.intp]:
        """Return which of `count` voltages each sample of a record belongs to; where pieces join, two share one."""
        return np.concatenate(list(pieces(np.arange(count), self.longest)))

    @abstractmethod
    def _wave(self, voltage: Array, rate: float) -> Iterator[StageSamples]:
        """Play voltages (n, axes) [V], n <= longest, at `rate` [Hz], all axes from one instant; yield the samples.

        One sample of the record for each row. Times continue from one call to the next.
        """

    def _checked(self, voltage: ArrayLike, sample_rate: float, name: str) -> tuple[Array, float]:
        rows = matrix(voltage, "voltage", "V")
        if rows.shape[1] != len(self.rigs):
            raise RecordError(
                f"{name}: got {rows.shape[1]} columns of voltage, need {len(self.rigs)}, one an axis; nothing was sent"
            )
        for rig, column in zip(self.rigs, rows.T, strict=True):
            rate = rig.check(Excitation(f"{name}, axis {rig.axis}", column, sample_rate))
        return rows, self.nearest_rate(rate)

    def _ramp(self, ends: Array) -> None:
        errors = self._ramped([rig._ramping(end) for rig, end in zip(self.rigs, ends.tolist(), strict=True)])
        if errors:
            raise errors[0]

    def _ramped(self, ramps: Sequence[Iterator[None]]) -> list[Exception]:
        """Ramp axes side by side, a step of each in a tick; return the errors of those that failed."""
        errors: list[Exception] = []
        going = list(ramps)
        while going:
            left = []
            for ramp in going:
                try:
                    next(ramp)
                    left.append(ramp)
                except StopIteration:
                    pass
                except Exception as error:  # of a driver's library: the other axes go on
                    errors.append(error)
            going = left
            if going:
                self.rigs[0]._wait(TICK)
        return errors

    def _piece(
        self, voltage: Array, rate: float, inspections: Sequence[Inspection]
    ) -> Generator[StageSamples, None, None]:
        """Play one piece and check the samples of each axis as they arrive."""
        for column, inspection in zip(voltage.T, inspections, strict=True):
            inspection.begin(column)

        def admit(samples: StageSamples) -> StageSamples:
            columns = [inspection.admit(_axis(samples, j)) for j, inspection in enumerate(inspections)]
            voltages, displacements = ([getattr(one, key) for one in columns] for key in ("voltage", "displacement"))
            return StageSamples(columns[0].time, np.column_stack(voltages), np.column_stack(displacements))

        def compare(samples: StageSamples) -> None:
            for j, inspection in enumerate(inspections):
                inspection.compare(_axis(samples, j))

        yield from arrivals(self.name, lambda: self._wave(voltage, rate), admit, compare)
        for inspection in inspections:
            inspection.end()

    def _retreated(self) -> str:
        """Retreat if the link still works, and return the outcome as a sentence."""
        return retreated(
            lambda: _words(self.retreat()), _words(self.safe), self.close, f" of the axes {', '.join(self.axes)}"
        )


def _axis(samples: StageSamples, j: int) -> Samples:
    return Samples(samples.time, samples.voltage[:, j], samples.displacement[:, j])


def _words(voltages: Array) -> str:
    return ", ".join(f"{voltage:.6g}" for voltage in voltages.tolist())


def _error_of(action: Callable[[], None]) -> Exception | None:
    try:
        action()
    except Exception as error:  # a driver's library may raise anything
        return error
    return None


def limits_of_axes(given: AxisLimits, count: int) -> list[tuple[float, float] | None]:
    """Return the limits [V] that the user allows of each of `count` axes, `given` once or for each; raises RigError."""
    pairs: list[Any] = [None] * count if given is None else list(given)
    if len(pairs) == 2 and not any(isinstance(one, Sequence | np.ndarray) or one is None for one in pairs):
        pairs = [tuple(pairs)]
    pairs = pairs * count if len(pairs) == 1 else pairs
    if len(pairs) != count:
        raise RigError(f"limits: got {len(pairs)} pairs for {count} axes, need one, or one for each")
    return [None if one is None else (float(one[0]), float(one[1])) for one in pairs]


def slew_rates_of_axes(given: AxisSlewRates, count: int) -> list[float | None]:
    """Return the slew rate [V/s] that the user allows of each of `count` axes, `given` once or for each.

    Raise `RigError` if there is another number of them.
    """
    rates = list(given) if isinstance(given, Sequence | np.ndarray) else [given] * count
    if len(rates) != count:
        raise RigError(f"slew_rate: got {len(rates)} numbers for {count} axes, need one, or one for each")
    return [None if one is None else float(one) for one in rates]
