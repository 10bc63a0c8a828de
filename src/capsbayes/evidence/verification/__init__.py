"""Verification: what the simulator gives beside numbers from theory, other codes and experiments, and its own limits.

A topic is one file with one `Section`: items to compute, and rows that compare
them. Reference numbers stand in `references`, all others are computed.
"""

from capsbayes.evidence.verification.sections import SECTIONS
from capsbayes.evidence.verification.verify import verify

__all__ = ["SECTIONS", "verify"]
