"""The paper's experiment on a virtual actuator."""

from dehyst.paper.run import Paper

__all__ = ["Paper"]
