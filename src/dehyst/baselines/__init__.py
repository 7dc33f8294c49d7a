"""Baselines: published models and identifications behind the common interface, and their comparison with dehyst's."""

from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.comparison import BASELINES, ModelComparison, compare
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.linear import Linear
from dehyst.baselines.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
)
from dehyst.baselines.preisach import Preisach

__all__ = [
    "BASELINES",
    "BoucWen",
    "Duhem",
    "GeneralizedPrandtlIshlinskii",
    "GoldfarbCelanovic",
    "KrasnoselskiiPokrovskii",
    "Linear",
    "ModelComparison",
    "ModifiedPrandtlIshlinskii",
    "PrandtlIshlinskii",
    "Preisach",
    "compare",
]
