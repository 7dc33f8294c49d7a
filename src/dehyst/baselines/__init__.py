"""Baselines: what is done without dehyst, models of others from plug-ins, and their comparison with dehyst's."""

from dehyst.baselines.base import AbstractBaseline
from dehyst.baselines.comparison import BASELINES, OURS, ModelComparison, RecordScore, compare

__all__ = ["BASELINES", "AbstractBaseline", "ModelComparison", "compare"]
