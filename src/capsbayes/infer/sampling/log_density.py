"""Log posterior density of a batch of parameter vectors, which the walkers sample."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.likelihood import ModelAtPoints
from capsbayes.model import ForwardModel


class LogDensity:
    """Log posterior density over (log Ca, a/l), the further coordinates of the model, and l if the shape depends on it.

    The inputs that the shape does not depend on are integrated out exactly and drawn afterwards.

    Parameters
    ----------
    model : ForwardModel
    density : PosteriorDensity

    Attributes
    ----------
    names : tuple of str
        Coordinates; the first is the logarithm of the capillary number.
    sampled : tuple of str
        Those of them that are inputs.
    not_a_number : int
        Points inside the model's domain whose density came out NaN; they count as impossible.
    """

    def __init__(self, model: ForwardModel, density: PosteriorDensity) -> None:
        self.model, self.density = model, density
        self.sampled = self._sampled()
        further = tuple(coordinate.name for coordinate in density.coordinates)
        self.names = ("capillary_number", "size_ratio", *further, *self.sampled)
        self.not_a_number = 0

    def __call__(self, coordinates: Floats) -> Floats:
        """Return the log density : (n, d) -> (n,) array, -inf where the density vanishes or is not a number."""
        theta = self.named(coordinates)
        impossible = np.zeros(len(coordinates), dtype=bool)
        for name in self.sampled:
            impossible |= theta[name] <= 0.0
            theta[name] = np.where(impossible, getattr(self.density.inputs, name).value, theta[name])
        further = {coordinate.name: theta[coordinate.name] for coordinate in self.density.coordinates}
        place = theta["capillary_number"], theta["size_ratio"]
        points = self.density.evaluated(self.model, *place, further)
        outside = np.isnan(points.extent)
        log_density = self._of_points(points, coordinates[:, 0], theta)
        for coordinate in self.density.coordinates:
            log_density = log_density + coordinate.log_density(theta[coordinate.name])
        wrong = np.isnan(log_density)
        if wrong.any():
            inside = self.model.domain.contains(*place, *further.values())
            self.not_a_number += int(np.count_nonzero(wrong & inside))
        return np.where(wrong | outside | impossible, -np.inf, log_density)

    def named(self, coordinates: Floats) -> dict[str, Floats]:
        """Return the coordinates (n, d) by name, Ca itself in place of its logarithm."""
        theta = dict(zip(self.names, coordinates.T, strict=True))
        theta["capillary_number"] = np.exp(theta["capillary_number"])
        return theta

    def unfolded(self, coordinates: Floats) -> Floats:
        """Return the coordinates `names` of points (..., d) in which the walkers move : the same here."""
        return coordinates

    def _sampled(self) -> tuple[str, ...]:
        return ("half_width",) if self.density.shape_depends_on_half_width else ()

    def _of_points(self, points: ModelAtPoints, log_ca: Floats, theta: dict[str, Floats]) -> Floats:
        return self.density.log_of_nodes(points, log_ca, theta["size_ratio"], theta.get("half_width"))
