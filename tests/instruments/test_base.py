"""What all rigs share: the look at what comes, the sensor's watch, signals, and the way back to a safe voltage."""

import os
import signal
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fake_rig import FakeRig
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import RecordError, Terminated
from dehyst.calibration.plan import Plan, steps
from dehyst.control import ClampWarning
from dehyst.instruments import AbstractRig, DeviceError, LinkError, Reading, RigError, Samples, SensorError
from dehyst.instruments.interrupts import Shield
from dehyst.instruments.output import TICK
from dehyst.instruments.waves import SensorWatch
from dehyst.waveforms import Excitation

UP = Excitation("up", np.linspace(0, 50, 101), 1000.0)
BROUGHT = "The voltage was brought to 0 V."
finite = st.floats(-500, 500)


def raises(error):
    """Return a method that raises an error."""

    def fail(*_):
        raise error

    return fail


@given(st.tuples(finite, finite), st.none() | st.tuples(finite, finite), st.none() | st.floats(1e-3, 1e6))
def test_limits_are_what_both_allow(device, limits, slew_rate):
    device = (min(device), max(device) + 1)
    limits = limits and (min(limits), max(limits) + 1)
    low, high = limits or device
    low, high = max(low, device[0]), min(high, device[1])
    narrow = high - low < 1e-3
    if narrow or high - low > 3600 * min(300.0, slew_rate or 300.0):
        with pytest.raises(RigError) as caught:
            FakeRig(device, limits=limits, slew_rate=slew_rate, device_slew=300.0)
        assert (caught.value.argument == "limits") == narrow
        return
    rig = FakeRig(device, limits=limits, slew_rate=slew_rate, device_slew=300.0)
    assert (rig.limits.low, rig.limits.high) == (low, high)
    assert rig.slew_rate == min(300.0, slew_rate or 300.0)
    assert low <= rig.safe <= high
    assert abs(rig.safe) == min(abs(v) for v in (low, high, min(max(0.0, low), high)))


@pytest.mark.parametrize(("asked", "sent"), [(150.0, 50.0), (-30.0, -5.0), (1e300, 50.0)])
def test_a_voltage_beyond_the_limits_is_clamped_and_warned_of(asked, sent):
    rig = FakeRig(limits=(-5.0, 50.0))
    with pytest.warns(ClampWarning):
        assert rig.set_voltage(asked) == sent
    log = rig.instrument.log
    assert rig.instrument.voltage == sent and -5.0 <= log.lowest <= log.highest <= 50.0 and log.refused == 0


def played(*voltage, rate=1000.0):
    return lambda rig: rig.play(Excitation("odd", np.array(voltage, dtype=float), rate))


REFUSED = {
    **{f"{bad}": lambda rig, bad=bad: rig.set_voltage(bad) for bad in (np.nan, np.inf, -np.inf, "50", None, [50.0])},
    "beyond": played(0, 50.1),
    "below": played(0, -5.1),
    "from beyond": played(60, 55),
    "too steep": played(0.0, 0.101, 0.0),
}


@pytest.mark.parametrize("act", REFUSED.values(), ids=REFUSED)
def test_what_may_not_be_sent_is_refused_with_nothing_sent(act):
    rig = FakeRig(limits=(-5.0, 50.0), slew_rate=100.0)
    with pytest.raises(RecordError):
        act(rig)
    assert rig.instrument.sent == [0.0]


def test_a_device_beyond_the_limits_is_left_alone():
    rig = FakeRig(limits=(30.0, 60.0))
    with pytest.raises(DeviceError) as caught:
        rig.set_voltage(40.0)
    (note,) = caught.value.__notes__
    assert not note.safe and rig.instrument.sent == [0.0]


def test_a_wave_begins_by_a_ramp_and_a_retreat_ends_nearest_to_zero():
    rig = FakeRig(limits=(0.0, 100.0), slew_rate=600.0)
    played(*np.arange(70.0, 90.0, 0.5))(rig)
    assert rig.instrument.log.largest_step <= rig.slew_rate * TICK + 1e-9
    high = FakeRig((0.5, 60.0))
    high.instrument.sent.append(40.0)
    assert (high.safe, high.retreat(), high.instrument.voltage) == (0.5, 0.5, 0.5)


