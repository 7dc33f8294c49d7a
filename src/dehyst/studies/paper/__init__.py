"""The paper's experiment on a virtual actuator."""

from dehyst.studies.paper.run import Paper
from dehyst.studies.paper.tables import summary

__all__ = ["Paper"]
