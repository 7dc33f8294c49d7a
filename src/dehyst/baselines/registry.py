"""The baselines by name.

`BASELINES` holds one entry for each way to get a model: its name, and a function of training records that returns the
model or raises an error that states why these records give none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from dehyst.baselines.bouc_wen import BoucWen
from dehyst.baselines.duhem import Duhem
from dehyst.baselines.generalized_prandtl_ishlinskii import GeneralizedPrandtlIshlinskii
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.krasnoselskii_pokrovskii import KrasnoselskiiPokrovskii
from dehyst.baselines.linear import Linear
from dehyst.baselines.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from dehyst.baselines.prandtl_ishlinskii import PrandtlIshlinskii
from dehyst.baselines.preisach import Preisach
from dehyst.model import AbstractModel
from dehyst.records import Record

Identification: TypeAlias = Callable[[Sequence[Record]], AbstractModel]

BASELINES: Mapping[str, Identification] = {
    "Goldfarb-Celanovic": lambda records: GoldfarbCelanovic.fit(records[0]),
    "Prandtl-Ishlinskii": PrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, modified": ModifiedPrandtlIshlinskii.fit,
    "Prandtl-Ishlinskii, generalised": GeneralizedPrandtlIshlinskii.fit,
    "Krasnoselskii-Pokrovskii": KrasnoselskiiPokrovskii.fit,
    "Preisach": Preisach.fit,
    "Preisach, reversal curves": Preisach.from_reversal_curves,
    "Bouc-Wen": BoucWen.fit,
    "Duhem": Duhem.fit,
    "linear ratio": Linear.fit,
}