@pytest.mark.parametrize("lost", [1, 5])
def test_a_last_voltage_that_was_not_taken_is_sent_again_and_never_denied(lost):
    rig = FakeRig(slew_rate=500.0)
    rig.set_voltage(40.0)
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


@given(st.integers(2, 300), st.integers(2, 60))
def test_pieces_join_at_the_same_voltage(count, longest):
    rig = FakeRig(longest=longest)
    rows = rig.rows(count)
    ends = np.flatnonzero(np.diff(rows) == 0)
    pieces = np.split(rows, ends + 1)
    assert all(2 <= piece.size <= longest for piece in pieces)
    assert np.array_equal(np.unique(rows), np.arange(count))
    assert np.array_equal(rows, np.sort(rows))


def spoiled(spoil):
    """Return a rig of which lots are spoiled, and the lots that were heard."""
    rig = FakeRig()
    wave = rig._wave

    def spoiling(voltage, rate):
        for number, samples in enumerate(wave(voltage, rate)):
            yield from spoil(number, samples)

    rig._wave = spoiling
    return rig


def at(lot, change):
    """Change one lot and leave the others."""
    return lambda number, samples: [change(samples) if number == lot else samples]


def with_nan(column):
    def change(samples):
        spoilt = getattr(samples, column).copy()
        spoilt[3] = np.nan
        return samples._replace(**{column: spoilt})

    return change


SPOILT = {
    **{f"{column} is NaN": (at(2, with_nan(column)), LinkError) for column in ("time", "voltage", "displacement")},
    "a column is short": (at(2, lambda s: s._replace(voltage=s.voltage[1:])), LinkError),
    "no column": (at(2, lambda s: s._replace(voltage=np.float64(3))), LinkError),
    "too many": (lambda n, s: [s, s._replace(time=s.time + 0.01)] if n == 10 else [s], LinkError),
    "a lot comes twice": (lambda n, s: [s, s] if n == 3 else [s], LinkError),
    "time stands still": (at(2, lambda s: s._replace(time=np.full_like(s.time, s.time[0]))), LinkError),
    "time falls back": (at(4, lambda s: s._replace(time=s.time - 1)), LinkError),
    "a lot is missing": (lambda n, s: [] if n == 10 else [s], DeviceError),
    "nothing comes": (lambda n, s: [], DeviceError),
    "the output stays": (lambda n, s: [s._replace(voltage=np.zeros_like(s.voltage))], DeviceError),
    "a channel that nobody named": (at(2, lambda s: s._replace(others={"load_N": s.time})), DeviceError),
    "a channel is short": (at(2, lambda s: s._replace(others={"load_N": s.time[1:]})), LinkError),
}


@pytest.mark.parametrize(("spoil", "kind"), SPOILT.values(), ids=SPOILT)
def test_what_comes_is_looked_at(spoil, kind):
    rig, heard = spoiled(spoil), []
    with pytest.raises(kind) as caught:
        rig.play(UP, heard.append)
    (note,) = caught.value.__notes__
    assert note == BROUGHT and note.safe
    assert rig.instrument.voltage == 0.0
    assert not rig.instrument.playing
    # A reading that is not believed has no effect, except a finite voltage that differs from the sent one.
    for samples in heard:
        assert all(np.isfinite(column).all() for column in samples[:3])
        assert len({column.shape for column in samples[:3]}) == 1
    times = np.concatenate([[-1.0], *(samples.time for samples in heard)])
    assert np.all(np.diff(times) > 0)


def test_lots_may_be_lists_and_empty_and_a_sample_late():
    def late(number, samples):
        voltage = np.concatenate([[late.last], samples.voltage[:-1]])
        late.last = samples.voltage[-1]
        yield Samples(np.zeros(0), np.zeros(0), np.zeros(0))
        yield Samples(samples.time.tolist(), voltage.tolist(), samples.displacement.tolist())

    late.last = 0.0
    record = spoiled(late).play(UP)
    assert np.array_equal(record.voltage[1:], UP.voltage[:-1])


