"""The paper's experiment on a virtual actuator."""

from dehyst.studies.paper.run import Paper

__all__ = ["Paper"]
