"""Virtual actuators for tests and benchmarks, beside the one of `dehyst.virtual`: no model of dehyst is one of them.

On ever finer grids the models of Preisach and of Krasnosel'skii, and plays times ramps (Krejci's form of Preisach's
operator), approach `PreisachActuator`. `ModelledActuator` is a model itself.
"""

from truths.bouc_wen import BoucWenActuator
from truths.modelled import VIRTUAL, ModelledActuator
from truths.preisach import PreisachActuator

__all__ = ["VIRTUAL", "BoucWenActuator", "ModelledActuator", "PreisachActuator"]
