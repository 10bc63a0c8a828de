"""The sampling engine for several further coordinates: walkers relative to the sheet on which the posterior lies.

There the posterior is nearly a mixture of normal distributions, and walkers may also jump to draws of a mixture.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.importance.posterior import WeightedPosterior
from capsbayes.infer.sampling.ensembles import Moves
from capsbayes.infer.sampling.log_density import LogDensity

_JUMPS, _DIFFERENCES, _STRETCHES = 0.45, 0.4, 0.15  # shares of the moves
_CLOUD = 4096


class SheetDensity(LogDensity):
    """Log posterior density relative to the sheet of a weighted posterior, each coordinate by its normal score.

    Parameters
    ----------
    posterior : WeightedPosterior
    """

    def __init__(self, posterior: WeightedPosterior) -> None:
        super().__init__(posterior.forward, posterior.density)
        self.posterior = posterior

    def __call__(self, coordinates: Floats) -> Floats:
        """Return the log density : (n, d) -> (n,) array, -inf where the density vanishes or is not a number."""
        points = self.posterior.proposal.sheet.raised(coordinates)
        return self.posterior.frame.evaluated(self.model, self.density, points)[1]

    def unfolded(self, coordinates: Floats) -> Floats:
        """Return log Ca, a/l, the further coordinates and l of points (..., d) relative to the sheet."""
        flat = coordinates.reshape(-1, coordinates.shape[-1])
        theta = self.posterior.frame.theta(self.posterior.proposal.sheet.raised(flat))
        theta["capillary_number"] = np.log(theta["capillary_number"])
        return np.stack([theta[name] for name in self.names], axis=1).reshape(coordinates.shape)

    def beginning(self, seed: int) -> dict[str, Any]:
        """Return the moves of the walkers, and draws of the weighted posterior about which they start."""
        rows = self.posterior.resampled(np.random.default_rng([seed, 2]), _CLOUD)
        cloud = self.posterior.proposal.sheet.flattened(self.posterior.points[rows])
        return {"cloud": cloud, "moves": self._moves()}

    def _moves(self) -> Moves:
        """Return jumps to draws of the mixture, which differential evolution and stretches go on from."""
        import emcee

        proposal = self.posterior.proposal

        def jump(walkers: Floats, random: np.random.RandomState) -> tuple[Floats, Floats]:
            there = proposal.drawn_flat(random.uniform(size=(len(walkers), walkers.shape[1] + 2)))
            return there, proposal.log_density_flat(walkers) - proposal.log_density_flat(there)

        return (
            (emcee.moves.MHMove(jump), _JUMPS),
            (emcee.moves.DEMove(), _DIFFERENCES),
            (emcee.moves.StretchMove(), _STRETCHES),
        )
