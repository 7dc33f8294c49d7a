"""What every model must do, and the fit of every one on records of a virtual actuator."""

from functools import cache, partial

import numpy as np
import pytest
from model_contract import ModelCandidate, ModelContract

from dehyst import Record
from dehyst.model import simulated
from dehyst.trust import compare
from dehyst.trust.baselines import Linear
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, standard
from dehyst_rivals import (
    RIVALS,
    BoucWen,
    Duhem,
    GeneralizedPrandtlIshlinskii,
    GoldfarbCelanovic,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    Preisach,
    linear_ratio,
)

VOLTS, RATE = 100.0, 100.0


def goldfarb():
    """Return the model identified from a rise to 10 um and 100 V."""
    u = np.linspace(0, 1, 101)
    return GoldfarbCelanovic.fit(Record(u, VOLTS * (0.7 * u + 0.3 * np.sqrt(u)), 1e-5 * u))


def preisach():
    """Return a model with a ridge of relays, more of them at high voltages."""
    nodes = np.linspace(0, 1, 13)
    alpha, beta = np.meshgrid(nodes, nodes, indexing="ij")
    return Preisach((0.0, VOLTS), 1e-5 * (alpha - beta) * (0.6 + 0.3 * (alpha - beta) + 0.2 * alpha), 2e-6)


def boucwen():
    """Return a model with a bent map."""
    return BoucWen(0.45, 0.04, 0.02, (-5.0, 95.0), [1e-6, 1.2e-5, -6e-6, 4e-6])


def duhem():
    """Return a model with a bent middle line."""
    return Duhem((0.0, VOLTS), 5.0, [1e-6, 1.2e-5, -3e-6, 1e-6], [8e-6, -1e-6])


@cache
def fitted(kind, **options):
    """Return a model identified from loops of falling tops up to 100 V."""
    voltage = standard.descending_tops(VOLTS, steps=5, drive=Sampling(sample_rate=1.0)).voltage
    y = PlayActuator(highest=VOLTS).play(voltage)
    return kind.fit(Record(np.arange(y.size), voltage, y), delay=0.0, **options)


MODELS = [
    ModelCandidate("Goldfarb and Celanovic", goldfarb),
    ModelCandidate("Prandtl and Ishlinskii", partial(fitted, PrandtlIshlinskii)),
    ModelCandidate("Kuhnen", partial(fitted, ModifiedPrandtlIshlinskii)),
    ModelCandidate("generalised Prandtl and Ishlinskii", partial(fitted, GeneralizedPrandtlIshlinskii, lowpasses=())),
    ModelCandidate("Krasnosel'skii and Pokrovskii", partial(fitted, KrasnoselskiiPokrovskii)),
    ModelCandidate("Preisach", preisach),
    ModelCandidate("Bouc-Wen", boucwen, wipes_out=False),
    ModelCandidate("Duhem", duhem, wipes_out=False),
]


class TestEveryModel(ModelContract):
    @pytest.fixture(params=MODELS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param


def record(name, voltage, offset):
    y = PlayActuator(highest=VOLTS).play(voltage)
    return Record(np.arange(voltage.size) / RATE, voltage, y + offset, name)


@cache
def records():
    """Return two records to fit, loops with falling tops and turns anywhere, and a held-out one with other turns."""
    tops = standard.descending_tops(VOLTS, steps=5, drive=Sampling(frequency=1.0, sample_rate=RATE)).voltage
    turns = [np.r_[0, VOLTS, 0, np.random.default_rng(seed).uniform(0, VOLTS, 16)] for seed in (1, 2)]
    turning = [np.interp(np.arange(0, turn.size - 1, 1 / 25), np.arange(turn.size), turn) for turn in turns]
    first, second, third = (record(f"loops {k}", v, 1e-6 * k) for k, v in enumerate([tops, *turning]))
    return [first, second], third


FITS = {**RIVALS, "linear ratio, delayed": linear_ratio}


@cache
def first_fit(name):
    return FITS[name](list(records()[0]))


@pytest.mark.parametrize("name", FITS)
def test_errors_are_not_much_larger_than_those_of_a_straight_line(name):
    training, held_out = records()
    line, row = compare(
        training, validate=held_out, models={"a line": Linear.fit, "it": lambda _: first_fit(name)}
    ).rows
    assert not row.failure
    for score, straight in zip(row.scores, line.scores, strict=True):
        assert score.rms <= 2 * straight.rms, score.record


@pytest.mark.parametrize("name", FITS)
def test_the_same_records_give_the_same_model(name):
    training, held_out = records()
    first, second = first_fit(name), FITS[name](list(training))
    assert first.delay == second.delay
    assert 0 <= first.delay < min(np.ptp(record.time) for record in training)
    made = [simulated(fit, held_out.voltage, held_out.time).displacement for fit in (first, second)]
    assert np.isfinite(made[0]).all()
    assert np.array_equal(*made)
