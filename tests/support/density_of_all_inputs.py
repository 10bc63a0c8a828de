"""The posterior density with every uncertain input as a coordinate, term by term: what `LogDensity` integrates."""

import numpy as np

from capsbayes.infer.sampling.log_density import LogDensity

INPUTS = ("viscosity", "half_width", "capsule_velocity")


class DensityOfAllInputs(LogDensity):
    """Slower than `LogDensity`, and written with `Prior.log_density` without the factoring of `PosteriorDensity`."""

    def _sampled(self):
        return tuple(name for name in INPUTS if not getattr(self.density.inputs, name).known)

    def _of_points(self, points, log_ca, theta):
        inputs, count = self.density.inputs, len(points.extent)
        full = {name: theta.get(name, np.full(count, getattr(inputs, name).value)) for name in INPUTS} | theta
        log_density = self.density.likelihood.log_density(points, full["half_width"])
        log_density = log_density + self.density.prior.log_density(full, points.velocity_ratio)
        return log_density + sum(getattr(inputs, name).logpdf(theta[name]) for name in self.sampled)
