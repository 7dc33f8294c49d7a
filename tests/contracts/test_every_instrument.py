"""What every rig must do. To enter a rig, add one line to `RIGS`.

A candidate opens a rig on an instrument of -20 to 100 V that stands at 0 V, and gives both: the instrument's `log` is
what was ever put out, `voltage` what is put out now, `playing` whether a wave is, `limits` what the device allows, and
`unplugged = True` pulls the sensor's cable.
"""

import os
import signal
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from dataclasses import astuple
from itertools import pairwise
from typing import Any, NamedTuple

import epics_on_ioc
import fake_nidaqmx
import numpy as np
import pi_on_emulator
import pytest
from fake_rig import FakeRig

from dehyst import ClampWarning
from dehyst._errors import RecordError
from dehyst.instruments import DeviceError, RigError, SensorError
from dehyst.instruments.nidaqmx import NiRig
from dehyst.instruments.simulated import SimulatedRig
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation

LOW, HIGH = -20.0, 100.0
# A ramp goes on so often [s].
TICK = 0.01


class Candidate(NamedTuple):
    """A rig; how far recorded voltages [V] and the rate may be from what was asked, as the device's digits have it."""

    name: str
    factory: Callable[..., Any]
    volts: float = 1e-9
    rate: float = 1e-9


@contextmanager
def simulated(longest=65536, **options):
    """Open a rig in a time of its own."""
    truth = PlayActuator(highest=HIGH, noise=1e-10)
    with SimulatedRig(truth, device_limits=(LOW, HIGH), wave_points=longest, **options) as rig:
        yield rig, rig.instrument.axis


@contextmanager
def fake(longest=None, **options):
    """Open the least rig there can be."""
    with FakeRig((LOW, HIGH), longest=longest, **options) as rig:
        yield rig, rig.instrument


@contextmanager
def daq_card(**options):
    """Open a rig on a fake card in a time of its own."""
    with (
        fake_nidaqmx.installed((LOW / fake_nidaqmx.GAIN, HIGH / fake_nidaqmx.GAIN)) as card,
        NiRig(
            "Dev1/ao0",
            "Dev1/ai0",
            gain=fake_nidaqmx.GAIN,
            scale=1e6 * fake_nidaqmx.SCALE,
            clock=lambda: card.now,
            **options,
        ) as rig,
    ):
        rig._wait = card.wait
        yield rig, card


RIGS = [
    Candidate("fake", fake),
    Candidate("simulated", simulated),
    Candidate("National Instruments card, fake", daq_card),
    # Microvolts are sent.
    Candidate("pi", pi_on_emulator.by_pipe, volts=1e-6),
    Candidate("pi by tcp", pi_on_emulator.by_tcp, volts=1e-6),
    Candidate("epics", epics_on_ioc.by_channel_access),
]


@pytest.fixture(params=RIGS, ids=lambda candidate: candidate.name)
def candidate(request):
    return request.param


@pytest.fixture
def bench(candidate):
    """Open a rig and the instrument behind it."""
    with ExitStack() as stack:
        yield lambda **options: stack.enter_context(candidate.factory(**options))


def excitation(rig, *corners, name="corners", rate=1000.0):
    """Straight lines from one voltage to the next at 0.8 of the slew rate."""
    rate = rig.nearest_rate(rate)
    legs = [
        np.linspace(a, b, int(np.ceil(abs(b - a) / (0.8 * rig.slew_rate) * rate)) + 1)[1:] for a, b in pairwise(corners)
    ]
    return Excitation(name, np.concatenate([[corners[0]], *legs]), rate)


def put_out(instrument):
    """What can be seen of all that was ever put out."""
    return *astuple(instrument.log), instrument.voltage


def standing(instrument, voltage, tolerance=1e-6):
    return not instrument.playing and abs(instrument.voltage - voltage) <= tolerance


def test_limits_are_never_wider_than_the_devices(bench):
    rig, instrument = bench(limits=(-500.0, 500.0), slew_rate=1e3)
    assert (rig.limits.low, rig.limits.high) == pytest.approx(instrument.limits)
    assert LOW <= rig.limits.low < rig.limits.high <= HIGH
    assert rig.slew_rate == rig.limits.slew_rate <= 1e3


def test_limits_are_never_wider_than_the_users(bench):
    rig, _ = bench(limits=(-5.0, 40.0), slew_rate=150.0)
    assert (rig.limits.low, rig.limits.high, rig.slew_rate) == (-5.0, 40.0, 150.0)
    assert rig.safe == 0.0


def test_a_rig_that_nobody_limits_keeps_to_the_device_and_to_some_slew_rate(bench):
    rig, instrument = bench()
    assert (rig.limits.low, rig.limits.high) == pytest.approx(instrument.limits)
    assert 0 < rig.slew_rate < np.inf


def test_limits_that_leave_nothing_are_refused(bench):
    with pytest.raises(RigError, match="limits: got 200 to 300"):
        bench(limits=(200.0, 300.0))


