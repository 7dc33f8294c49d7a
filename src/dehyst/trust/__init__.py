"""Trust: what records determine of a model, how wrong a path may come out, and whether the model still holds."""

from dehyst.trust.assessment import insight
from dehyst.trust.changes import Change
from dehyst.trust.history import CheckHistory
from dehyst.trust.insight_result import Insight
from dehyst.trust.judgement import Judgement, judge
from dehyst.trust.recheck import Recheck, Standing, check
from dehyst.trust.stage_assessment import StageInsight, StageRecheck, check_stage, stage_insight
from dehyst.trust.start import start_of

__all__ = [
    "Change",
    "CheckHistory",
    "Insight",
    "Judgement",
    "Recheck",
    "StageInsight",
    "StageRecheck",
    "Standing",
    "check",
    "check_stage",
    "insight",
    "judge",
    "stage_insight",
    "start_of",
]
