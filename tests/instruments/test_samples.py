"""Samples of a wave: what comes is looked at, its pace and clock are watched, and so is the sensor."""

import numpy as np
import pytest
from fake_rig import BROUGHT, UP, FakeRig
from hypothesis import given
from hypothesis import strategies as st

from dehyst.instruments import DeviceError, LinkError, Samples, SensorError
from dehyst.instruments.waves import SensorWatch


def spoiled(spoil, **options):
    """A rig each of whose lots is replaced by those that `spoil` makes of its number and samples."""
    rig = FakeRig((0.0, 100.0), **options)
    wave = rig._wave

    def spoiling(voltage, rate):
        for number, samples in enumerate(wave(voltage, rate)):
            yield from spoil(number, samples)

    rig._wave = spoiling
    return rig


def at(lot, **columns):
    """Let functions make other columns of those of one lot."""

    def change(number, samples):
        made = {name: make(getattr(samples, name)) for name, make in columns.items()}
        return [samples._replace(**made) if number == lot else samples]

    return change


def with_nan(column):
    return np.where(np.arange(column.size) == 3, np.nan, column)


SPOILT = {
    **{f"{name} is NaN": (at(2, **{name: with_nan}), LinkError) for name in ("time", "voltage", "displacement")},
    "a column is short": (at(2, voltage=lambda v: v[1:]), LinkError),
    "no column": (at(2, voltage=lambda _: np.float64(3)), LinkError),
    "too many": (lambda n, s: [s, s._replace(time=s.time + 0.01)] if n == 10 else [s], LinkError),
    "a lot comes twice": (lambda n, s: [s, s] if n == 3 else [s], LinkError),
    "time stands still": (at(2, time=lambda t: np.full_like(t, t[0])), LinkError),
    "time falls back": (at(4, time=lambda t: t - 1), LinkError),
    "the clock jumps by an hour": (at(5, time=lambda t: t + 3600), DeviceError),
    "a lot is missing": (lambda n, s: [] if n == 10 else [s], DeviceError),
    "nothing comes": (lambda n, s: [], DeviceError),
    "the output stays": (lambda n, s: [s._replace(voltage=np.zeros_like(s.voltage))], DeviceError),
    "a channel that nobody named": (lambda n, s: [s._replace(others={"load_N": s.time})], DeviceError),
    "a channel is short": (lambda n, s: [s._replace(others={"load_N": s.time[1:]})], LinkError),
}


@pytest.mark.parametrize(("spoil", "kind"), SPOILT.values(), ids=SPOILT)
def test_received_samples_are_checked(spoil, kind):
    rig, heard = spoiled(spoil), []
    with pytest.raises(kind) as caught:
        rig.play(UP, heard.append)
    (note,) = caught.value.__notes__
    assert note == BROUGHT and note.safe
    assert rig.instrument.voltage == 0.0 and not rig.instrument.playing
    # A reading that is not believed has no effect, except a finite voltage that differs from the sent one.
    for samples in heard:
        assert all(np.isfinite(column).all() for column in samples[:3])
        assert len({column.shape for column in samples[:3]}) == 1
    assert np.all(np.diff(np.concatenate([[-1.0], *(samples.time for samples in heard)])) > 0)


def test_batches_may_be_lists_empty_and_a_sample_late():
    def late(number, samples):
        voltage = np.concatenate([[late.last], samples.voltage[:-1]])
        late.last = samples.voltage[-1]
        yield Samples(np.zeros(0), np.zeros(0), np.zeros(0))
        yield Samples(samples.time.tolist(), voltage.tolist(), samples.displacement.tolist())

    late.last = 0.0
    assert np.array_equal(spoiled(late).play(UP).voltage[1:], UP.voltage[:-1])


def test_a_wave_with_only_empty_batches_ends(monkeypatch):
    monkeypatch.setattr("dehyst.instruments.waves._PATIENCE", 0.01)
    rig = FakeRig()
    rig._wave = lambda *_: iter(lambda: Samples(*np.zeros((3, 0))), None)
    with pytest.raises(LinkError, match="empty batches"):
        rig.play(UP)


def paced(change, longest=None):
    """A rig whose times are changed: a function of the times since the first one of a piece."""
    first_times = []

    def pace(number, samples):
        first_times.append(samples.time[0])
        return [samples._replace(time=first_times[0] + change(samples.time - first_times[0]))]

    return spoiled(pace, longest=longest)


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


@given(st.lists(st.integers(1, 40), min_size=1), st.data())
def test_the_check_of_the_sensor_does_not_depend_on_batches(sizes, data):
    """The same answer for a record in one piece and in lots."""
    n = sum(sizes)
    voltage = np.cumsum(data.draw(st.lists(st.floats(-8, 8), min_size=n, max_size=n)))
    steps = data.draw(st.lists(st.sampled_from([0, 0, 0, 1]), min_size=n, max_size=n))
    displacement = np.cumsum(steps).astype(float)

    def alarmed(cuts):
        watch = SensorWatch(100.0)
        try:
            for lot in zip(np.split(voltage, cuts), np.split(displacement, cuts), strict=True):
                watch.observe(*lot)
        except SensorError:
            return True
        return False

    stretches = [voltage[displacement == value] for value in np.unique(displacement)]
    assert alarmed([]) == alarmed(np.cumsum(sizes)[:-1]) == any(np.ptp(stretch) > 20.0 for stretch in stretches)
