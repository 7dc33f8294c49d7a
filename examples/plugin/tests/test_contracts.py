"""The contracts of dehyst, for each plug-in."""

import io
import wave
from functools import cache

import numpy as np
import on_a_desk
import pytest

import dehyst
from dehyst.baselines import BASELINES
from dehyst.testing import (
    BaselineCandidate,
    BaselineContract,
    ModelCandidate,
    ModelContract,
    ReaderCandidate,
    ReaderContract,
    RigCandidate,
    RigContract,
    TargetCandidate,
    TargetContract,
)
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, descending_tops

VOLTAGE = descending_tops(100, steps=5, drive=Sampling(sample_rate=100)).voltage
RECORD = dehyst.Record(np.arange(VOLTAGE.size) / 100, VOLTAGE, PlayActuator(highest=100).play(VOLTAGE))


class TestWav(ReaderContract):
    @pytest.fixture
    def candidate(self):
        numbers = np.column_stack([RECORD.voltage / 200, RECORD.displacement / 2e-5])
        content = io.BytesIO()
        with wave.open(content, "wb") as file:
            file.setparams((2, 4, 100, 0, "NONE", ""))
            file.writeframes(np.round(numbers * 2**31).astype("<i4").tobytes())
        options = {"voltage": "channel_1", "voltage_scale": "200 V/V"}
        options |= {"displacement": "channel_2", "displacement_scale": "20 um/V"}
        return ReaderCandidate("loops.wav", content.getvalue(), RECORD, options)


class TestLineRig(RigContract):
    @pytest.fixture
    def candidate(self):
        return RigCandidate("line", on_a_desk.desk, gain=1e-7)


@cache
def fitted():
    return BASELINES["polynomial"]([RECORD])


class TestPolynomial(ModelContract):
    @pytest.fixture
    def candidate(self):
        return ModelCandidate("polynomial", fitted)


class TestPolynomialFit(BaselineContract):
    @pytest.fixture
    def candidate(self):
        return BaselineCandidate("polynomial")


class TestStructuredText(TargetContract):
    @pytest.fixture
    def candidate(self):
        return TargetCandidate(".st", on_a_desk.run_block)


def test_the_polynomial_is_worse_than_a_model_with_hysteresis():
    chosen = {"polynomial": BASELINES["polynomial"], "play": BASELINES["Prandtl-Ishlinskii"]}
    polynomial, play = dehyst.compare(RECORD, models=chosen).rows
    assert not polynomial.failure
    assert polynomial.scores[0].rms > 3 * play.scores[0].rms
