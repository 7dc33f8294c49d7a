"""Operations: the steps of the journey, files in and files out, for the command line and the workbench."""

from dehyst.operations.declaration import Operation, Parameter
from dehyst.operations.registry import JOURNEY, find
from dehyst.operations.run import InterruptibleRun, Result, Run, perform, terminable

__all__ = [
    "JOURNEY",
    "InterruptibleRun",
    "Operation",
    "Parameter",
    "Result",
    "Run",
    "find",
    "perform",
    "terminable",
]
