"""The rig on a data acquisition card, with a fake of its library; the contract is in `contract_rig.py`."""

import sys
from dataclasses import astuple

import fake_nidaqmx
import numpy as np
import pytest
from fake_nidaqmx import RegenerationMode, installed

from dehyst._errors import MissingExtraError
from dehyst.instruments import DeviceError, LinkError, RigError
from dehyst.instruments.nidaqmx import NiRig
from dehyst.waveforms import Excitation

UP = Excitation("up", np.linspace(0, 50, 101), 1000.0)


def opened(card, **options):
    options = {"gain": fake_nidaqmx.GAIN, "scale": 1e6 * fake_nidaqmx.SCALE, **options}
    rig = NiRig("Dev1/ao0", "Dev1/ai0", clock=lambda: card.now, **options)
    rig._wait = card.wait
    return rig


@pytest.fixture
def card():
    with installed() as card:
        yield card


def test_it_says_that_it_was_not_tried(card):
    rig = opened(card)
    assert rig.name == "PCIe-6323 Dev1/ao0 (not tried on hardware)"
    assert "NOT TRIED ON HARDWARE" in NiRig.__doc__
    assert rig.axis == "ao0"


def test_limits_are_the_cards_widest_range_by_the_gain(card):
    assert (opened(card).limits.low, opened(card).limits.high) == (-20.0, 100.0)
    assert opened(card, gain=3.0).limits.words == "-6 to 30 V"
    with installed(ranges=(-10.0, 10.0)) as other:
        assert opened(other, gain=3.0).limits.words == "-30 to 30 V"


def test_each_sample_is_of_the_end_of_its_voltage(card):
    """An edge reads before it changes the output; so the record has no sample of before."""
    rig = opened(card)
    rig.set_voltage(10.0)
    jump = Excitation("jump", np.r_[10.0, 10.4, 10.9, 10.2, 10.0], 1000.0)
    record = rig.play(jump)
    assert record.voltage == pytest.approx(jump.voltage, abs=1e-12)
    assert record.displacement == pytest.approx(1e-7 * jump.voltage, abs=1e-18)
    assert set(card.regeneration) == {RegenerationMode.DONT_ALLOW_REGENERATION}
    assert card.tasks == []


def test_the_driver_has_the_limits_too(card):
    rig = opened(card, limits=(-5.0, 60.0))
    for beyond in (-5.1, 60.1):
        with pytest.raises(DeviceError, match=r"PCIe-6323.*-200561"):
            rig._put(beyond)
    assert (card.log.lowest, card.log.highest) == (0.0, 0.0)


def test_rates_are_those_of_the_time_base(card):
    rig = opened(card)
    assert rig.nearest_rate(1000.0) == 1000.0
    assert rig.nearest_rate(30_001.0) == 1e8 / 3333
    # Two inputs share one converter.
    assert rig.nearest_rate(1e6) == 125_000.0
    assert card.tasks == []


def test_a_monitor_shows_what_reaches_the_actuator(card):
    rig = opened(card, monitor="Dev1/ai1")
    assert rig.play(UP).voltage == pytest.approx(UP.voltage)
    card.amplifies = False
    with pytest.raises(DeviceError, match="got a reading of 0 V"):
        rig.play(Excitation("up", np.linspace(0, 30, 101), 1000.0))
    half = opened(card, monitor="Dev1/ai1", monitor_gain=5.0)
    card.amplifies = True
    card.put(2.0)
    assert half.read().voltage == 10.0


def test_a_card_that_does_not_show_its_output_needs_a_monitor():
    with installed(internal=False) as card:
        with pytest.raises(RigError, match="_ao0_vs_aognd must"):
            opened(card)
        assert opened(card, monitor="Dev1/ai1").read().voltage == 0.0
        assert card.tasks == []


def test_a_clock_that_does_not_arrive(card):
    rig = opened(card)
    rig._device_speed, card.clockless = 1e6, True
    with pytest.raises(LinkError, match=r"no sample for 5\.\d* s, after 0 of 101; does the output's clock") as caught:
        rig.play(UP)
    assert caught.value.__notes__ == ["The voltage was brought to 0 V."]
    assert card.voltage == 0.0


def test_a_wave_is_halted_where_it_is(card):
    rig = opened(card)
    wave = rig._wave(UP.voltage, 1000.0)
    while not next(wave).time.size:
        pass
    assert card.playing
    rig._halt()
    rig._halt()
    assert not card.playing
    stands = card.voltage
    card.wait(1.0)
    assert card.voltage == stands == pytest.approx(25.0, abs=5.0)
    assert rig.read().voltage == pytest.approx(stands)


def test_a_driver_that_fails_in_mid_wave(card):
    rig = opened(card)

    def listen(samples):
        card.broken = "Device was unplugged." if samples.voltage[-1] > 20 else ""

    with pytest.raises(DeviceError, match="Status Code: -88705") as caught:
        rig.play(UP, listen)
    assert "could not be brought to 0 V" in caught.value.__notes__[0]
    assert card.tasks == []


def test_refusals(card, monkeypatch):
    for options in ({"gain": 0.0}, {"gain": -10.0}, {"gain": np.inf}, {"scale": 0.0}, {"scale": np.nan}):
        with pytest.raises(RigError, match="gain above 0"):
            opened(card, **options)
    with pytest.raises(DeviceError, match="Dev2/ao0: Device identifier"):
        NiRig("Dev2/ao0", "Dev2/ai0", gain=1, scale=1)
    with pytest.raises(RigError, match="readable"):
        NiRig("Dev1/ao0", "Dev1/ai7", gain=1, scale=1)
    monkeypatch.setattr(fake_nidaqmx.Device, "ao_samp_clk_supported", False)
    with pytest.raises(RigError, match="hardware-timed output"):
        opened(card)
    assert astuple(card.log) == (0.0, 0.0, 0.0, 0.0, 0)


def test_without_the_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(MissingExtraError, match=r"needs nidaqmx, .*dehyst\[ni\]"):
        NiRig("Dev1/ao0", "Dev1/ai0", gain=1, scale=1)


def test_addresses(card):
    rig = NiRig.from_address("ni://Dev1/ao0,ai0?gain=10&scale=2", limits=(0, 60), slew_rate=300)
    assert (rig.limits.words, rig.slew_rate) == ("0 to 60 V", 300)
    card.put(3.0)
    assert rig.read().voltage == pytest.approx(30.0)
    assert rig.read().displacement == pytest.approx(3e-6)
    assert NiRig.from_address("ni://Dev1/ao0,ai0?gain=10&scale=2&monitor=ai1&monitor_gain=20").read().voltage == 60.0
    for bad in (
        "ni://Dev1/ao0,ai0",
        "ni://Dev1/ao0?gain=1&scale=1",
        "ni:///ao0,ai0?gain=1&scale=1",
        "ni://Dev1/ao0,ai0?gain=1&scale=1&speed=2",
        "ni://Dev1/ao0,ai0?gain=ten&scale=1",
    ):
        with pytest.raises(RigError, match=r"need ni://Dev1/ao0,ai0\?gain=10"):
            NiRig.from_address(bad)