def test_nothing_is_sent_by_opening_nor_by_reading(bench):
    rig, instrument = bench()
    log = astuple(instrument.log)
    assert (instrument.log.lowest, instrument.log.highest, instrument.voltage) == (0, 0, 0)
    first = rig.read()
    second = rig.read()
    assert astuple(instrument.log) == log
    assert first.voltage == pytest.approx(0.0, abs=1e-6)
    assert np.isfinite(first).all()
    assert second.time >= first.time
    assert rig.name in repr(rig)


def test_a_voltage_is_ramped_to(bench, candidate):
    rig, instrument = bench(slew_rate=500.0)
    for target in (60.0, 61.0, -10.0, -10.0):
        before = rig.read()
        assert rig.set_voltage(target) == target
        after = rig.read()
        assert standing(instrument, target, candidate.volts)
        assert after.voltage == pytest.approx(target, abs=candidate.volts)
        # The last step may be taken at once.
        assert after.time - before.time >= (abs(target - before.voltage) / 500.0 - TICK) * 0.999
    assert instrument.log.largest_step <= 500.0 * TICK + 2 * candidate.volts
    assert (instrument.log.lowest, instrument.log.highest) == pytest.approx((-10.0, 61.0), abs=candidate.volts)


@pytest.mark.parametrize(("asked", "sent"), [(150.0, 50.0), (-30.0, -5.0), (1e300, 50.0)])
def test_a_voltage_beyond_the_limits_is_clamped_and_said(bench, asked, sent):
    rig, instrument = bench(limits=(-5.0, 50.0))
    with pytest.warns(ClampWarning, match=f"was requested and {sent:g} V sent: -5 to 50 V is allowed"):
        assert rig.set_voltage(asked) == sent
    assert standing(instrument, sent)
    assert instrument.log.lowest >= -5.0 - 1e-9
    assert instrument.log.highest <= 50.0 + 1e-9
    assert instrument.log.refused == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, "50", None, [50.0]])
def test_what_is_no_voltage_is_refused_with_nothing_sent(bench, bad):
    rig, instrument = bench()
    before = put_out(instrument)
    with pytest.raises(RecordError, match="finite number"):
        rig.set_voltage(bad)
    assert put_out(instrument) == before


def test_a_sample_for_each_voltage(bench, candidate):
    rig, instrument = bench()
    asked = excitation(rig, 0, 60, 20, 80, 0)
    lots = []
    record = rig.play(asked, lots.append)
    assert np.array_equal(rig.rows(len(asked)), np.arange(len(asked)))
    assert record.voltage == pytest.approx(asked.voltage, abs=candidate.volts)
    assert np.all(np.diff(record.time) > 0)
    assert np.median(np.diff(record.time)) == pytest.approx(1 / asked.sample_rate, rel=candidate.rate)
    assert abs(record.time[-1] - record.time[0] - asked.duration) <= 2 / asked.sample_rate + 0.01 * asked.duration
    assert asked.sample_rate == pytest.approx(1000.0, rel=0.05)
    # The sensor sees an actuator that follows.
    assert np.corrcoef(record.voltage, record.displacement)[0, 1] > 0.9
    assert standing(instrument, 0.0)
    assert instrument.log.highest == pytest.approx(80.0, abs=candidate.volts)
    for column in ("time", "voltage", "displacement"):
        assert np.array_equal(np.concatenate([getattr(lot, column) for lot in lots]), getattr(record, column))
    assert (record.name, record.meta["rig"], record.meta["axis"]) == ("corners", rig.name, rig.axis)


def test_a_record_begins_by_a_ramp_to_its_first_voltage(bench, candidate):
    rig, instrument = bench(slew_rate=600.0)
    rig.play(excitation(rig, 70, 90, 80))
    assert instrument.log.largest_step <= 600.0 * TICK + 2 * candidate.volts
    assert standing(instrument, 80.0, candidate.volts)


@pytest.mark.parametrize("corners", [(0, 50.1, 0), (0, -5.1, 0), (60, 55)])
def test_an_excitation_beyond_the_limits_is_refused_with_nothing_sent(bench, corners):
    rig, instrument = bench(limits=(-5.0, 50.0))
    before = put_out(instrument)
    with pytest.raises(RecordError, match="may have -5 to 50"):
        rig.play(excitation(rig, *corners))
    assert put_out(instrument) == before


def test_an_excitation_that_is_too_steep_is_refused_with_nothing_sent(bench):
    rig, instrument = bench(slew_rate=100.0)
    steep = excitation(rig, 0, 40, 0)
    before = put_out(instrument)
    with pytest.raises(RecordError, match="may have 100 V/s"):
        rig.play(Excitation("corners", steep.voltage[::2], steep.sample_rate))
    assert put_out(instrument) == before


