"""What all rigs share: limits, what may be sent, faults of a driver, and methods that no driver may replace."""

from dataclasses import replace

import numpy as np
import pytest
from fake_rig import UP, FakeRig, playing, raises
from hypothesis import given
from hypothesis import strategies as st

from dehyst._errors import RecordError
from dehyst.calibration.plan import Plan, steps
from dehyst.control import ClampWarning
from dehyst.instruments import AbstractRig, DeviceError, Reading, RigError
from dehyst.instruments.output import TICK
from dehyst.waveforms import Excitation

finite = st.floats(-500, 500)


@given(st.tuples(finite, finite), st.none() | st.tuples(finite, finite), st.none() | st.floats(1e-3, 1e6))
def test_limits_are_those_that_device_and_user_allow(device, limits, slew_rate):
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


REFUSED = {
    **{f"{bad}": lambda rig, bad=bad: rig.set_voltage(bad) for bad in (np.nan, np.inf, -np.inf, "50", None, [50.0])},
    "beyond": playing(0, 50.1),
    "below": playing(0, -5.1),
    "from beyond": playing(60, 55),
    "too steep": playing(0.0, 0.101, 0.0),
}


@pytest.mark.parametrize("act", REFUSED.values(), ids=REFUSED)
def test_a_forbidden_excitation_is_refused_before_anything_is_sent(act):
    rig = FakeRig(limits=(-5.0, 50.0), slew_rate=100.0)
    with pytest.raises(RecordError):
        act(rig)
    assert rig.instrument.sent == [0.0]


def test_a_device_beyond_the_limits_is_refused():
    rig = FakeRig(limits=(30.0, 60.0))
    with pytest.raises(DeviceError) as caught:
        rig.set_voltage(40.0)
    (note,) = caught.value.__notes__
    assert not note.safe and rig.instrument.sent == [0.0]


def test_a_wave_begins_with_a_ramp():
    rig = FakeRig((0.0, 100.0), slew_rate=600.0)
    playing(*np.arange(70.0, 90.0, 0.5))(rig)
    assert rig.instrument.log.largest_step <= rig.slew_rate * TICK + 1e-9


def test_the_first_step_of_a_loop_comes_a_period_after_the_ramp():
    rig, sent = FakeRig((0.0, 100.0), slew_rate=100.0), []
    put = rig._put
    rig._put = lambda voltage: (sent.append((rig._now(), voltage)), put(voltage))
    rig.play(Excitation("loop", np.linspace(20, 30, 101), 1000.0), step=lambda _: 100.0)
    time, volts = np.array(sent).T
    assert (np.abs(np.diff(volts)) <= 100.0 * np.diff(time) + 1e-9).all()


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


@pytest.mark.parametrize("rate", [np.nan, np.inf, 0.0, 0, -5.0, 10**400, "fast", None, True])
def test_a_rate_that_no_device_can_have_is_refused_with_nothing_sent(rate):
    rig = FakeRig()
    rig.nearest_rate = lambda _: rate
    with pytest.raises(DeviceError, match=r"fake: nearest_rate .* 100 Hz"):
        rig.play(Excitation("up", np.linspace(1, 5, 10), 100.0))
    with pytest.raises(DeviceError, match=r"fake: nearest_rate .* Hz"):
        steps(rig, Plan())
    assert rig.done == []


class Panic(BaseException):
    """Such as libraries in other languages raise."""


HOOKS = ["_read", "_put", "_wave", "_halt", "_wait", "_close", "nearest_rate"]


@pytest.mark.parametrize("name", HOOKS)
@pytest.mark.parametrize("error", [KeyError("1"), SystemExit(0), SystemExit("bye"), Panic("oh"), GeneratorExit()])
def test_an_unexpected_error_of_a_driver_is_a_device_error_with_its_method(name, error):
    rig = FakeRig((0.0, 100.0))
    setattr(rig, name, raises(error))
    with pytest.raises(DeviceError, match=f"fake: {name} .* {type(error).__name__}: "):
        {"_halt": rig.retreat, "_close": rig.close}.get(name, lambda: rig.play(replace(UP, voltage=UP.voltage + 1)))()


def test_a_link_that_cannot_be_closed_hides_no_other_error():
    rig = FakeRig()
    rig._close = raises(SystemExit(3))
    with pytest.raises(ValueError, match="first") as caught, rig:
        raise ValueError("first")
    (note,) = caught.value.__notes__
    assert note.startswith("fake: _close") and "SystemExit: 3" in note


@pytest.mark.parametrize(
    "name", ["play", "limits", "set_voltage", "read", "close", "__getattribute__", "_ramp", "retreat"]
)
def test_methods_for_limits_and_retreat_cannot_be_overridden(name):
    for bases, methods in (((AbstractRig,), {name: None}), ((type("Mixin", (), {name: None}), FakeRig), {})):
        with pytest.raises(TypeError, match=f"replaces {name} "):
            type("Own", bases, methods)


def test_a_mixin_may_have_methods_of_a_driver():
    class Mixin:
        def _wait(self, seconds):
            self.instrument.wait(seconds)

        def home(self):
            return self.set_voltage(0.0)

    assert type("Own", (Mixin, FakeRig), {})().home() == 0.0
