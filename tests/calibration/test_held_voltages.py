"""Voltages that the host times are held, read in the middle, and led by the actuator's delay with a sensor too."""

from itertools import pairwise

import numpy as np
import pytest

import dehyst
from dehyst.calibration.following import FollowedPath
from dehyst.instruments import AbstractRig, Reading
from dehyst.model import stroke_of
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Excitation, Sampling, descending_tops


class Host(AbstractRig):
    """A stage that follows each voltage `late` seconds after it was sent; `now` is the only clock."""

    def __init__(self, late):
        self.now, self.late, self.truth = 0.0, late, PlayActuator(noise=0.0)
        self.volts, self.moves = 0.0, [(0.0, 0.0)]
        super().__init__("held", dehyst.VoltageLimits(0.0, 120.0, 2000.0))

    def _read(self):
        due = [move for at, move in self.moves if at <= self.now - self.late]
        return Reading(self.now, self.volts, due[-1] if due else 0.0)

    def _put(self, voltage):
        self.volts = voltage
        self.moves = [*self.moves[-20:], (self.now, float(self.truth.play([voltage], time=[self.now])[0]))]

    def _halt(self):
        pass

    def _close(self):
        pass

    def _now(self):
        return self.now

    def _wait(self, seconds):
        self.now += seconds


@pytest.mark.parametrize("rate", [10.0, 50.0, 200.0])
def test_the_displacement_is_read_in_the_middle_of_a_held_voltage(rate):
    rig = Host(0.0)
    record = rig.play(Excitation("held", np.linspace(0, 5, 16), rate))
    sent = [at for at, _ in rig.moves[-16:]]
    assert record.time[:-1] == pytest.approx(np.mean([*pairwise(sent)], axis=1), abs=1e-9)


@pytest.mark.parametrize("late", [0.0, 0.01])
def test_a_path_is_on_time_at_other_rates_and_with_feedback(late, tmp_path):
    sampling = Sampling(frequency=0.5, sample_rate=100, limits=(0, 120), slew_rate=2000)
    record = Host(late).play(descending_tops(120, drive=sampling))
    model = dehyst.identify(record, structure="maxwell_slip").actuator
    assert model.delay == pytest.approx(late, abs=1e-3)
    for rate in (100.0, 200.0):
        wanted = 3.7e-6 - 3e-6 * np.cos(np.pi * np.arange(4 * rate) / rate)[:, None]
        for feedback in (False, True):
            rig = Host(late)
            followed = FollowedPath(rig, model, [rig.limits], rate, wanted, len(wanted))
            followed.follow(tmp_path / f"{rate:g}{feedback}.csv", feedback=feedback)
            # A delay of one sample of 5 ms is 0.6 % of the stroke in this path.
            assert np.ptp(followed.best.error) < 3e-3 * stroke_of(model)
