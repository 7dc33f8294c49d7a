"""Signals: each that ends a program brings the voltage back, and none cuts the way back short."""

import os
import signal
import sys
import threading
from contextlib import contextmanager

import pytest
from fake_rig import BROUGHT, UP, FakeRig, beyond, raises

from dehyst._errors import Terminated
from dehyst.instruments.interrupts import Shield

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")


def interrupt(number=signal.SIGINT):
    os.kill(os.getpid(), number)


@contextmanager
def handled(number, handler):
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def test_the_first_signal_is_raised_and_later_ones_wait():
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


def test_waiting_signals_are_raised_at_the_end():
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


def test_a_signal_handler_that_returns_does_not_stop_the_wave():
    noted = []
    with handled(signal.SIGTERM, lambda number, _: noted.append(number)), Shield() as shield:
        interrupt(signal.SIGTERM)
        interrupt(signal.SIGTERM)
        assert not shield.deferring
    assert noted == [signal.SIGTERM] * 2


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGQUIT, signal.SIGHUP])
def test_every_signal_that_ends_a_program_brings_the_voltage_back(number):
    rig = FakeRig((0.0, 100.0))
    with handled(number, signal.SIG_DFL), pytest.raises(Terminated) as caught:
        rig.play(UP, lambda _: interrupt(number))
    assert caught.value.code == 128 + number and caught.value.__notes__ == [BROUGHT]
    assert rig.instrument.voltage == 0.0


@pytest.mark.parametrize("name", ["_wait", "_read", "_wave"])
def test_a_signal_handler_of_the_program_may_end_a_driver_call(name):
    rig = FakeRig((0.0, 100.0))
    rig.set_voltage(20.0)
    usual = getattr(rig, name)

    def interrupted(*given):
        vars(rig).pop(name)
        interrupt(signal.SIGTERM)
        return usual(*given)

    setattr(rig, name, interrupted)
    with handled(signal.SIGTERM, lambda number, _: sys.exit(128 + number)), pytest.raises(SystemExit) as caught:
        rig.read() if name == "_read" else rig.play(UP)
    assert caught.value.code == 128 + signal.SIGTERM
    assert getattr(caught.value, "__notes__", [BROUGHT]) == [BROUGHT]


def test_rigs_work_in_a_thread_without_signals():
    said, rig = [], FakeRig()
    thread = threading.Thread(target=lambda: (rig.play(UP), said.append(rig.retreat())))
    thread.start()
    thread.join()
    assert said == [0.0]


@pytest.mark.parametrize("times", [1, 2, 5])
def test_repeated_ctrl_c_does_not_interrupt_the_retreat(times):
    rig = FakeRig(slew_rate=1000.0)
    put = rig._put

    def interrupted():
        rig._put = lambda voltage: (put(voltage), times > 1 and interrupt())
        interrupt()

    with pytest.raises(KeyboardInterrupt) as caught:
        rig.play(UP, beyond(40, interrupted))
    assert caught.value.__notes__ == [BROUGHT]
    assert rig.instrument.voltage == 0.0


def test_ctrl_c_between_an_error_and_the_retreat_waits():
    rig = FakeRig()
    retreated = rig._retreated
    vars(rig)["_retreated"] = lambda cause: (interrupt(), retreated(cause))[1]
    with pytest.raises(KeyboardInterrupt) as caught:
        rig.play(UP, beyond(20, raises(ValueError("first"))))
    assert rig.instrument.voltage == 0.0
    first = caught.value.__context__
    assert (str(first), first.__notes__) == ("first", [BROUGHT])
