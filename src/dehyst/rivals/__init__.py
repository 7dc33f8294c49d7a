"""What others do: rival models and identifications behind the common interface, to compare with on equal terms.

`RIVALS` holds one entry for each way to get a model: its name, and a function of training records that returns the
model or raises a sentence that says why these records give none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

from dehyst.model import AbstractModel
from dehyst.record import Record
from dehyst.rivals.boucwen import BoucWen
from dehyst.rivals.duhem import Duhem
from dehyst.rivals.generalised import Generalised
from dehyst.rivals.goldfarb import Goldfarb
from dehyst.rivals.krasnoselskii import Krasnoselskii
from dehyst.rivals.kuhnen import Kuhnen
from dehyst.rivals.linear import Linear
from dehyst.rivals.prandtl import Prandtl
from dehyst.rivals.preisach import Preisach

Identification: TypeAlias = Callable[[Sequence[Record]], AbstractModel]

RIVALS: Mapping[str, Identification] = {
    "Goldfarb-Celanovic": lambda records: Goldfarb.fit(records[0]),
    "Prandtl-Ishlinskii": Prandtl.fit,
    "Prandtl-Ishlinskii, modified": Kuhnen.fit,
    "Prandtl-Ishlinskii, generalised": Generalised.fit,
    "Krasnoselskii-Pokrovskii": Krasnoselskii.fit,
    "Preisach": Preisach.fit,
    "Preisach, reversal curves": Preisach.from_reversal_curves,
    "Bouc-Wen": BoucWen.fit,
    "Duhem": Duhem.fit,
    "linear ratio": Linear.fit,
}
