"""Coordinates in which a posterior over several coordinates is nearly normal: those that importance sampling draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from capsbayes.arrays import Floats
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid.lattice import Nodes
from capsbayes.infer.importance.proposal import PLACE
from capsbayes.infer.prior import Coordinate
from capsbayes.model import Domain, ForwardModel
from capsbayes.quantity import Quantity


@dataclass(frozen=True, eq=False)
class Frame:
    """Points (log Ca, a/l, the normal score of each further coordinate under its prior, and l in standard errors).

    A coordinate that the data tell nothing of is standard normal then, and one whose range the data end at is not cut.

    Parameters
    ----------
    domain : Domain
        Of the model.
    coordinates : tuple of Coordinate
    half_width : Quantity or None
        Where it is a dimension, as the lengths are in metres.
    """

    domain: Domain
    coordinates: tuple[Coordinate, ...]
    half_width: Quantity | None

    @property
    def dimensions(self) -> int:
        """Number of columns of a point."""
        return PLACE + len(self.coordinates) + (self.half_width is not None)

    def column(self, name: str) -> int:
        """Return the column of a further coordinate."""
        return PLACE + [coordinate.name for coordinate in self.coordinates].index(name)

    def of_prior(self, uniform: Floats) -> Floats:
        """Return points (n, d) of the unit cube (n, d) as draws of the priors, uniform in the box about the domain."""
        points = np.empty_like(uniform)
        low, high = self._box
        points[:, :PLACE] = low + (high - low) * uniform[:, :PLACE]
        points[:, PLACE:] = ndtri(uniform[:, PLACE:])
        if self.half_width is not None:
            known = self.half_width
            points[:, -1] = (known.ppf(uniform[:, -1]) - known.value) / known.error
        return points

    def theta(self, points: Floats) -> dict[str, Floats]:
        """Return the quantities at points (n, d), by name : (n,) arrays."""
        theta = {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
        for number, coordinate in enumerate(self.coordinates):
            theta[coordinate.name] = coordinate.values(ndtr(points[:, PLACE + number]))
        if self.half_width is not None:
            theta["half_width"] = self.half_width.value + self.half_width.error * points[:, -1]
        return theta

    def log_prior(self, points: Floats) -> Floats:
        """Return the log density of the coordinates' normal scores : (n,) array."""
        scores = points[:, PLACE : PLACE + len(self.coordinates)]
        return np.asarray(-0.5 * np.sum(scores**2 + np.log(2.0 * np.pi), axis=1))

    def log_of_prior(self, points: Floats) -> Floats:
        """Return the log density of `of_prior` where the half width is no dimension : (n,) array, -inf off the box."""
        low, high = self._box
        within = np.all((points[:, :PLACE] >= low) & (points[:, :PLACE] <= high), axis=1)
        return np.where(within, self.log_prior(points) - np.sum(np.log(high - low)), -np.inf)

    def evaluated(self, model: ForwardModel, density: PosteriorDensity, points: Floats) -> tuple[Nodes, Floats]:
        """Evaluate a model at points (n, d), and the log of the posterior density there : (n,) array, see below."""
        theta = self.theta(points)
        further = {coordinate.name: theta[coordinate.name] for coordinate in self.coordinates}
        there = density.evaluated(model, theta["capillary_number"], theta["size_ratio"], further)
        nodes = Nodes(points[:, 0], points[:, 1], np.ones(len(points)), there)
        return nodes, self.log_density(density, points, nodes, theta.get("half_width"))

    def log_density(
        self, density: PosteriorDensity, points: Floats, nodes: Nodes, width: Floats | None = None
    ) -> Floats:
        """Return the log of the posterior density at points (n, d) : (n,) array, -inf where it vanishes.

        The half width (n,) is given where it is a dimension.
        """
        possible = np.isfinite(nodes.model.extent)
        if width is not None:
            possible &= width > 0.0
            width = width[possible]
        logs = np.full(len(points), -np.inf)
        if possible.any():
            there = nodes.taken(possible)
            found = density.log_of_nodes(there.model, there.log_ca, there.size, width)
            logs[possible] = np.where(np.isnan(found), -np.inf, found + self.log_prior(points[possible]))
        return logs

    @property
    def _box(self) -> tuple[Floats, Floats]:
        (ca_low, ca_high), (size_low, size_high) = self.domain.bounds
        return np.array([np.log(ca_low), size_low]), np.array([np.log(ca_high), size_high])
