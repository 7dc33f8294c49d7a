"""A suite of tests that every rig must pass: for authors of drivers, and for the drivers of dehyst."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import astuple
from itertools import pairwise
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dehyst._errors import RigError
from dehyst._types import Array
from dehyst.instruments import AbstractRig, Samples
from dehyst.testing.instrument import HIGH, LOW, FakeInstrument
from dehyst.waveforms import Excitation

Bench: TypeAlias = Callable[..., tuple[AbstractRig, Any]]
# Time between two steps of a ramp [s]; highest sample rate [Hz], largest step [V] and longest table of an excitation.
_TICK, _RATE, _STEP, _LONGEST = 0.01, 1000.0, 1.0, 4096
# Tolerance of displacements, as a share of the largest, for noise, creep, and a recorder that is two samples late.
_GAIN_ERROR = 0.05
# Tolerance for a fake instrument without these errors: half of the last digit of a sensor of 9 bits.
_DIGIT = 1e-3


class RigCandidate(NamedTuple):
    """A rig under test.

    `name`: name in the reports of pytest. `open`: context manager with the options `limits`, `slew_rate` and `longest`
    (number of samples to which the rig cuts waves, if it can). It yields the rig and the instrument behind it. The
    instrument has the attributes of a `FakeInstrument`, starts at 0 V, and allows -20 to 100 V. `gain`: displacement at
    80 V minus displacement at 0 V after it, over 80 V [m/V]. `volts`, `rate`: allowed deviations of recorded voltages
    [V] and of the sample rate (relative) from the request, due to the device's digits.
    """

    name: str
    open: Callable[..., AbstractContextManager[tuple[AbstractRig, Any]]]
    gain: float
    volts: float = 1e-9
    rate: float = 1e-9


def excitation(rig: AbstractRig, *corners: float, name: str = "corners", step: float = _STEP) -> Excitation:
    """Return straight lines from one voltage to the next, of 0.8 `step` [V] and 0.8 of the slew rate at most."""
    rate = rig.nearest_rate(min(_RATE, rig.slew_rate / step))
    most = 0.8 * min(step, rig.slew_rate / rate)
    branches = [np.linspace(a, b, int(np.ceil(abs(b - a) / most)) + 1)[1:] for a, b in pairwise(corners)]
    return Excitation(name, np.concatenate([[corners[0]], *branches]), rate)


def _fine_step(rig: AbstractRig) -> float:
    """Return the step [V] with which a wave table of the rig holds a sweep of 32 V."""
    return 40.0 / min(rig.longest or 100, _LONGEST)


def _put_out(instrument: Any) -> tuple[float, ...]:
    """Return the observable history of the output: the extremes, or all voltages."""
    return *astuple(instrument.log), instrument.voltage


def _changes(voltage: ArrayLike, tolerance: float) -> Array:
    """Return voltages [V] from (n,) without those equal to the voltage before."""
    v = np.asarray(voltage, dtype=np.float64)
    return v[np.abs(np.diff(v, prepend=np.inf)) > tolerance]


def _standing(instrument: Any, voltage: float, candidate: RigCandidate) -> bool:
    return not instrument.playing and abs(instrument.voltage - voltage) <= max(candidate.volts, 1e-6)


def _interrupted() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def _failing() -> None:
    raise ValueError("the disk is full")


class RigContract:
    """The tests of a rig: limits, slew rate, ramps, records, and the retreat after each kind of error.

    Write a subclass whose name begins with ``Test``, with a fixture `candidate` that returns a `RigCandidate`::

        class TestMyRig(RigContract):
            @pytest.fixture
            def candidate(self):
                return RigCandidate("mine", open_on_an_emulator, gain=1e-7)
    """

    @pytest.fixture
    def bench(self, candidate: RigCandidate) -> Iterator[Bench]:
        """Return a function that opens a rig with options; it returns the rig and the instrument behind it."""

        def opened(**options: Any) -> Any:
            made = stack.enter_context(candidate.open(**options))
            wait, self._waits = made[0]._wait, {_TICK: _TICK}
            vars(made[0])["_wait"] = lambda seconds: wait(self._waits.setdefault(seconds, seconds))
            return made

        with ExitStack() as stack:
            yield opened

    def test_limits_are_those_of_device_and_user(self, bench: Bench) -> None:
        for slew_rate, limits in ((None, None), (1e3, (-500.0, 500.0))):
            rig, instrument = bench(limits=limits, slew_rate=slew_rate)
            assert (rig.limits.low, rig.limits.high) == pytest.approx(instrument.limits)
            assert LOW <= rig.limits.low < rig.limits.high <= HIGH
            assert 0 < rig.slew_rate < np.inf and rig.slew_rate <= (slew_rate or np.inf)
        rig, _ = bench(limits=(-5.0, 40.0), slew_rate=1.0)
        assert (rig.limits.low, rig.limits.high, rig.slew_rate) == (-5.0, 40.0, 1.0)

    def test_nothing_is_sent_by_opening_nor_by_reading(self, bench: Bench, candidate: RigCandidate) -> None:
        rig, instrument = bench()
        log = astuple(instrument.log)
        assert (instrument.log.lowest, instrument.log.highest, instrument.voltage) == (0, 0, 0)
        first = rig.read()
        second = rig.read()
        assert astuple(instrument.log) == log
        assert first.voltage == pytest.approx(0.0, abs=max(candidate.volts, 1e-6))
        assert np.isfinite(first).all()
        assert second.time >= first.time
        assert rig.name in repr(rig)

    def test_a_voltage_is_ramped_to(self, bench: Bench, candidate: RigCandidate) -> None:
        rig, instrument = bench(slew_rate=500.0)
        for target in (60.0, 61.0, -10.0, -10.0):
            before = rig.read()
            assert rig.set_voltage(target) == target
            after = rig.read()
            assert _standing(instrument, target, candidate)
            assert after.voltage == pytest.approx(target, abs=candidate.volts)
            # The last step may be taken at once.
            assert after.time - before.time >= (abs(target - before.voltage) / rig.slew_rate - _TICK) * 0.999
        assert instrument.log.largest_step <= rig.slew_rate * max(self._waits) + 2 * candidate.volts
        assert (instrument.log.lowest, instrument.log.highest) == pytest.approx((-10.0, 61.0), abs=candidate.volts)

    def test_a_sample_for_each_voltage(self, bench: Bench, candidate: RigCandidate) -> None:
        rig, instrument = bench()
        asked = excitation(rig, 0, 60, 20, 80, 0)
        lots: list[Samples] = []
        record, rows = rig.play(asked, lots.append), rig.rows(len(asked))
        assert record.voltage == pytest.approx(asked.voltage[rows], abs=candidate.volts)
        assert np.all(np.diff(record.time) > 0)
        assert np.median(np.diff(record.time)) == pytest.approx(1 / asked.sample_rate, rel=candidate.rate)
        if rows.size == len(asked):  # in one piece
            slack = 2 / asked.sample_rate + max(0.01, candidate.rate) * asked.duration
            assert abs(record.time[-1] - record.time[0] - asked.duration) <= slack
        assert rig.nearest_rate(asked.sample_rate) == pytest.approx(asked.sample_rate)
        # The measured displacement follows the voltage.
        assert np.sign(candidate.gain) * np.corrcoef(record.voltage, record.displacement)[0, 1] > 0.9
        assert _standing(instrument, 0.0, candidate)
        assert instrument.log.highest == pytest.approx(80.0, abs=candidate.volts)
        for column in ("time", "voltage", "displacement"):
            assert np.array_equal(np.concatenate([getattr(lot, column) for lot in lots]), getattr(record, column))
        assert (record.name, record.meta["rig"], record.meta["axis"]) == ("corners", rig.name, rig.axis)

    def test_displacements_are_the_instruments(self, bench: Bench, candidate: RigCandidate) -> None:
        """A single reading and a record agree, in metres."""
        rig, _ = bench()
        stroke = pytest.approx(80.0 * candidate.gain, rel=_GAIN_ERROR)
        record = rig.play(excitation(rig, 0, 80, 0))
        assert record.displacement[np.argmax(record.voltage)] - record.displacement[-1] == stroke
        rest = rig.read().displacement
        assert abs(rest - record.displacement[-1]) <= abs(80.0 * candidate.gain * _GAIN_ERROR)
        rig.set_voltage(80.0)
        assert rig.read().displacement - rest == stroke

    @pytest.mark.parametrize("longest", [None, 17])
    def test_a_fake_instrument_got_and_gave_what_is_recorded(
        self, bench: Bench, candidate: RigCandidate, longest: int | None
    ) -> None:
        """The record holds each voltage of the wave and no other, its displacement, and the instrument's time."""
        rig, instrument = bench(longest=longest) if longest else bench()
        if not isinstance(instrument, FakeInstrument):
            pytest.skip("the instrument is not a FakeInstrument, which remembers all voltages and the time")
        asked = excitation(rig, 0, 60, 20, 80, 0)
        first, began, sent = rig.read(), instrument.now, len(instrument.sent)
        record = rig.play(asked)
        last, passed = rig.read(), instrument.now - began
        got, wanted = (_changes(v, candidate.volts) for v in ([0.0, *instrument.sent[sent:]], asked.voltage))
        assert got == pytest.approx(wanted, abs=candidate.volts)
        truth = instrument.displacement(np.append(record.voltage, last.voltage))
        digits = _DIGIT * np.ptp(truth) + abs(candidate.gain) * candidate.volts
        assert np.append(record.displacement, last.displacement) == pytest.approx(truth, abs=digits)
        if passed:  # it is 0 if the rig has another clock
            slack = 2 / asked.sample_rate + 0.01 * passed
            assert abs(last.time - first.time - passed) <= slack
            assert abs(record.time[-1] - record.time[0] - passed) <= slack

    @pytest.mark.parametrize("longest", [2, 17, 100])
    def test_a_long_record_is_cut_into_pieces_that_join(
        self, bench: Bench, candidate: RigCandidate, longest: int
    ) -> None:
        rig, instrument = bench(longest=longest)
        if rig.longest is None:
            pytest.skip("its waves may have any length")
        # A table of two samples needs an excitation of a few samples.
        corners = (0, 12, 4) if rig.longest == 2 else (0, 60, 20, 80, 0)
        asked = excitation(rig, *corners, step=min(_STEP, _fine_step(rig)))
        record, rows = rig.play(asked), rig.rows(len(asked))
        pieces = -(-(len(asked) - 1) // (rig.longest - 1))
        assert rows.size == len(record) == len(asked) + pieces - 1
        assert set(np.diff(rows)) <= {0, 1}
        assert (int(rows[0]), int(rows[-1])) == (0, len(asked) - 1)
        assert np.count_nonzero(np.diff(rows) == 0) == pieces - 1
        assert record.voltage == pytest.approx(asked.voltage[rows], abs=candidate.volts)
        assert np.all(np.diff(record.time) > 0)
        assert instrument.log.largest_step <= max(rig.slew_rate * max(self._waits), _STEP) + 2 * candidate.volts

    def test_times_go_on_from_one_record_to_the_next(self, bench: Bench) -> None:
        rig, _ = bench()
        records = [rig.play(excitation(rig, 0, 30, 0)) for _ in range(3)]
        times = np.concatenate([record.time for record in records])
        assert np.all(np.diff(times) > 0)
        assert rig.read().time >= times[-1]

    @pytest.mark.parametrize(("stop", "kind"), [(_failing, ValueError), (_interrupted, KeyboardInterrupt)])
    def test_what_listening_raises_stops_the_wave(
        self, bench: Bench, candidate: RigCandidate, stop: Callable[[], None], kind: type[BaseException]
    ) -> None:
        rig, instrument = bench(longest=100)
        asked = excitation(rig, 0, 80, 70, 90, 0, step=_fine_step(rig))
        heard: list[Samples] = []

        def listen(samples: Samples) -> None:
            heard.append(samples)
            if sum(lot.time.size for lot in heard) > 100:
                stop()

        with pytest.raises(kind) as caught:
            rig.play(asked, listen)
        assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
        assert _standing(instrument, 0.0, candidate)
        voltage = np.concatenate([lot.voltage for lot in heard])
        assert 100 < voltage.size < len(rig.rows(len(asked)))
        assert voltage == pytest.approx(asked.voltage[rig.rows(len(asked))][: voltage.size], abs=candidate.volts)
        assert instrument.log.highest <= 90.0 + candidate.volts
        # Another record can be made at once.
        assert len(rig.play(excitation(rig, 0, 30, 0))) > 2

    @pytest.mark.parametrize("voltage", [LOW, 0.0, 55.5, HIGH])
    def test_a_retreat_from_any_voltage(self, bench: Bench, candidate: RigCandidate, voltage: float) -> None:
        rig, instrument = bench(slew_rate=2000.0)
        rig.set_voltage(voltage)
        assert rig.retreat() == 0.0
        assert _standing(instrument, 0.0, candidate)
        assert instrument.log.largest_step <= rig.slew_rate * max(self._waits) + 2 * candidate.volts

    def test_closed_is_closed(self, bench: Bench, candidate: RigCandidate) -> None:
        rig, instrument = bench()
        rig.set_voltage(25.0)
        asked = excitation(rig, 0, 30, 0)
        with rig:
            rig.close()
        assert _standing(instrument, 25.0, candidate)
        for late in (rig.read, rig.retreat, lambda: rig.set_voltage(1.0), lambda: rig.play(asked)):
            with pytest.raises(RigError, match="closed"):
                late()
        assert _standing(instrument, 25.0, candidate)
