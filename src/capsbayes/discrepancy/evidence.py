"""How likely each explanation of a disagreement is beside the others, one that nobody has thought of among them.

If all are as likely beforehand, the odds between two are the ratio of their
evidences: of the likelihoods averaged over what was held possible of the size of
each effect. One that nobody has thought of is taken to displace the edges of the
regions of the outline, alike in all capsules, by amounts that are normal about
zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capsbayes.discrepancy.fits import Fits
from capsbayes.discrepancy.regions import REGIONS
from capsbayes.discrepancy.scoring import Scores
from capsbayes.discrepancy.whitening import OfOutline, Whitening, displaced_regions

__all__ = ["NOTHING", "UNKNOWN", "evidences", "unknown_evidence"]

NOTHING, UNKNOWN = "none", "unknown"

_DISPLACED = 0.02  # standard deviation of each region's displacement, over l


def evidences(scores: Mapping[str, Scores], white: Whitening, fits: Fits) -> dict[str, float]:
    """Logarithm of the evidence of each effect, of `NOTHING` and of `UNKNOWN`, over that of `NOTHING`.

    Parameters
    ----------
    scores : mapping of str to Scores
        Of every candidate beside the same model.
    white : Whitening
    fits : Fits
        Of that model.

    Returns
    -------
    dict
        The likeliest first.
    """
    found = {name: one.evidence for name, one in scores.items()}
    found |= {NOTHING: 0.0, UNKNOWN: unknown_evidence(white, fits)}
    return dict(sorted(found.items(), key=lambda item: -item[1]))


def unknown_evidence(white: Whitening, fits: Fits) -> float:
    """Log of the likelihood of displaced regions, averaged over the displacements, over that of the model as it is.

    Zero without outlines.
    """
    precision = np.eye(len(REGIONS)) / _DISPLACED**2
    information, shift = np.zeros_like(precision), np.zeros(len(REGIONS))
    for i in np.flatnonzero(fits.settled):
        whitener = white.each[i]
        if isinstance(whitener, OfOutline):
            patterns = displaced_regions(whitener, fits.slopes[i])
            information += patterns @ patterns.T
            shift += patterns @ fits.residuals[i]
    together = precision + information
    volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(together)[1]
    return float(0.5 * shift @ np.linalg.solve(together, shift) + 0.5 * volume)
