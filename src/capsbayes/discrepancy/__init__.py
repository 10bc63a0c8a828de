"""Where data disagree with a model."""

from capsbayes.discrepancy.finding import Deviation, Finding, find
from capsbayes.discrepancy.fits import Fits, fitted
from capsbayes.discrepancy.session import Session

__all__ = ["Deviation", "Finding", "Fits", "Session", "find", "fitted"]
