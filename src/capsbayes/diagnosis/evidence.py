"""How likely each explanation of a disagreement is beside the others, one that nobody has thought of among them.

If all are as likely beforehand, the odds between two are the ratio of their
evidences: of the likelihoods averaged over what was held possible of the size of
each effect, or of the displacements of the regions for one that nobody has
thought of.
"""

from __future__ import annotations

from collections.abc import Mapping

from capsbayes.diagnosis.finding import Finding
from capsbayes.diagnosis.scoring import Scores

__all__ = ["NOTHING", "UNKNOWN", "evidences"]

NOTHING, UNKNOWN = "none", "unknown"


def evidences(scores: Mapping[str, Scores], finding: Finding) -> dict[str, float]:
    """Logarithm of the evidence of each effect, of `NOTHING` and of `UNKNOWN`, over that of `NOTHING`.

    Parameters
    ----------
    scores : mapping of str to Scores
        Of every candidate beside the same model.
    finding : Finding
        With that model.

    Returns
    -------
    dict
        The likeliest first.
    """
    found = {name: one.evidence for name, one in scores.items()}
    found |= {NOTHING: 0.0, UNKNOWN: finding.displacements.evidence}
    return dict(sorted(found.items(), key=lambda item: -item[1]))