@pytest.mark.parametrize("longest", [2, 17, 100])
def test_a_long_record_is_cut_into_pieces_that_join(bench, candidate, longest):
    rig, instrument = bench(longest=longest)
    # A few samples from end to end, for tables of two.
    asked = excitation(rig, 0, 12, 4) if longest == 2 else excitation(rig, 0, 60, 20, 80, 0)
    if rig.longest != longest:
        pytest.skip("its tables cannot be made so short")
    record, rows = rig.play(asked), rig.rows(len(asked))
    pieces = -(-(len(asked) - 1) // (longest - 1))
    assert rows.size == len(record) == len(asked) + pieces - 1
    assert set(np.diff(rows)) <= {0, 1}
    assert (rows[0], rows[-1], np.count_nonzero(np.diff(rows) == 0)) == (0, len(asked) - 1, pieces - 1)
    assert record.voltage == pytest.approx(asked.voltage[rows], abs=candidate.volts)
    assert np.all(np.diff(record.time) > 0)
    assert instrument.log.largest_step <= rig.slew_rate * TICK + 2 * candidate.volts


def test_times_go_on_from_one_record_to_the_next(bench):
    rig, _ = bench()
    records = [rig.play(excitation(rig, 0, 30, 0)) for _ in range(3)]
    times = np.concatenate([record.time for record in records])
    assert np.all(np.diff(times) > 0)
    assert rig.read().time >= times[-1]


def interrupted():
    os.kill(os.getpid(), signal.SIGINT)


def raising(kind, *about):
    def do():
        raise kind(*about)

    return do


@pytest.mark.parametrize(
    ("stop", "kind"),
    [
        (raising(ValueError, "the disk is full"), ValueError),
        (raising(KeyboardInterrupt), KeyboardInterrupt),
        (interrupted, KeyboardInterrupt),
        (raising(SystemExit, 143), SystemExit),
    ],
    ids=["error", "raised Ctrl-C", "Ctrl-C", "exit"],
)
def test_what_listening_raises_stops_the_wave(bench, candidate, stop, kind):
    rig, instrument = bench(longest=120)
    asked, heard = excitation(rig, 0, 80, 70, 90, 0), []

    def listen(samples):
        heard.append(samples)
        if sum(lot.time.size for lot in heard) > 100:
            stop()

    with pytest.raises(kind) as caught:
        rig.play(asked, listen)
    assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
    assert standing(instrument, 0.0)
    voltage = np.concatenate([lot.voltage for lot in heard])
    assert 100 < voltage.size < len(rig.rows(len(asked)))
    assert voltage == pytest.approx(asked.voltage[rig.rows(len(asked))][: voltage.size], abs=candidate.volts)
    assert instrument.log.highest <= 90.0 + candidate.volts
    # Another record can be made at once.
    assert len(rig.play(excitation(rig, 0, 30, 0))) > 2


def test_a_sensor_that_is_unplugged_is_told_and_the_voltage_brought_back(bench, candidate):
    rig, instrument = bench(slew_rate=300.0)
    instrument.unplugged = True
    heard = []
    with pytest.raises(SensorError, match="not move:") as caught:
        rig.play(excitation(rig, 0, 80, 0), heard.append)
    assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
    assert standing(instrument, 0.0)
    assert sum(lot.time.size for lot in heard) > 0
    # It came soon: not much more than a fifth of the range had been seen. A wave in real time plays on until then.
    assert max((lot.voltage.max() for lot in heard[:-1]), default=0.0) <= 60.0
    assert instrument.log.highest <= (60.0 if candidate.name != "epics" else 80.0)


@pytest.mark.parametrize("voltage", [LOW, -3.0, 0.0, 1e-3, 55.5, HIGH])
def test_a_retreat_from_any_voltage(bench, candidate, voltage):
    rig, instrument = bench(slew_rate=2000.0)
    rig.set_voltage(voltage)
    assert rig.retreat() == 0.0
    assert standing(instrument, 0.0, candidate.volts)
    assert instrument.log.largest_step <= 2000.0 * TICK + 2 * candidate.volts


def test_safe_is_the_voltage_nearest_to_none(bench, candidate):
    rig, instrument = bench(limits=(0.5, 60.0))
    assert rig.safe == 0.5
    rig.set_voltage(40.0)
    assert rig.retreat() == 0.5
    assert standing(instrument, 0.5, candidate.volts)


def test_a_device_that_stands_beyond_the_limits_is_left_alone(bench):
    rig, instrument = bench(limits=(30.0, 60.0))
    before = put_out(instrument)
    with pytest.raises(DeviceError, match="stands at 0 V, but 30 to 60 V is allowed") as caught:
        rig.set_voltage(40.0)
    assert "could not be brought to 30 V" in caught.value.__notes__[0]
    assert put_out(instrument) == before


def test_closed_is_closed(bench, candidate):
    rig, instrument = bench()
    rig.set_voltage(25.0)
    asked = excitation(rig, 0, 30, 0)
    rig.close()
    rig.close()
    assert standing(instrument, 25.0, candidate.volts)
    for late in (rig.read, rig.retreat, lambda: rig.set_voltage(1.0), lambda: rig.play(asked)):
        with pytest.raises(RigError, match="closed"):
            late()
    assert standing(instrument, 25.0, candidate.volts)


def test_a_with_statement_closes(bench):
    rig, _ = bench()
    with rig as same:
        assert same is rig
    with pytest.raises(RigError, match="is closed"):
        rig.read()
