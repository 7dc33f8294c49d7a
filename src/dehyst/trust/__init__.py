"""Trust: the error to expect on a path, what to record next, checks, updates, and the comparison with others."""

from dehyst.trust.assessment import Insight, StageInsight, insight
from dehyst.trust.baselines import AbstractBaseline
from dehyst.trust.changes import Change
from dehyst.trust.comparison import OURS, Best, ModelComparison, ModelScore, compare
from dehyst.trust.recheck import Recheck, StageRecheck, Standing, check
from dehyst.trust.start import start_of
from dehyst.trust.turn_plane import Turn, TurnPlane, turn_plane
from dehyst.trust.update import StageUpdate, Update, update

__all__ = ["AbstractBaseline", "check", "compare", "insight", "update"]