@pytest.mark.parametrize("stop", ["listen", "wave"])
def test_a_wave_is_closed_before_the_retreat(stop):
    """What a leaf does at its end may not come after the voltage was brought back."""
    rig = FakeRig()

    def listen(samples):
        if stop == "listen" and samples.time[-1] > 0.05:
            raise ValueError
        if stop == "wave" and samples.time[-1] > 0.05:
            rig.instrument.put = failing

    def failing(_):
        rig.instrument.put = type(rig.instrument).put.__get__(rig.instrument)
        raise LinkError("lost")

    with pytest.raises((ValueError, LinkError)):
        rig.play(UP, listen)
    ended = rig.done.index("wave ended")
    assert rig.done[ended + 1] == "halt"
    assert set(rig.done[ended + 2 :]) == {"put"}


def paced(change, longest=None):
    """Return a rig whose samples have times that are changed: a function of the times since the first one."""
    rig = FakeRig((0.0, 100.0), longest=longest)
    wave, first_times = rig._wave, []

    def pacing(voltage, rate):
        for samples in wave(voltage, rate):
            first_times.append(samples.time[0])
            yield samples._replace(time=first_times[0] + change(samples.time - first_times[0]))

    rig._wave = pacing
    return rig


@pytest.mark.parametrize("longest", [None, 11])
@pytest.mark.parametrize("factor", [10.0, 2.0])
def test_a_device_that_plays_faster_than_asked_is_stopped(factor, longest):
    rig, heard = paced(lambda t: t / factor, longest), []
    with pytest.raises(DeviceError, match=r"fake: .* 1000 Hz") as caught:
        rig.play(UP, heard.append)
    assert caught.value.__notes__ == [BROUGHT]
    assert 20 < sum(samples.time.size for samples in heard) < len(rig.rows(len(UP)))


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t / 1.05,
        lambda t: 3 * t,
        # The first one, or one in the middle, is late by 15 periods, and the next ones make up for it.
        lambda t: np.maximum(t, 0.015 + 1e-6 * t),
        lambda t: np.where(t > 0.05, np.maximum(t, 0.065 + 1e-6 * t), t),
    ],
    ids=["a clock that differs", "slow", "first late", "late"],
)
def test_a_device_that_is_late_and_catches_up_is_not_stopped(change):
    assert len(paced(change).play(UP)) == len(UP)


@pytest.mark.parametrize("jump", [3600.0, 86400.0])
def test_a_clock_that_jumps_is_an_error_at_once(jump):
    rig = paced(lambda t: t + jump * (t > 0.05))
    with pytest.raises(DeviceError, match="clock"):
        rig.play(UP)
    assert rig.instrument.voltage == 0.0


@pytest.mark.parametrize("answer", [0.05, 0.2, 0.35])
def test_a_retreat_over_a_slow_link_takes_its_ramp_and_two_seconds(answer):
    rig, clock = FakeRig((0.0, 100.0)), SimpleNamespace(now=0.0)
    rig._now = lambda: clock.now
    put, read, sent = rig._put, rig._read, []

    def late(call):
        def method(*values):
            clock.now += answer
            if values:
                sent.append((clock.now, *values))
            return call(*values)

        return method

    def wait(seconds):
        clock.now += seconds

    rig.set_voltage(90.0)
    rig._put, rig._read, rig._wait, rig._halt = late(put), late(read), wait, late(rig._halt)
    begin = clock.now
    rig.retreat()
    assert rig.instrument.voltage == 0.0
    assert sent[-1][0] - begin < 0.9 + 2.0
    times, volts = np.array([(begin, 90.0), *sent]).T
    # By the slew rate, a step is no larger than the time since the answer to the one before allows.
    assert (np.abs(np.diff(volts)) <= rig.slew_rate * (np.diff(times) - answer) + 1e-9)[1:].all()
    assert (np.abs(np.diff(volts)) <= 100.0 * np.diff(times) + 1e-9)[1:].all()


@pytest.mark.parametrize("read", [None, "no number", [1.0], 1j])
def test_a_retreat_needs_no_readback_that_is_a_number(read):
    rig = FakeRig((0.0, 100.0))
    rig.set_voltage(90.0)
    rig._read_voltage = lambda: read
    assert rig.retreat() == rig.instrument.voltage == 0.0
    with pytest.raises(DeviceError, match="need a finite number"):
        rig.set_voltage(90.0)


