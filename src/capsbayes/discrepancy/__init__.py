"""What a model misses: where data disagree with it, which effect would explain that, and whether adding it helps."""

from capsbayes.discrepancy.compared import AlongOutline, Compared
from capsbayes.discrepancy.diagnosis import Study, Verdict, diagnose
from capsbayes.discrepancy.evidence import NOTHING, UNKNOWN
from capsbayes.discrepancy.finding import Deviation, Finding, find
from capsbayes.discrepancy.scoring import Scores
from capsbayes.discrepancy.search import LEAST_GAIN
from capsbayes.discrepancy.session import Session
from capsbayes.discrepancy.summary import summary
from capsbayes.discrepancy.verification import Verification

__all__ = [
    "LEAST_GAIN",
    "NOTHING",
    "UNKNOWN",
    "AlongOutline",
    "Compared",
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
