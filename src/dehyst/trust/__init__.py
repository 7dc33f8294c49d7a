"""Trust: the error to expect on a path, what to record next, checks, updates, and the comparison with others."""

from dehyst.trust.assessment import insight
from dehyst.trust.baselines import AbstractBaseline
from dehyst.trust.changes import Change
from dehyst.trust.comparison import OURS, ModelComparison, RecordScore, compare
from dehyst.trust.insight_result import Insight
from dehyst.trust.judgement import judge, judge_planned
from dehyst.trust.prediction_band import ERRORS, PredictionBand
from dehyst.trust.recheck import Recheck, check
from dehyst.trust.stage_assessment import StageInsight, check_stage, stage_insight
from dehyst.trust.start import start_of
from dehyst.trust.turn_plane import Turn, TurnPlane, turn_plane
from dehyst.trust.update import Update, update, update_stage

__all__ = [
    "AbstractBaseline",
    "Change",
    "Insight",
    "ModelComparison",
    "Recheck",
    "Update",
    "check",
    "check_stage",
    "compare",
    "insight",
    "judge",
    "stage_insight",
    "update",
    "update_stage",
]
