"""Baselines: published models and identifications behind the common interface, and their comparison with dehyst's."""

from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.comparison import compare
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.generalized_prandtl_ishlinskii import GeneralizedPrandtlIshlinskii
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.krasnoselskii_pokrovskii import KrasnoselskiiPokrovskii
from dehyst.baselines.linear import Linear
from dehyst.baselines.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from dehyst.baselines.prandtl_ishlinskii import PrandtlIshlinskii
from dehyst.baselines.preisach import Preisach
from dehyst.baselines.registry import BASELINES
from dehyst.baselines.scores import ModelComparison

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
