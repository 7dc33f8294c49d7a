"""What every model must do, ours and every baseline. To enter a model, add one line to `MODELS`.

The tests are those of `dehyst.testing`.
"""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from dehyst import (
    Actuator,
    Creep,
    DisplacementCreep,
    GradedSlip,
    MaxwellSlip,
    Record,
    SmoothSlip,
    Spring,
    Transformer,
)
from dehyst.baselines import GoldfarbCelanovic
from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.linear import Linear
from dehyst.baselines.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
)
from dehyst.baselines.preisach import Preisach
from dehyst.testing import ModelCandidate, ModelContract
from dehyst.virtual import PlayActuator
from dehyst.waveforms import Sampling, standard

VOLTS = 100.0


def actuator(elements, knots, volts):
    """Return an actuator of 10 um; elements of increasing stiffness on a uniform grid."""
    rho = 5e-6 * np.arange(1, elements + 1) / max(elements, 1)
    kappa = 4e6 * np.arange(1, elements + 1) / max(elements, 1) ** 2
    return Actuator(MaxwellSlip(rho, kappa), Spring(knots, volts))


CREEP = Creep([0.01, 0.3, 10.0], [1e5, 3e5, 2e5])
BEHIND = DisplacementCreep([0.01, 0.3, 10.0], [0.01, 0.02, 0.03])


def wider(elements, *, creep):
    """Return an actuator whose elements are stiffer in the middle, seen through a bent transformer."""
    rho = 5e-6 * np.arange(1, elements + 1) / elements
    slip = GradedSlip(rho, [0, 3e-6, 7e-6, 1e-5], np.outer(4e6 * rho / rho.sum(), [0.9, 1.2, 1.0]))
    bend = Transformer([0, 0.3 * VOLTS, VOLTS], [0, 0.35 * VOLTS, VOLTS])
    return Actuator(slip, Spring([0, 1e-5], [0, 80]), transformer=bend, creep=CREEP if creep else None)


def goldfarb():
    """Return the baseline identified from a rise to 10 um and 100 V."""
    u = np.linspace(0, 1, 101)
    return GoldfarbCelanovic.fit(Record(u, VOLTS * (0.7 * u + 0.3 * np.sqrt(u)), 1e-5 * u))


def preisach():
    """Return a baseline with a ridge of relays, more of them at high voltages."""
    nodes = np.linspace(0, 1, 13)
    alpha, beta = np.meshgrid(nodes, nodes, indexing="ij")
    return Preisach((0.0, VOLTS), 1e-5 * (alpha - beta) * (0.6 + 0.3 * (alpha - beta) + 0.2 * alpha), 2e-6)


def boucwen():
    """Return a baseline with a bent map."""
    return BoucWen(0.45, 0.04, 0.02, (-5.0, 95.0), [1e-6, 1.2e-5, -6e-6, 4e-6])


def duhem():
    """Return a baseline with a bent middle line."""
    return Duhem((0.0, VOLTS), 5.0, [1e-6, 1.2e-5, -3e-6, 1e-6], [8e-6, -1e-6])


def smooth():
    """Return ten elements beside three smooth ones."""
    plain = actuator(10, np.linspace(0, 1e-5, 11), 60 * np.linspace(0, 1, 11) ** 1.3)
    return Actuator(plain.slip, plain.spring, smooth=SmoothSlip([3e-7, 1e-6, 4e-6], [1, 0.5, 0.8], [5e6, 3e6, 2e6]))


@cache
def fitted(kind, **options):
    """Return a baseline identified from loops of falling tops up to 100 V."""
    voltage = standard.descending_tops(VOLTS, steps=5, drive=Sampling(sample_rate=1.0)).voltage
    y = PlayActuator(highest=VOLTS).play(voltage)
    return kind.fit(Record(np.arange(y.size), voltage, y), delay=0.0, **options)


MODELS = [
    ModelCandidate("spring alone", lambda: actuator(0, [0, 4e-6, 1e-5], [0, 60, 100])),
    ModelCandidate("one element", lambda: actuator(1, [0, 1e-5], [0, 80])),
    ModelCandidate("ten elements", lambda: actuator(10, np.linspace(0, 1e-5, 11), 90 * np.linspace(0, 1, 11) ** 1.3)),
    ModelCandidate("thousand elements", lambda: actuator(1000, [0, 2e-6, 1e-5], [0, 10, 90])),
    ModelCandidate("graded elements and a transformer", lambda: wider(10, creep=False)),
    ModelCandidate("graded elements, a transformer and creep", lambda: wider(10, creep=True)),
    ModelCandidate("plain elements and creep", lambda: replace(actuator(10, [0, 1e-5], [0, 80]), creep=CREEP)),
    ModelCandidate(
        "plain elements and creep in displacement",
        lambda: replace(actuator(10, [0, 1e-5], [0, 80]), displacement_creep=BEHIND),
    ),
    ModelCandidate("Goldfarb and Celanovic", goldfarb),
    ModelCandidate("Prandtl and Ishlinskii", partial(fitted, PrandtlIshlinskii)),
    ModelCandidate("Kuhnen", partial(fitted, ModifiedPrandtlIshlinskii)),
    ModelCandidate("generalised Prandtl and Ishlinskii", partial(fitted, GeneralizedPrandtlIshlinskii, lowpasses=())),
    ModelCandidate("Krasnosel'skii and Pokrovskii", partial(fitted, KrasnoselskiiPokrovskii)),
    ModelCandidate("linear ratio", lambda: Linear(1e-7, 1e-6)),
    ModelCandidate("Preisach", preisach),
    ModelCandidate("Bouc-Wen", boucwen, wipes_out=False),
    ModelCandidate("Duhem", duhem, wipes_out=False),
    ModelCandidate("smooth elements", smooth, wipes_out=False),
]


class TestEveryModel(ModelContract):
    @pytest.fixture(params=MODELS, ids=lambda candidate: candidate.name)
    def candidate(self, request):
        return request.param


@pytest.mark.parametrize(
    "wrong",
    [
        None,
        np.abs,
        lambda voltage: np.where(voltage > 100.5, 1.5 * voltage, voltage),
        lambda voltage: np.where(np.arange(voltage.size) > 300, 1.5 * voltage, voltage),
    ],
    ids=["right", "below 0 V", "above 100 V", "late in the path"],
)
def test_a_wrong_inverse_is_noticed(wrong):
    class Wrong(Linear):
        def _run(self, drive, state, time, *, inverse):
            out, after = super()._run(drive, state, time, inverse=inverse)
            return wrong(out) if inverse and wrong else out, after

    contract, model, candidate = ModelContract(), Wrong(1e-7), ModelCandidate("wrong", lambda: None)
    with pytest.raises(AssertionError) if wrong else nullcontext():
        contract.test_simulating_the_compensation_gives_the_path(model, candidate)
        for middle in (0.15, 0.85):
            contract.test_an_inverse_beyond_the_range_is_right_or_refused(model, candidate, middle)
