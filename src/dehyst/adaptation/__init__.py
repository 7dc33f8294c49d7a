"""Adaptation: models that stay true in use."""

from dehyst.adaptation.adaptive_compensator import AdaptiveCompensator, AdaptiveSnapshot
from dehyst.adaptation.estimator import Exchange

__all__ = ["AdaptiveCompensator", "AdaptiveSnapshot", "Exchange"]
