"""What a model misses: where data disagree with it, which effect would explain that, and whether adding it helps."""

from capsbayes.discrepancy.diagnosis import Study, Verdict, diagnose
from capsbayes.discrepancy.finding import Deviation, Finding, find
from capsbayes.discrepancy.session import Session

__all__ = ["Deviation", "Finding", "Session", "Study", "Verdict", "diagnose", "find"]