def test_the_first_step_of_a_loop_comes_a_period_after_the_ramp():
    rig = FakeRig((0.0, 100.0), slew_rate=100.0)
    put, sent = rig._put, []
    rig._put = lambda voltage: (sent.append((rig._now(), voltage)), put(voltage))
    rig.play(Excitation("loop", np.linspace(20, 30, 101), 1000.0), step=lambda _: 100.0)
    time, volts = np.array(sent).T
    assert (np.abs(np.diff(volts)) <= 100.0 * np.diff(time) + 1e-9).all()


def test_a_retreat_goes_on_though_every_command_is_complained_of():
    rig = FakeRig((0.0, 100.0))
    rig.set_voltage(90.0)
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


OTHERS = [(0.0, 10**400, 0.0), (10**5000,) * 3, (0.0, "high", 0.0), (1.0, 2.0), 5]


@pytest.mark.parametrize("values", [Reading(0.0, np.nan, 0.0), *OTHERS], ids=range(6))
def test_a_reading_that_is_no_number_is_refused(values):
    rig = FakeRig()
    rig._read = lambda: values
    with pytest.raises(RigError, match=r"fake: .*read"):
        rig.read()
    for ask in (rig.retreat, lambda: rig.set_voltage(3)):
        with pytest.raises(DeviceError, match="read"):
            ask()
    assert rig.instrument.sent == [0.0]


class Panic(BaseException):
    """Such as libraries in other languages raise."""


HOOKS = ["_read", "_put", "_wave", "_halt", "_wait", "_close", "nearest_rate"]


@pytest.mark.parametrize("name", HOOKS)
@pytest.mark.parametrize("error", [KeyError("1"), SystemExit(0), SystemExit("bye"), Panic("oh"), GeneratorExit()])
def test_what_a_leaf_raises_by_mistake_is_a_fault_with_its_name(name, error):
    rig = FakeRig((0.0, 100.0))

    setattr(rig, name, raises(error))
    with pytest.raises(DeviceError, match=f"fake: {name} .* {type(error).__name__}: "):
        {"_halt": rig.retreat, "_close": rig.close}.get(name, lambda: rig.play(replace(UP, voltage=UP.voltage + 1)))()


@pytest.mark.parametrize("late", [0.0, 0.06, 0.5])
def test_a_retreat_begins_where_the_wave_stopped_though_all_recent_samples_came_late(late):
    rig, clock = FakeRig((0.0, 100.0), slew_rate=600.0), SimpleNamespace(now=0.0)
    rig._now, rig._wait = lambda: clock.now, lambda seconds: vars(clock).update(now=clock.now + seconds)

    def wave(voltage, rate):
        rig._halt = lambda: rig.instrument.put(voltage[min(int(clock.now * rate), voltage.size - 1)])
        for first in range(0, 200, 10):
            clock.now = (first + 10) / rate + late * (first >= 50)
            part = voltage[first : first + 10]
            yield Samples(np.arange(first, first + 10) / rate, part, rig.instrument.displacement(part))

    def listen(samples):
        if samples.voltage[-1] > 15:
            raise ValueError

    rig._wave = wave
    with pytest.raises(ValueError) as caught:
        rig.play(Excitation("up", np.linspace(0, 100, 1001), 1000.0), listen)
    assert caught.value.__notes__ == [BROUGHT]
    stopped, *retreat = rig.instrument.sent[1:]
    assert np.abs(np.diff([stopped, *retreat])).max() <= 1.0 + 1e-9


def test_a_wave_that_a_device_cannot_stop_is_not_ramped_against():
    rig = FakeRig((0.0, 100.0))
    rig.set_voltage(20.0)
    sent = len(rig.instrument.sent)

    rig._halt = raises(DeviceError("plays on"))
    with pytest.raises(DeviceError, match="plays on"):
        rig.retreat()
    assert len(rig.instrument.sent) == sent


def test_what_a_wave_raises_as_it_is_closed_is_a_fault():
    rig = FakeRig((0.0, 100.0))
    wave = rig._wave

    def ending(voltage, rate):
        try:
            yield from wave(voltage, rate)
        finally:
            sys.exit(0)

    def listen(samples):
        if samples.voltage[-1] > 20:
            raise ValueError

    rig._wave = ending
    with pytest.raises(DeviceError, match=r"_wave .* SystemExit: 0") as caught:
        rig.play(UP, listen)
    assert caught.value.__notes__ == [BROUGHT]


