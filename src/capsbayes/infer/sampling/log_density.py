"""Log posterior density of a batch of parameter vectors, which the walkers sample."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from capsbayes.infer.density import PosteriorDensity
from capsbayes.model import ForwardModel

__all__ = ["LogDensity"]

Floats = NDArray[np.float64]

_INPUTS = ("viscosity", "half_width", "capsule_velocity")


class LogDensity:
    """Log posterior density over (log Ca, a/l), the model's further coordinate, and the inputs sampled with them.

    Only the inputs that the shape depends on are sampled by default; the
    others are integrated out exactly and drawn afterwards. With
    `sample_inputs` every uncertain input is a coordinate and the density is
    written with the prior of `capsbayes.infer.prior` term by term: slower,
    and a check of the former.

    Parameters
    ----------
    model : ForwardModel
    density : PosteriorDensity
    sample_inputs : bool

    Attributes
    ----------
    names : tuple of str
        Coordinates; the first is the logarithm of the capillary number.
    sampled : tuple of str
        Those of them that are inputs.
    not_a_number : int
        Points inside the model's domain whose density came out NaN; they count as impossible.
    """

    def __init__(self, model: ForwardModel, density: PosteriorDensity, *, sample_inputs: bool = False) -> None:
        self.model, self.density, self.sample_inputs = model, density, sample_inputs
        sampled = [name for name in _INPUTS if sample_inputs and not getattr(density.inputs, name).known]
        if not sample_inputs and density.shape_depends_on_half_width:
            sampled = ["half_width"]
        self.sampled = tuple(sampled)
        further = () if density.coordinate is None else (density.coordinate.name,)
        self.names = ("capillary_number", "size_ratio", *further, *sampled)
        self.not_a_number = 0

    def __call__(self, coordinates: Floats) -> Floats:
        """Return the log density : (n, d) -> (n,) array, -inf where the density vanishes or is not a number."""
        theta = self.named(coordinates)
        impossible = np.zeros(len(coordinates), dtype=bool)
        for name in self.sampled:
            impossible |= theta[name] <= 0.0
            theta[name] = np.where(impossible, getattr(self.density.inputs, name).value, theta[name])
        further = {name: theta[name] for name in self.names[2 : len(self.names) - len(self.sampled)]}
        place = theta["capillary_number"], theta["size_ratio"]
        points, _ = self.density.evaluated(self.model, *place, further)
        outside = np.isnan(points.extent)
        density = self._all(theta, points) if self.sample_inputs else self._integrated(theta, points, coordinates)
        if self.density.coordinate is not None:
            density = density + self.density.coordinate.log_density(theta[self.density.coordinate.name])
        wrong = np.isnan(density)
        if wrong.any():
            inside = self.model.domain.contains(*place, *further.values())
            self.not_a_number += int(np.count_nonzero(wrong & inside))
        return np.where(wrong | outside | impossible, -np.inf, density)

    def named(self, coordinates: Floats) -> dict[str, Floats]:
        """Return the coordinates (n, d) by name, Ca itself in place of its logarithm."""
        theta = dict(zip(self.names, coordinates.T, strict=True))
        theta["capillary_number"] = np.exp(theta["capillary_number"])
        return theta

    def _integrated(self, theta: dict[str, Floats], points, coordinates: Floats) -> Floats:  # type: ignore[no-untyped-def]
        posterior, width = self.density, theta.get("half_width")
        place = (points, coordinates[:, 0], theta["size_ratio"], width)
        density = posterior.log_density(*place) + posterior.log_share(*place)
        if width is not None:
            power = posterior.prior.capsule_radius.power
            density = density + posterior.inputs.half_width.logpdf(width) + power * np.log(width)
        return density

    def _all(self, theta: dict[str, Floats], points) -> Floats:  # type: ignore[no-untyped-def]
        inputs, count = self.density.inputs, len(points.extent)
        full = {name: theta.get(name, np.full(count, getattr(inputs, name).value)) for name in _INPUTS} | theta
        density = self.density.likelihood.log_density(points, full["half_width"])
        density = density + self.density.prior.log_density(full, points.velocity_ratio)
        for name in self.sampled:
            density = density + getattr(inputs, name).logpdf(theta[name])
        return density
