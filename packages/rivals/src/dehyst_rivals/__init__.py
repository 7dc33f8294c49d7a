"""Nine published models of hysteresis, each with its own published fit, for `dehyst compare`."""

from dehyst_rivals.bouc_wen import BoucWen
from dehyst_rivals.duhem import Duhem
from dehyst_rivals.goldfarb_celanovic import GoldfarbCelanovic
from dehyst_rivals.linear_ratio import linear_ratio
from dehyst_rivals.play_models import (
    GeneralizedPrandtlIshlinskii,
    KrasnoselskiiPokrovskii,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
)
from dehyst_rivals.preisach import Preisach
from dehyst_rivals.training import Training, fit_with_delay

__all__ = [
    "RIVALS",
    "BoucWen",
    "Duhem",
    "GeneralizedPrandtlIshlinskii",
    "GoldfarbCelanovic",
    "KrasnoselskiiPokrovskii",
    "ModifiedPrandtlIshlinskii",
    "PrandtlIshlinskii",
    "Preisach",
    "Training",
    "fit_with_delay",
    "linear_ratio",
]

# The entry points of `pyproject.toml`: the name of each model, and a function of a list of records.
RIVALS = {
    "Goldfarb-Celanovic": GoldfarbCelanovic.fit,
    "Prandtl-Ishlinskii": PrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, modified": ModifiedPrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, generalised": GeneralizedPrandtlIshlinskii.fit,
    "Krasnoselskii-Pokrovskii": KrasnoselskiiPokrovskii.fit,
    "Preisach": Preisach.fit,
    "Preisach, reversal curves": Preisach.from_reversal_curves,
    "Bouc-Wen": BoucWen.fit,
    "Duhem": Duhem.fit,
}
