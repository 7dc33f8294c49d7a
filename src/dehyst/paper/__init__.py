"""The paper's identification, and the paper's experiment on a virtual actuator."""

from dehyst.paper.methods import PaperFit, identify
from dehyst.paper.run import Paper

__all__ = ["Paper", "PaperFit", "identify"]
