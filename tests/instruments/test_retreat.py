"""The way back to a safe voltage, from wherever the output is and over whatever link."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from fake_rig import BROUGHT, UP, FakeRig, beyond, raises

from dehyst.instruments import DeviceError, LinkError, RigError, Samples
from dehyst.waveforms import Excitation


@pytest.fixture
def rig():
    """A rig of 0 to 100 V, at 90 V."""
    made = FakeRig((0.0, 100.0))
    made.set_voltage(90.0)
    return made


def test_a_retreat_ends_nearest_to_zero():
    rig = FakeRig((0.5, 60.0))
    rig.instrument.sent.append(40.0)
    assert (rig.safe, rig.retreat(), rig.instrument.voltage) == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("lost", [1, 5])
def test_a_refused_last_voltage_is_sent_again(rig, lost):
    put, ends = rig._put, []

    def putting(voltage):
        ends.append(voltage == 0.0)
        if not ends[-1] or sum(ends) > lost:
            put(voltage)

    rig._put = putting
    with pytest.raises(ValueError) as caught, rig.safely():
        raise ValueError
    (note,) = caught.value.__notes__
    assert (note == BROUGHT) == (rig.instrument.voltage == 0.0) == (lost == 1)


@pytest.mark.parametrize("stop", ["listen", "wave"])
def test_a_wave_is_closed_before_the_retreat(stop):
    """What a leaf does at its end may not come after the voltage was brought back."""
    rig = FakeRig()

    def failing(_):
        rig.instrument.put = type(rig.instrument).put.__get__(rig.instrument)
        raise LinkError("lost")

    def fail():
        if stop == "listen":
            raise LinkError("full")
        rig.instrument.put = failing

    with pytest.raises(LinkError):
        rig.play(UP, beyond(25, fail))
    ended = rig.done.index("wave ended")
    assert rig.done[ended + 1] == "halt"
    assert set(rig.done[ended + 2 :]) == {"put"}


def test_an_error_while_a_wave_is_closed_is_a_device_error():
    rig = FakeRig()
    wave = rig._wave

    def ending(voltage, rate):
        try:
            yield from wave(voltage, rate)
        finally:
            sys.exit(0)

    rig._wave = ending
    with pytest.raises(DeviceError, match=r"_wave .* SystemExit: 0") as caught:
        rig.play(UP, beyond(20, raises(ValueError)))
    assert caught.value.__notes__ == [BROUGHT]


@pytest.mark.parametrize("answer", [0.05, 0.2, 0.35])
def test_a_retreat_over_a_slow_link_takes_at_most_two_seconds_more(rig, answer):
    clock, sent = SimpleNamespace(now=0.0), []

    def wait(seconds):
        clock.now += seconds

    def late(call):
        def method(*values):
            wait(answer)
            sent.extend((clock.now, value) for value in values)
            return call(*values)

        return method

    rig._put, rig._read, rig._halt = late(rig._put), late(rig._read), late(rig._halt)
    rig._now, rig._wait = lambda: clock.now, wait
    rig.retreat()
    assert rig.instrument.voltage == 0.0
    assert sent[-1][0] < 0.9 + 2.0
    times, volts = np.array([(0.0, 90.0), *sent]).T
    # By the slew rate, a step is no larger than the time since the answer to the one before allows.
    assert (np.abs(np.diff(volts)) <= rig.slew_rate * (np.diff(times) - answer) + 1e-9)[1:].all()
    assert (np.abs(np.diff(volts)) <= 100.0 * np.diff(times) + 1e-9)[1:].all()


@pytest.mark.parametrize("late", [0.0, 0.06, 0.5])
def test_a_retreat_begins_where_the_wave_stopped_although_samples_are_late(late):
    rig, clock = FakeRig((0.0, 100.0), slew_rate=600.0), SimpleNamespace(now=0.0)
    rig._now, rig._wait = lambda: clock.now, lambda seconds: vars(clock).update(now=clock.now + seconds)

    def wave(voltage, rate):
        rig._halt = lambda: rig.instrument.put(voltage[min(int(clock.now * rate), voltage.size - 1)])
        for first in range(0, 200, 10):
            clock.now = (first + 10) / rate + late * (first >= 50)
            part = voltage[first : first + 10]
            yield Samples(np.arange(first, first + 10) / rate, part, rig.instrument.displacement(part))

    rig._wave = wave
    with pytest.raises(ValueError) as caught:
        rig.play(Excitation("up", np.linspace(0, 100, 1001), 1000.0), beyond(15, raises(ValueError)))
    assert caught.value.__notes__ == [BROUGHT]
    # The first one is where the wave stopped.
    assert np.abs(np.diff(rig.instrument.sent[1:])).max() <= 1.0 + 1e-9


@pytest.mark.parametrize("read", [None, "no number", [1.0], 1j])
def test_a_retreat_works_without_a_readback(rig, read):
    rig._read_voltage = lambda: read
    assert rig.retreat() == rig.instrument.voltage == 0.0
    with pytest.raises(DeviceError, match="need a finite number"):
        rig.set_voltage(90.0)


def test_a_retreat_continues_although_every_command_has_an_error(rig):
    put = rig._put

    def complaining(voltage):
        put(voltage)
        raise DeviceError("error 215")

    rig._put = complaining
    assert rig.retreat() == rig.instrument.voltage == 0.0
    rig._put = put
    rig.set_voltage(90.0)
    rig._put = raises(DeviceError("error 302"))
    with pytest.raises(DeviceError, match="302"):
        rig.retreat()
    assert rig.instrument.voltage == 90.0


def test_a_wave_that_a_device_cannot_stop_is_not_ramped_against(rig):
    sent = len(rig.instrument.sent)
    rig._halt = raises(DeviceError("plays on"))
    with pytest.raises(DeviceError, match="plays on"):
        rig.retreat()
    assert len(rig.instrument.sent) == sent


@pytest.mark.parametrize("error", [LinkError("lost"), OSError("gone"), ZeroDivisionError("a leaf's own mistake")])
def test_a_failed_retreat_is_reported_beside_the_first_error(error):
    rig = FakeRig()
    rig._halt = raises(error)
    with pytest.raises(ValueError, match="first") as caught:
        rig.play(UP, raises(ValueError("first")))
    [note] = caught.value.__notes__
    assert f"{error}" in note and not note.safe
    assert rig.done[-1] == "close"
    with pytest.raises(RigError, match="is closed"):
        rig.read()


def test_a_readback_may_come_half_a_second_late():
    rig = FakeRig((0.0, 100.0))
    read, wait, sent = rig._read, rig._wait, rig.instrument.sent
    rig._read = lambda: read()._replace(voltage=sent[-51] if len(sent) > 51 else 0.0)
    rig._wait = lambda seconds: (sent.append(rig.instrument.voltage), wait(seconds))
    assert rig.set_voltage(60.0) == 60.0
    rig.play(Excitation("up", 60.0 + UP.voltage / 2, 1000.0))
    assert rig.retreat() == 0.0


def test_a_readback_with_an_error_may_be_beyond_the_limits():
    rig = FakeRig((0.0, 100.0))
    honest = rig._read
    rig._read = lambda: honest()._replace(voltage=honest().voltage - 0.5)
    rig.set_voltage(30.0)
    assert rig.retreat() == 0.0
    assert (rig.instrument.log.lowest, rig.instrument.voltage) == (0.0, 0.0)
    rig._read = lambda: honest()._replace(voltage=-6.0)
    with pytest.raises(DeviceError) as caught:
        rig.set_voltage(30.0)
    assert caught.value.got == "a reading of -6 V"
