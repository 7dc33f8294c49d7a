"""The virtual bench of a stage: an amplifier and a wave generator an axis, sensors of the body, one recorder."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from dehyst._errors import DeviceError
from dehyst._types import Array
from dehyst.virtual.bench import VirtualBench
from dehyst.virtual.stage import VirtualStage

# Share of a servo period by which a voltage may be late: what was put out just after a sample belongs to it.
_LATE = 0.1


class StageBench:
    """A piezo controller of several axes without a protocol, around a virtual stage; its time is the clock's.

    Time stands still between two calls of `advance`: what is started between them starts at the same instant. It is not
    thread-safe: a server must hold a lock.

    Parameters
    ----------
    stage : VirtualStage
        At rest at 0 V.
    limits : sequence of (float, float), optional
        Lowest and highest voltage [V] of each axis; default: 0 V to its highest.
    clock : callable, optional
        Returns seconds, which never fall.
    speed : float, optional
        Seconds of the device in each second of the clock.
    noise : float, optional
        Standard deviation [m] of each sensor; default: the stage's.
    **options
        Of `VirtualBench`, for each axis: slew_rate, servo_period, wave_points, record_points.

    Attributes
    ----------
    benches : tuple of VirtualBench
        Amplifier, wave generator and sensor of each axis.
    servo_period, wave_points, record_points
        As of `VirtualBench`.
    serial : str
        Serial number: the stage's.
    """

    def __init__(
        self,
        stage: VirtualStage,
        *,
        limits: Sequence[tuple[float, float]] | None = None,
        clock: Callable[[], float] = time.monotonic,
        speed: float = 1.0,
        noise: float | None = None,
        **options: Any,
    ) -> None:
        self.stage, self.serial = stage, stage.serial
        self._clock, self._speed, self._began, self.now = clock, speed, clock(), 0.0
        self.benches = tuple(
            VirtualBench(
                port,
                limits=(0.0, port.highest) if limits is None else limits[j],
                clock=lambda: self.now,
                noise=stage.noise if noise is None else noise,
                seed=stage.seed + j,
                place=partial(self._place, j),
                **options,
            )
            for j, port in enumerate(stage.ports)
        )
        first = self.benches[0]
        self.servo_period, self.slew_rate = first.servo_period, first.slew_rate
        self.wave_points, self.record_points = first.wave_points, first.record_points
        self._lead: VirtualBench | None = None
        self._columns = np.zeros((0, 0, 0))
        self._times, self.recorded = np.zeros(0), 0

    @property
    def playing(self) -> bool:
        """Whether a wave is being played on any axis."""
        return any(bench.playing for bench in self.benches)

    @property
    def planned(self) -> int:
        """Samples of the longest of the present or last waves."""
        return 0 if self._lead is None else self._lead.planned

    def start(self, waves: Mapping[int, Array], divider: int = 1) -> None:
        """Play waves on some axes, all from this instant, and record all axes.

        `waves`: voltages (n,) [V] by axis (0, 1, ...). `divider`: servo periods from one voltage to the next.
        Raise `DeviceError` as `VirtualBench.start`; if one wave is refused, none is played.
        """
        self.advance()
        if self.playing:
            raise DeviceError("start: a wave is being played; stop it first")
        admitted = {axis: self.benches[axis].admitted(wave, divider) for axis, wave in waves.items()}
        for axis, wave in admitted.items():
            self.benches[axis].start(wave, divider)
        self._lead = max((self.benches[axis] for axis in waves), key=lambda bench: bench.planned)
        rows = min(self._lead.planned, self.record_points)
        self._times, self.recorded = np.zeros(rows), 0
        self._columns = np.zeros((2, len(self.benches), rows))
        self.advance()

    def stop(self) -> None:
        """Stop the waves and the moving outputs of all axes; the voltages stay."""
        self.advance()
        for bench in self.benches:
            bench.stop()

    def samples(self, axis: int, first: int = 0, count: int | None = None) -> tuple[Array, Array, Array]:
        """Return time [s], voltage [V] and displacement [m], (n,) each, of one `axis` (0, 1, ...) as recorded.

        They begin with sample `first` and are those recorded so far, `count` at most.
        """
        stop = self.recorded if count is None else min(self.recorded, first + count)
        rows = slice(max(first, 0), max(stop, 0))
        return self._times[rows].copy(), self._columns[0, axis, rows].copy(), self._columns[1, axis, rows].copy()

    def advance(self) -> None:
        """Bring all axes up to the clock's time, and record."""
        self.now = max(self.now, (self._clock() - self._began) * self._speed)
        for bench in self.benches:
            bench.advance()
        self._record()

    def _place(self, axis: int) -> float:
        return float(self.stage.present()[axis])

    def _record(self) -> None:
        """Record what the axes did at the samples of the longest wave."""
        motions = [port.take() for port in self.stage.ports]
        if self._lead is None:
            return
        at = self._lead.samples(self.recorded)[0][: self._times.size - self.recorded]
        if not at.size:
            return
        late = at + _LATE * self.servo_period
        rows = [np.searchsorted(motion.time, late, side="right") - 1 for motion in motions]
        y = self.stage.joined(
            [motion.own[row] for motion, row in zip(motions, rows, strict=True)],
            [motion.second[row] for motion, row in zip(motions, rows, strict=True)],
        )
        span = slice(self.recorded, self.recorded + at.size)
        self._times[span] = at
        for j, (bench, motion, row) in enumerate(zip(self.benches, motions, rows, strict=True)):
            self._columns[0, j, span] = motion.voltage[row]
            self._columns[1, j, span] = bench.sensed(y[:, j])
        self.recorded += at.size