def test_a_link_that_cannot_be_closed_hides_no_other_error():
    rig = FakeRig()

    rig._close = raises(SystemExit(3))
    with pytest.raises(ValueError, match="first") as caught, rig:
        raise ValueError("first")
    (note,) = caught.value.__notes__
    assert note.startswith("fake: _close") and "SystemExit: 3" in note


@pytest.mark.parametrize("rate", [np.nan, np.inf, 0.0, 0, -5.0, 10**400, "fast", None, True])
def test_a_rate_that_no_device_can_have_is_refused_with_nothing_sent(rate):
    rig = FakeRig()
    rig.nearest_rate = lambda _: rate
    with pytest.raises(DeviceError, match=r"fake: nearest_rate .* 100 Hz"):
        rig.play(Excitation("up", np.linspace(1, 5, 10), 100.0))
    with pytest.raises(DeviceError, match=r"fake: nearest_rate .* Hz"):
        steps(rig, Plan())
    assert rig.done == []


@pytest.mark.parametrize("error", [LinkError("lost"), OSError("gone"), ZeroDivisionError("a leaf's own mistake")])
def test_a_retreat_that_fails_is_told_beside_the_first_error(error):
    rig = FakeRig()

    def listen(_):
        rig._halt = raises(error)
        raise ValueError("first")

    with pytest.raises(ValueError, match="first") as caught:
        rig.play(UP, listen)
    [note] = caught.value.__notes__
    assert f"{error}" in note
    assert not note.safe
    assert rig.done[-1] == "close"
    with pytest.raises(RigError, match="is closed"):
        rig.read()


def test_a_readback_may_come_late():
    rig = FakeRig((0.0, 100.0))
    read = rig._read
    # It shows what was put out half a second ago.
    rig._read = lambda: read()._replace(voltage=rig.instrument.sent[-51] if len(rig.instrument.sent) > 51 else 0.0)
    wait = rig._wait

    def waiting(seconds):
        rig.instrument.sent.append(rig.instrument.voltage)
        wait(seconds)

    rig._wait = waiting
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


def test_a_wave_of_empty_batches_ends(monkeypatch):
    monkeypatch.setattr("dehyst.instruments.waves._PATIENCE", 0.01)
    rig = FakeRig()
    rig._wave = lambda *_: iter(lambda: Samples(*np.zeros((3, 0))), None)
    with pytest.raises(LinkError, match="empty batches"):
        rig.play(UP)


# The watch over the sensor.


def watched(*columns, span=100.0):
    watch = SensorWatch(span)
    for voltage, displacement in columns:
        watch.observe(np.asarray(voltage, float), np.asarray(displacement, float))


@given(st.lists(st.integers(1, 40), min_size=1), st.data())
def test_the_watch_sees_a_stretch_however_it_comes_in_lots(sizes, data):
    """The same answer for a record in one piece and in lots."""
    n = sum(sizes)
    voltage = np.cumsum(data.draw(st.lists(st.floats(-8, 8), min_size=n, max_size=n)))
    steps = data.draw(st.lists(st.sampled_from([0, 0, 0, 1]), min_size=n, max_size=n))
    displacement = np.cumsum(steps).astype(float)

    def answer(*lots):
        try:
            watched(*lots)
        except SensorError as error:
            return str(error).split(":")[0]
        return None

    ends = np.cumsum(sizes)[:-1]
    whole = answer((voltage, displacement))
    assert answer(*zip(np.split(voltage, ends), np.split(displacement, ends), strict=True)) == whole
    stretches = [voltage[displacement == value] for value in np.unique(displacement)]
    assert (whole is not None) == any(np.ptp(stretch) > 20.0 for stretch in stretches)


# Signals.


def interrupt(number=signal.SIGINT):
    os.kill(os.getpid(), number)


POSIX = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


@POSIX
def test_the_first_signal_passes_and_the_others_wait():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), Shield() as shield:
        try:
            interrupt()
        except KeyboardInterrupt:
            for _ in range(3):
                interrupt()
            assert shield.deferred == [signal.SIGINT] * 3
            raise
    assert signal.getsignal(signal.SIGINT) is before


