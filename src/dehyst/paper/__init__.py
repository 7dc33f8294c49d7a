"""The paper's identification, and the paper's experiment on a virtual actuator."""

from dehyst.paper.methods import PaperFit, identify

__all__ = ["identify"]
