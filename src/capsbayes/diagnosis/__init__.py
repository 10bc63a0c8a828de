"""What a model misses: where data disagree with it, which effect would explain that, and whether adding it helps."""

from capsbayes.diagnosis.comparison import AlongOutline, Comparison
from capsbayes.diagnosis.diagnosis import Study, Verdict, diagnose
from capsbayes.diagnosis.finding import Deviation, Finding, find
from capsbayes.diagnosis.scoring import Scores
from capsbayes.diagnosis.search import LEAST_RATIO, NOTHING, UNKNOWN
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.summary import summary
from capsbayes.diagnosis.verification import Verification

__all__ = [
    "LEAST_RATIO",
    "NOTHING",
    "UNKNOWN",
    "AlongOutline",
    "Comparison",
    "Deviation",
    "Finding",
    "Scores",
    "Session",
    "Study",
    "Verdict",
    "Verification",
    "diagnose",
    "find",
    "summary",
]