@POSIX
def test_what_waited_comes_at_the_end():
    reached = []
    with pytest.raises(KeyboardInterrupt), Shield(defer=True):
        interrupt()
        reached.append("end")
    assert reached == ["end"]
    # Also where another error ended it; that one is its context.
    with pytest.raises(KeyboardInterrupt) as caught, Shield(defer=True):
        interrupt()
        raise ValueError("first")
    assert str(caught.value.__context__) == "first"


@POSIX
def test_a_handler_that_only_takes_note_stops_nothing(monkeypatch):
    noted = []
    before = signal.signal(signal.SIGTERM, lambda number, _: noted.append(number))
    try:
        with Shield() as shield:
            interrupt(signal.SIGTERM)
            interrupt(signal.SIGTERM)
            assert not shield.deferring
    finally:
        signal.signal(signal.SIGTERM, before)
    assert noted == [signal.SIGTERM] * 2


@POSIX
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP])
def test_every_signal_that_ends_a_program_brings_the_voltage_back(number):
    rig, before = FakeRig((0.0, 100.0)), signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(Terminated) as caught:
            rig.play(UP, lambda _: interrupt(number))
    finally:
        signal.signal(number, before)
    assert caught.value.code == 128 + number and caught.value.__notes__ == [BROUGHT]
    assert rig.instrument.voltage == 0.0


@POSIX
@pytest.mark.parametrize("name", ["_wait", "_read", "_wave"])
def test_a_programs_own_handler_may_end_it_within_a_leaf(name):
    def leave(number, _):
        sys.exit(128 + number)

    rig = FakeRig((0.0, 100.0))
    rig.set_voltage(20.0)
    usual, before = getattr(rig, name), signal.signal(signal.SIGTERM, leave)

    def interrupted(*given):
        vars(rig).pop(name)
        interrupt(signal.SIGTERM)
        return usual(*given)

    setattr(rig, name, interrupted)
    try:
        with pytest.raises(SystemExit) as caught:
            rig.read() if name == "_read" else rig.play(UP)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert caught.value.code == 128 + signal.SIGTERM
    assert getattr(caught.value, "__notes__", [BROUGHT]) == [BROUGHT]


def test_another_thread_has_no_signals():
    said = []

    def run():
        rig = FakeRig()
        rig.play(UP)
        said.append(rig.retreat())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert said == [0.0]


@POSIX
@pytest.mark.parametrize("times", [1, 2, 5])
def test_an_impatient_user_does_not_cut_the_retreat_short(times):
    rig = FakeRig(slew_rate=1000.0)
    put = rig._put

    def listen(samples):
        if samples.voltage[-1] > 40:
            rig._put = lambda voltage: (put(voltage), times > 1 and interrupt())
            interrupt()

    with pytest.raises(KeyboardInterrupt) as caught:
        rig.play(UP, listen)
    assert caught.value.__notes__ == [BROUGHT]
    assert rig.instrument.voltage == 0.0


@POSIX
def test_ctrl_c_between_an_error_and_the_retreat_waits():
    rig = FakeRig()
    retreated = rig._retreated

    def late(cause):
        interrupt()
        return retreated(cause)

    def listen(samples):
        if samples.voltage[-1] > 20:
            vars(rig)["_retreated"] = late
            raise ValueError("first")

    with pytest.raises(KeyboardInterrupt) as caught:
        rig.play(UP, listen)
    assert rig.instrument.voltage == 0.0
    first = caught.value.__context__
    assert (str(first), first.__notes__) == ("first", [BROUGHT])


@pytest.mark.parametrize(
    "name", ["play", "limits", "set_voltage", "read", "close", "__getattribute__", "_ramp", "retreat"]
)
def test_no_rig_nor_a_base_of_it_replaces_what_limits_and_retreat_rely_on(name):
    for bases, methods in (((AbstractRig,), {name: None}), ((type("Mixin", (), {name: None}), FakeRig), {})):
        with pytest.raises(TypeError, match=f"replaces {name} "):
            type("Own", bases, methods)


def test_a_base_of_a_rig_may_have_what_a_driver_writes():
    class Mixin:
        def _wait(self, seconds):
            self.instrument.wait(seconds)

        def home(self):
            return self.set_voltage(0.0)

    assert type("Own", (Mixin, FakeRig), {})().home() == 0.0
