"""Several axes of a controller over a socket: played together, read together, and all brought back together."""

import warnings

import numpy as np
import pytest
from emulated_stage import HIGHEST, LIMITS, rig_of, served, virtual_stage
from fake_rig import FakeRig

from dehyst import ClampWarning, Record
from dehyst._errors import ModelError, RecordError
from dehyst.instruments import AbstractRig, DeviceError, LinkError, RigError, Samples, SensorError, open_rig
from dehyst.instruments.output import VoltageNote, bounds_of_axes
from dehyst.instruments.pi import PiRig
from dehyst.waveforms import Excitation

RATE = 500.0


def waves(samples=1000, top=HIGHEST):
    turn = np.arange(samples)[:, None] / RATE * 2 * np.pi * np.array([1.0, 0.7, 0.45])
    return 0.45 * np.array(top) * (1 - np.cos(turn))


def ex(voltage, rate=RATE):
    return Excitation("voltage", voltage, rate)


def voltages(bench):
    return [axis.voltage for axis in bench.axes]


def test_the_rig_reports_its_axes():
    with served() as (server, _), rig_of(server, limits=[(0, 90), (10, 500), (0, 50)], slew_rate=700.0) as rig:
        assert rig.axes == ("1", "2", "3")
        assert [(single.limits.low, single.limits.high) for single in rig.rigs] == [(0, 90), (10, 120), (0, 50)]
        assert [single.slew_rate for single in rig.rigs] == [700.0] * 3
        assert [single.safe for single in rig.rigs] == [0.0, 10.0, 0.0]
        assert rig.longest == 65536 // 2
        assert "axis 1: 0 to 90 V, 700 V/s; axis 2: 10 to 120 V" in repr(rig)


def test_a_record_is_the_motion_of_the_stage():
    v, batches = waves(), []
    with served(stage=virtual_stage(noise=0)) as (server, bench), rig_of(server) as rig:
        played = rig.play(ex(v), batches.append)
        assert rig.check(ex(v)) == RATE
        columns = [bench.samples(axis=j) for j in range(3)]
        after = rig.rigs[0].read()
    assert isinstance(played, Record) and played.axes == ("1", "2", "3")
    assert np.abs(played.voltage - v).max() <= 0.6e-6
    np.testing.assert_allclose(np.diff(played.time), 1 / RATE, rtol=1e-6)
    np.testing.assert_allclose(played.displacement, np.column_stack([c[2] for c in columns]), rtol=1e-11, atol=1e-18)
    twin = virtual_stage()
    expected = twin.play(np.vstack([np.zeros((1, 3)), played.voltage]), measured=False)[1:]
    np.testing.assert_allclose(played.displacement, expected, atol=1e-14)
    assert sum(batch.time.size for batch in batches) == len(v)
    assert after.time > played.time[-1]


def test_long_records_are_cut_into_pieces_that_join():
    v = waves(700)
    with served(wave_points=200, record_points=300) as (server, bench), rig_of(server) as rig:
        played, rows = rig.play(ex(v)), rig.rows(len(v))
        # Six recorder tables share the memory.
        assert rig.longest == 150
        assert [axis.log.largest_step for axis in bench.axes] == pytest.approx(np.abs(np.diff(v, axis=0)).max(0), 1e-5)
    assert len(played.time) == len(rows) == 700 + 4
    assert np.abs(played.voltage - v[rows]).max() <= 0.6e-6
    assert np.all(np.diff(played.time) > 0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda v: v * [1, 1.2, 1], "voltage, axis 2: 0 to .* V, but .* allows 0 to 120 V"),
        (lambda v: np.where(np.arange(len(v))[:, None] % 2, v, v + np.array([0, 0, 15])), "axis 3: is as steep as"),
        (lambda v: v[:, :2], "got 2 columns of voltage, need 3"),
        (lambda v: v * np.nan, "finite"),
    ],
)
def test_a_voltage_that_one_axis_forbids_is_refused_before_anything_is_sent(change, words):
    with served() as (server, bench), rig_of(server) as rig:
        with pytest.raises((RecordError, ModelError), match=words):
            rig.play(ex(change(waves())))
        assert [axis.log.largest_step for axis in bench.axes] == [0.0] * 3


@pytest.mark.parametrize(
    ("fault", "error"),
    [("drop", LinkError), ("error", DeviceError), ("saturate", SensorError), ("narrow", DeviceError)],
)
def test_after_a_fault_all_axes_retreat(fault, error):
    with served(fault, speed=2.0) as (server, bench), rig_of(server) as rig:
        rig.patience = 0.5
        with pytest.raises(error) as caught:
            rig.play(ex(waves()))
        assert voltages(bench) == [0.0] * 3
        assert error is not SensorError or "sensor of axis" in str(caught.value)
        note = caught.value.__notes__[0]
        brought = note == "The voltage of the axes 1, 2, 3 was brought to 0, 0, 0 V."
        assert note.safe and brought == (error is not SensorError)
        assert all(axis.log.highest <= high for axis, high in zip(bench.axes, HIGHEST, strict=True))


@pytest.mark.parametrize("fault", ["silence", "refuse"])
def test_a_link_that_stays_lost_is_reported(fault):
    with served(fault, speed=2.0) as (server, _):
        rig = PiRig.connect("127.0.0.1", server.port, axis=["1", "2", "3"], timeout=0.2)
        with rig, pytest.raises(LinkError) as caught:
            rig.play(ex(waves()))
        (note,) = [note for note in caught.value.__notes__ if isinstance(note, VoltageNote)]
        assert not note.safe and "axes 1, 2, 3" in note


