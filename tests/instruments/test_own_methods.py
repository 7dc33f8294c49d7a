"""A driver writes only the methods that are its own: no other can hide what limits and retreat rely on."""

import pytest
from fake_rig import FakeRig

from dehyst.instruments import AbstractRig


@pytest.mark.parametrize("name", ["play", "limits", "set_voltage", "_ramp", "_retreated", "retreat"])
def test_no_rig_replaces_what_limits_and_retreat_rely_on(name):
    with pytest.raises(TypeError, match=f"replaces {name} "):
        type("Own", (AbstractRig,), {name: None})


@pytest.mark.parametrize("name", ["play", "limits", "read", "close", "__exit__", "__getattribute__", "_ramp"])
def test_no_base_of_a_rig_replaces_what_limits_and_retreat_rely_on(name):
    mixin = type("Mixin", (), {name: None})
    with pytest.raises(TypeError, match=f"Own: replaces {name} of AbstractRig"):
        type("Own", (mixin, FakeRig), {})


@pytest.mark.parametrize("name", ["play", "_ramp", "_reading"])
def test_no_attribute_of_a_rig_hides_what_limits_and_retreat_rely_on(name):
    class Own(FakeRig):
        def __init__(self):
            setattr(self, name, None)

    with pytest.raises(TypeError, match=f"sets {name},"):
        Own()


def test_a_base_of_a_rig_may_have_what_a_driver_writes():
    class Mixin:
        def _wait(self, seconds):
            self.instrument.wait(seconds)

        def home(self):
            return self.set_voltage(0.0)

    assert type("Own", (Mixin, FakeRig), {})().home() == 0.0
