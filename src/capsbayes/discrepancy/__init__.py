"""What a model misses: where data disagree with it, which effect would explain that, and whether adding it helps."""

from capsbayes.discrepancy.compared import AlongOutline, Compared
from capsbayes.discrepancy.diagnosis import Study, Verdict, Verification, diagnose
from capsbayes.discrepancy.finding import Deviation, Finding, find
from capsbayes.discrepancy.scoring import Scores
from capsbayes.discrepancy.session import Session
from capsbayes.discrepancy.summary import summary

__all__ = [
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
