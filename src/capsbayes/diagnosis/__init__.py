"""Diagnosis of a model: deviations of the data from it, the effect that explains them, and its verification."""

from capsbayes.diagnosis.comparison import AlongOutline, Comparison
from capsbayes.diagnosis.diagnosis import Study, Verdict, diagnose
from capsbayes.diagnosis.finding import Deviation, Finding, find
from capsbayes.diagnosis.scoring import Scores
from capsbayes.diagnosis.search import LEAST_RATIO, NOTHING, UNKNOWN
from capsbayes.diagnosis.session import Session
from capsbayes.diagnosis.session_modulus import SessionModulus
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
    "SessionModulus",
    "Study",
    "Verdict",
    "Verification",
    "diagnose",
    "find",
    "summary",
]
