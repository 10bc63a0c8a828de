"""Posterior of one capsule at weighted points, and the distributions of all quantities that follow from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from capsbayes.arrays import Floats, Integers
from capsbayes.infer.checks import Gate
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.grid.lattice import Nodes
from capsbayes.infer.grid.posterior import NodePosterior
from capsbayes.infer.importance.frame import Frame
from capsbayes.infer.importance.proposal import PLACE, Polynomial, Proposal
from capsbayes.infer.importance.weights import rows_by_weight
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.prior import THICKNESS
from capsbayes.model import ForwardModel
from capsbayes.status import Status


@dataclass(frozen=True, eq=False)
class WeightedPosterior(NodePosterior):
    """Posterior of one capsule over (log Ca, a/l) and several further coordinates.

    Parameters
    ----------
    forward : ForwardModel
    density : PosteriorDensity
        With the coordinates.
    frame : Frame
    proposal : Proposal
        What the points were drawn from.
    points : (n, d) array
        In the frame, of finite density.
    log_density : (n,) array
        Of the posterior in the frame, up to a constant.
    weights : (n,) array
        Probability of each point.
    nodes : Nodes
        The model there.
    gates : tuple of Gate
        On the weights.
    """

    forward: ForwardModel
    density: PosteriorDensity
    frame: Frame
    proposal: Proposal
    points: Floats
    log_density: Floats
    weights: Floats
    nodes: Nodes
    gates: tuple[Gate, ...]
    unresolved: ClassVar[Status] = Status.TOO_FEW_DRAWS

    @property
    def likeliest(self) -> dict[str, float]:
        """The point of largest density, each coordinate measured by its prior: its names and values."""
        best = int(np.argmax(self.log_density))
        return {name: float(values[best]) for name, values in self._theta.items() if name in self.forward.names}

    @cached_property
    def middle(self) -> dict[str, float]:
        """The one of the points that is nearest to their mean along the sheet, as `likeliest`."""
        there = self.frame.theta(self.proposal.middle(self.points, self.weights)[None])
        return {name: float(values[0]) for name, values in there.items() if name in self.forward.names}

    @cached_property
    def cut(self) -> bool:
        """See `NodePosterior`."""
        if self.density.prior.is_general:
            return True
        place = self.nodes.model, self.nodes.log_ca, self.nodes.size, self._theta.get("half_width")
        return bool(np.min(self.density.log_share(*place)) < -1e-6)

    def marginal(self, name: str) -> Marginal:
        """See `ExactPosterior`."""
        return self._summary(self._theta[name]) if name in self._own else super().marginal(name)

    def log_marginal(self, name: str) -> Marginal:
        """See `ExactPosterior`; of a coordinate, which may vanish, the summary of itself."""
        if name in self._coordinates:
            return self._summary(self._theta[name])
        return self._summary(np.log(self._theta[name])) if name in self._own else super().log_marginal(name)

    def probability_below(self, name: str, value: float) -> float:
        """See `ExactPosterior`."""
        if name in self._own:
            return float(self.weights @ (self._theta[name] <= value))
        return super().probability_below(name, value)

    def drawn(self, rng: np.random.Generator, count: int) -> dict[str, Floats]:
        """See `ExactPosterior`; a point comes as often as its weight says, give or take one."""
        rows = self.resampled(rng, count)
        names = ("capillary_number", "size_ratio", *self._coordinates)
        width = ("half_width",) if "half_width" in self._theta else ()
        nodes = {name: self._theta[name][rows] for name in (*names, *width)}
        return self.density.completed(rng, nodes, self.nodes.model.taken(rows))

    def resampled(self, rng: np.random.Generator, count: int) -> Integers:
        """Return rows of the points, in random order, as often as their weights say : (count,) array."""
        return np.asarray(rng.permutation(rows_by_weight(self.weights, rng, count)))

    def variance_of_mean(self, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the shapes and membranes."""
        logs = self._mean_logs[name]
        return float(self.weights @ (logs - self.weights @ logs) ** 2)

    def variance_given(self, coordinate: str, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the values of a coordinate.

        The mean at given value is a cubic polynomial of its normal score under the prior, by least squares. One of a
        known thickness adds none.
        """
        if coordinate not in self.frame.columns:
            return 0.0
        logs = self._mean_logs[name]
        column = self.points[:, self.frame.column(coordinate)]
        away = column - self.weights @ column
        away /= np.sqrt(self.weights @ away**2)
        root = np.sqrt(self.weights)
        basis = np.stack([np.ones(len(away)), away, away**2, away**3], axis=1)
        fit = basis @ np.linalg.lstsq(root[:, None] * basis, root * logs, rcond=None)[0]
        return float(self.weights @ (fit - self.weights @ fit) ** 2)

    def variance_given_all(self, name: str) -> float:
        """Return the variance of the mean of the logarithm of a quantity over the values of all coordinates together.

        The mean is a cubic polynomial of their normal scores, as in `variance_given`.
        """
        scores = self.points[:, PLACE : PLACE + len(self.frame.columns)]
        fit = Polynomial.fitted(scores, self._mean_logs[name], self.weights)(scores)
        return float(self.weights @ (fit - self.weights @ fit) ** 2)

    @property
    def _coordinates(self) -> tuple[str, ...]:
        return tuple(coordinate.name for coordinate in self.density.coordinates)

    @property
    def _own(self) -> tuple[str, ...]:
        return (*self._coordinates, THICKNESS) if self.density.by_thickness else self._coordinates

    @cached_property
    def _theta(self) -> Mapping[str, Floats]:
        return self.frame.theta(self.points)

    @cached_property
    def _mean_logs(self) -> dict[str, Floats]:
        """Means of log G_s and log a at each point, up to a constant : (n,) arrays."""
        width = self._theta.get("half_width")
        radius = np.log(self.nodes.size) + (0.0 if width is None else np.log(width))
        ratio = 0.0 if self.density.inputs.by_flow_rate else self._ratio[0]
        return {"surface_shear_modulus": -self.nodes.log_ca - ratio, "capsule_radius": radius}

    @property
    def kept(self) -> tuple[Floats, Nodes, Floats | None]:
        """See `NodePosterior`."""
        return self.weights, self.nodes, self._theta.get("half_width")

    @property
    def _spacing(self) -> tuple[float, float, float]:
        return 0.0, 0.0, 0.0

    def _summary(self, values: Floats) -> Marginal:
        order = np.argsort(values)
        middles = np.cumsum(self.weights[order]) - 0.5 * self.weights[order]
        mean = float(self.weights @ values)
        sd = float(np.sqrt(self.weights @ (values - mean) ** 2))
        return Marginal(mean, sd, *np.interp(Marginal.LEVELS, middles, values[order]).tolist())
