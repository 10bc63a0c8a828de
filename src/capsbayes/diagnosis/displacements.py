"""What the outlines of a session say of displacements of their regions that all capsules have in common.

An effect that nobody has thought of is taken to be such displacements, normal about zero. Their evidence over none
says whether anything is left to explain, with the whole covariance and all regions together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.regions import REGIONS, region_displacements
from capsbayes.diagnosis.whitening import OfOutline, Whitening
from capsbayes.infer.outline.likelihood import OutlineLikelihood

__all__ = ["Displaced", "Displacements", "displaced_regions"]

Floats = NDArray[np.float64]

_DISPLACED = 0.02  # standard deviation of each region's displacement, over l


@dataclass(frozen=True, eq=False)
class Displacements:
    """Of the regions, in l; those of several sessions add up.

    Parameters
    ----------
    information : (5, 5) array
        Inverse of the covariance that the outlines alone leave to the displacements.
    shift : (5,) array
        Information times the likeliest displacements.
    """

    information: Floats = field(default_factory=lambda: np.zeros((len(REGIONS), len(REGIONS))))
    shift: Floats = field(default_factory=lambda: np.zeros(len(REGIONS)))

    @classmethod
    def of(cls, seen: Iterable[Displaced], fits: Fits) -> Displacements:
        """From what displacements change, and the fits with which that was found."""
        found = cls()
        for one in seen:
            found += cls(one.pattern @ one.pattern.T, one.pattern @ fits.residuals[one.row])
        return found

    def __add__(self, other: Displacements) -> Displacements:
        """Of other capsules too."""
        return Displacements(self.information + other.information, self.shift + other.shift)

    @property
    def evidence(self) -> float:
        """Log of the likelihood averaged over the displacements, over that of none; zero without outlines."""
        precision = np.eye(len(REGIONS)) / _DISPLACED**2
        together = precision + self.information
        volume = np.linalg.slogdet(precision)[1] - np.linalg.slogdet(together)[1]
        return float(0.5 * self.shift @ np.linalg.solve(together, self.shift) + 0.5 * volume)


class Displaced(NamedTuple):
    """What displacements of the regions by l would leave over of one capsule, (5, m), whitened.

    Log Ca and a/l have absorbed what they can. `row` is the capsule's, `likelihood` that of its outline.
    """

    row: int
    likelihood: OutlineLikelihood
    pattern: Floats


def displaced_regions(white: Whitening, fits: Fits) -> list[Displaced]:
    """Of the capsules that have an outline and a best shape."""
    found = []
    for row in np.flatnonzero(fits.settled):
        whitener = white.each[row]
        if isinstance(whitener, OfOutline):
            seen = whitener.likelihood
            whole = seen.whitened_displacement(region_displacements(seen.pilot))
            basis = np.linalg.qr(fits.slopes[row])[0]
            found.append(Displaced(int(row), seen, whole - (whole @ basis) @ basis.T))
    return found