def test_retreat_ramps_all_axes_at_once(monkeypatch):
    waits = []
    monkeypatch.setattr(AbstractRig, "_wait", lambda self, seconds: waits.append(seconds))
    with served(speed=1.0) as (server, bench), rig_of(server) as rig:
        for single in rig.rigs:
            monkeypatch.setattr(single, "_now", lambda: sum(waits))
            single.set_voltage(50.0)
        waits.clear()
        assert rig.retreat().tolist() == [0.0] * 3
        assert voltages(bench) == [0.0] * 3
        # The range of an axis takes a second; one after the other they would take the sum.
        seconds = [50.0 / (single.limits.high - single.limits.low) for single in rig.rigs]
        assert max(seconds) - 0.02 < sum(waits) < max(seconds) + 0.1 < sum(seconds)
        assert all(axis.log.largest_step <= 0.011 * high for axis, high in zip(bench.axes, HIGHEST, strict=True))


def test_a_servo_that_is_on_is_switched_off_on_each_axis():
    with served() as (server, bench), rig_of(server) as rig:
        bench.axes[1].servo = True
        with pytest.warns(UserWarning, match="switched"):
            rig.play(ex(waves(200)))
        assert not bench.axes[1].servo


def test_two_of_three_axes_do_not_move_the_third():
    with served() as (server, bench), rig_of(server, "1,3") as rig:
        bench.axes[1].set_voltage(20.0)
        played = rig.play(ex(waves()[:, [0, 2]]))
        assert played.voltage.shape == (1000, 2)
        rig.retreat()
        assert voltages(bench) == [0.0, 20.0, 0.0]


class _Broken(FakeRig):
    """An axis of a device without a link, which can fail."""

    def __init__(self, axis, **options):
        super().__init__((0.0, 100.0), axis=axis, **options)
        self.fail = False

    def _put(self, voltage):
        if self.fail:
            raise OSError("no such wire")
        super()._put(voltage)


class _FakeStage(FakeRig):
    def __init__(self, rigs):
        AbstractRig.__init__(self, "fake", rigs)

    def _close(self):
        pass

    def _wave(self, voltage, rate):
        for row in range(0, len(voltage), 10):
            part = voltage[row : row + 10]
            for rig, column in zip(self.rigs, part.T, strict=True):
                for v in column:
                    rig.instrument.put(v)
            self.now += len(part) / rate
            yield Samples(self.now + np.arange(len(part)) / rate, part.copy(), 1e-7 * part)


def fake_stage():
    stage = _FakeStage([_Broken(axis) for axis in "abc"])
    stage.now = 0.0
    return stage


def test_the_other_axes_retreat_if_one_axis_fails():
    rig = fake_stage()

    def listen(samples):
        if samples.voltage[:, 0].max() > 30:
            rig.rigs[0].fail = True
            raise ValueError("enough")

    with pytest.raises(ValueError, match="enough") as caught:
        rig.play(ex(np.linspace(0, 50, 101)[:, None] * [1, 0.5, 0.2], 1000.0), listen)
    assert [single.instrument.voltage for single in rig.rigs][1:] == [0.0, 0.0]
    assert rig.rigs[0].instrument.voltage > 30
    (note,) = caught.value.__notes__
    assert "could not be brought to 0, 0, 0 V" in note
    assert "no such wire" in note


def test_samples_of_one_axis_that_differ_from_what_was_sent_are_refused():
    rig = fake_stage()
    wave = rig._wave

    def off(voltage, rate):
        for samples in wave(voltage, rate):
            samples.voltage[:, 1] += 20
            yield samples

    rig._wave = off
    with pytest.raises(DeviceError, match="output is 20 V away"):
        rig.play(ex(np.linspace(0, 50, 101)[:, None] * [1, 0.5, 0.2], 1000.0))
    assert [single.instrument.voltage for single in rig.rigs] == [0.0] * 3


class TestAddresses:
    """Where several axes are named."""

    def test_axes_that_the_rig_does_not_have_are_refused(self):
        with pytest.raises(RigError):
            open_rig("sim://", ["1", "2"])
        with served() as (server, _), pytest.raises(RigError, match="1, 3"):
            open_rig(f"pi://127.0.0.1:{server.port}/1,2", ["1", "3"])

    def test_methods_of_a_single_axis_are_refused_for_several(self):
        with served() as (server, _), rig_of(server) as rig:
            for ask in (lambda: rig.limits, lambda: rig.slew_rate, lambda: rig.set_voltage(1.0), rig.read):
                with pytest.raises(RigError, match="the axes 1, 2, 3"):
                    ask()

    def test_a_single_axis_of_several_is_a_rig(self):
        with served() as (server, bench), open_rig(f"pi://127.0.0.1:{server.port}/2") as rig:
            with warnings.catch_warnings():
                warnings.simplefilter("error", ClampWarning)
                rig.set_voltage(110.0)
            assert voltages(bench) == [0.0, 110.0, 0.0]
            rig.retreat()

    def test_limits_are_for_all_axes_or_for_each(self):
        assert bounds_of_axes((0, 50), None, 3) == [((0, 50), None)] * 3
        own = [(0, 50), None, (0, 40)], [200.0, None, 100.0]
        assert bounds_of_axes(*own, 3) == list(zip(*own, strict=True))
        for name, given in (("slew_rate", (None, [1.0, 2.0], 3)), ("limits", (LIMITS[:2], None, 3))):
            with pytest.raises(RigError) as caught:
                bounds_of_axes(*given)
            assert (caught.value.argument, caught.value.got) == (name, "2 for 3")
