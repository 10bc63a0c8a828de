"""Diagnosis of a model: deviations of the data from it, the effect that explains them, and its verification."""

from capsbayes.diagnosis.diagnosis import Study, Verdict, diagnose, summary
from capsbayes.diagnosis.finding import Deviation, Finding, SessionModulus, find
from capsbayes.diagnosis.odds import NOTHING, UNKNOWN
from capsbayes.diagnosis.scores import Scores
from capsbayes.diagnosis.search import LEAST_RATIO, AlongOutline, Comparison
from capsbayes.diagnosis.session import Session
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
    "SessionModulus",
    "Study",
    "Verdict",
    "Verification",
    "diagnose",
    "find",
    "summary",
]
