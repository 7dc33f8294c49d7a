"""Adaptation: models that stay true in use, by a new record or in the loop."""

from dehyst.adaptation.adaptive_compensator import FEWEST, AdaptiveCompensator, AdaptiveSnapshot, Drift
from dehyst.adaptation.adaptive_stage import AdaptiveStageCompensator
from dehyst.adaptation.record_update import Update, update, update_stage

__all__ = ["AdaptiveCompensator", "AdaptiveSnapshot", "AdaptiveStageCompensator", "Update", "update", "update_stage"]
