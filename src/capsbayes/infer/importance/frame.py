"""Coordinates in which a posterior over several coordinates is nearly normal: those that importance sampling draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, bending, membrane_thickness
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid.lattice import Nodes
from capsbayes.infer.importance.proposal import PLACE
from capsbayes.infer.prior import LEAST_COVERED, THICKNESS, Coordinate
from capsbayes.model import Domain, ForwardModel
from capsbayes.parameters import PARAMETERS
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
        Those by a known thickness have no column.
    half_width : Quantity or None
        Where it is a dimension.
    central_width : float [m]
        Where it is none.
    """

    domain: Domain
    coordinates: tuple[Coordinate, ...]
    half_width: Quantity | None
    central_width: float

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the coordinates that have a column, in their order after the place."""
        return tuple(each.name for each in self.coordinates if not each.distribution.known)

    @property
    def dimensions(self) -> int:
        """Number of columns of a point."""
        return PLACE + len(self.columns) + (self.half_width is not None)

    def column(self, name: str) -> int:
        """Return the column of a further coordinate."""
        return PLACE + self.columns.index(name)

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
        if self.half_width is not None:
            theta["half_width"] = self.half_width.value + self.half_width.error * points[:, -1]
        for each in self.coordinates:
            shares = ndtr(points[:, self.column(each.name)]) if each.name in self.columns else np.ones(len(points))
            theta[each.name] = each.values(shares)
            if each.by_thickness:
                theta[THICKNESS] = theta[each.name]
                radius = theta["size_ratio"] * theta.get("half_width", self.central_width)
                theta[each.name] = bending(membrane_thickness=theta[THICKNESS], capsule_radius=radius)
        return theta

    def log_prior(self, points: Floats) -> Floats:
        """Return the log density of the coordinates' normal scores : (n,) array."""
        scores = points[:, PLACE : PLACE + len(self.columns)]
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
        nodes = Nodes(points[:, 0], points[:, 1], np.ones(len(points)), there, np.empty(0, np.int64))
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


def check_thickness(coordinates: tuple[Coordinate, ...], experiment: Experiment, domain: Domain) -> None:
    """Refuse a thickness of the membrane that leaves the range of the bending modulus at every size of the model.

    Raises
    ------
    InputError
    """
    for each in coordinates:
        if not each.by_thickness:
            continue
        sizes = experiment.half_width.value * np.array(domain.bounds[1])
        ends = membrane_thickness(bending=np.array([each.low, each.high]), capsule_radius=sizes)
        stated = each.distribution
        covered = float(ends[0] <= stated.value <= ends[1]) if stated.known else float(np.diff(stated.cdf(ends))[0])
        if covered < LEAST_COVERED:
            low, high = (f"{PARAMETERS[THICKNESS].shown(end):.3g}" for end in ends)
            expected = f"a thickness from {low} to {high} um, which the bending moduli of the model stand for"
            got = f"{stated} ({covered:.0%} of it within)"
            raise InputError(experiment.source or "experiment", THICKNESS, expected, got)
