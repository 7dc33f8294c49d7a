"""Baselines: published models and identifications behind the common interface, and their comparison with dehyst's."""

from dehyst.baselines.base import AbstractBaseline, Training, fit_with_delay
from dehyst.baselines.comparison import BASELINES, OURS, ModelComparison, RecordScore, compare
from dehyst.baselines.goldfarb_celanovic import GoldfarbCelanovic
from dehyst.baselines.tracking_trials import TrackingErrors

__all__ = ["BASELINES", "AbstractBaseline", "ModelComparison", "Training", "compare", "fit_with_delay"]
