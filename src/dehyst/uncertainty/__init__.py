"""Uncertainty: what the records leave open, and how far a model can be trusted."""

from dehyst.uncertainty.assessment import insight
from dehyst.uncertainty.initial_state import FirstRise, state_from_first_rise
from dehyst.uncertainty.insight_result import Insight
from dehyst.uncertainty.rest_states import RestStates

__all__ = ["FirstRise", "Insight", "RestStates", "insight", "state_from_first_rise"]
