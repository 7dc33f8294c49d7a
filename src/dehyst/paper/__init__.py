"""What the paper defines: its identification, and its experiment on a virtual actuator."""

from dehyst.paper.methods import PaperFit, identify
from dehyst.paper.run import Paper

__all__ = ["Paper", "PaperFit", "identify"]
