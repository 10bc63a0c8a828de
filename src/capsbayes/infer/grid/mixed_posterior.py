"""The posterior of one capsule by a model with a further coordinate: grids at several values, each with its weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from capsbayes.infer.checks import Gate
from capsbayes.infer.coordinate import Coordinate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid.posterior import GridPosterior
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.marginal import Marginal
from capsbayes.model import ForwardModel

__all__ = ["MixedPosterior"]

Floats = NDArray[np.float64]

_DRAWS = 200_000  # where a prior range cuts
_FINE = 64  # points in a cell for the moments of the coordinate


@dataclass(frozen=True, eq=False)
class MixedPosterior:
    """Posterior of one capsule over (log Ca, a/l) and one more coordinate.

    The range of the prior of the coordinate is cut into cells of equal
    probability; in the middle of each the posterior over (log Ca, a/l) is
    known on a grid of its own.

    Parameters
    ----------
    forward : ForwardModel
    density : PosteriorDensity
        With the coordinate.
    shares : (n,) array
        Middles of n cells, as shares of the prior below.
    width : float
        Of a cell.
    parts : sequence of n GridPosterior
    gates : tuple of Gate
    """

    forward: ForwardModel
    density: PosteriorDensity
    shares: Floats
    width: float
    parts: Sequence[GridPosterior]
    gates: tuple[Gate, ...] = ()

    @property
    def coordinate(self) -> Coordinate:
        """The further coordinate and its prior."""
        assert self.density.coordinate is not None
        return self.density.coordinate

    @cached_property
    def weights(self) -> Floats:
        """Posterior probability of each cell : (n,) array."""
        logs = np.array([part.log_evidence for part in self.parts])
        weights = np.exp(logs - logs.max())
        return np.asarray(weights / weights.sum())

    def marginal(self, name: str) -> Marginal:
        """Summary of one quantity, named as in `capsbayes.parameters`."""
        if name == self.coordinate.name:
            return self._of_coordinate
        return (
            self._distribution_of(name).marginal() if self._exact(name) else Marginal.of_draws(self._many_draws[name])
        )

    def log_marginal(self, name: str) -> Marginal:
        """Summary of the logarithm of one quantity; of the coordinate, which may vanish, of itself."""
        if name == self.coordinate.name:
            return self._of_coordinate
        if self._exact(name):
            return self._distribution_of(name).log_marginal()
        return Marginal.of_draws(np.log(self._many_draws[name]))

    def probability_below(self, name: str, value: float) -> float:
        """Posterior probability that a quantity is below a value [SI]: uniform over capsules if value is the truth."""
        if name == self.coordinate.name:
            values, below = self._distribution
            return float(np.interp(value, values, below, left=0.0, right=1.0))
        return float(self.weights @ np.array([part.probability_below(name, value) for part in self.parts]))

    def variance_between(self, name: str) -> float:
        """Variance of the mean of the logarithm of a quantity from cell to cell: what the coordinate owns of it."""
        means = np.array([part.log_marginal(name).mean for part in self.parts])
        return float(self.weights @ (means - self.weights @ means) ** 2)

    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        """Independent draws of all quantities, the coordinate spread within its cells.

        Parameters
        ----------
        rng : Generator
        count : int

        Returns
        -------
        dict of (count,) arrays, SI
        """
        numbers = rng.multinomial(count, self.weights)
        drawn = [part.drawn(rng, number) for part, number in zip(self.parts, numbers, strict=True) if number]
        draws = {name: np.concatenate([one[name] for one in drawn]) for name in drawn[0]}
        shares = np.repeat(self.shares, numbers) + self.width * rng.uniform(-0.5, 0.5, count)
        draws[self.coordinate.name] = self.coordinate.values(shares)
        order = rng.permutation(count)
        return {name: values[order] for name, values in draws.items()}

    def _exact(self, name: str) -> bool:
        return all(part.is_exact(name) for part in self.parts)

    def _distribution_of(self, name: str) -> LogGrid:
        return LogGrid.mixed([part.distribution(name) for part in self.parts], self.weights)

    @cached_property
    def _many_draws(self) -> dict[str, Floats]:
        return self.drawn(np.random.default_rng(0), _DRAWS)

    @cached_property
    def _distribution(self) -> tuple[Floats, Floats]:
        """Values of the coordinate and the posterior probability below each, smooth from edge to edge of the cells."""
        ends = self.shares[:, None] + self.width * np.array([-0.5, 0.5])
        edges = np.unique(ends)
        reached = np.array([self.weights[ends[:, 1] <= edge].sum() for edge in edges])
        shares = np.linspace(edges[0], edges[-1], _FINE * len(self.shares) + 1)
        below = PchipInterpolator(edges, reached / reached[-1])(shares)
        return self.coordinate.values(shares), np.asarray(below)

    @cached_property
    def _of_coordinate(self) -> Marginal:
        values, below = self._distribution
        masses, middles = np.diff(below), (values[1:] + values[:-1]) / 2
        mean = float(masses @ middles)
        sd = float(np.sqrt(masses @ (middles - mean) ** 2))
        return Marginal(mean, sd, *(float(value) for value in np.interp(Marginal.LEVELS, below, values)))
