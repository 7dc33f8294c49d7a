"""What others do: rival models and identifications behind the common interface, to compare with on equal terms.

`BASELINES` holds one entry for each way to get a model: its name, and a function of training records that returns the
model or raises a sentence that says why these records give none.
"""

from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.comparison import ModelComparison, compare
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.generalized_prandtl_ishlinskii import GeneralizedPrandtlIshlinskii
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.krasnoselskii_pokrovskii import KrasnoselskiiPokrovskii
from dehyst.baselines.linear import Linear
from dehyst.baselines.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from dehyst.baselines.prandtl_ishlinskii import PrandtlIshlinskii
from dehyst.baselines.preisach import Preisach
from dehyst.baselines.registry import BASELINES

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
