"""The posterior density with every uncertain input as a coordinate, term by term: what `LogDensity` integrates."""

import numpy as np

from capsbayes.infer.sampling import LogDensity

INPUTS = ("viscosity", "half_width", "capsule_velocity")


class DensityOfAllInputs(LogDensity):
    """Slower than `LogDensity`, and written with `log_prior` without the factoring of `PosteriorDensity`."""

    def _sampled(self):
        return tuple(name for name in INPUTS if not getattr(self.density.inputs, name).known)

    def _of_points(self, points, log_ca, theta):
        inputs, count = self.density.inputs, len(points.extent)
        full = {name: theta.get(name, np.full(count, getattr(inputs, name).value)) for name in INPUTS} | theta
        log_density = self.density.likelihood.log_density(points, full["half_width"])
        log_density = log_density + log_prior(self.density.prior, full, points.velocity_ratio)
        return log_density + sum(getattr(inputs, name).logpdf(theta[name]) for name in self.sampled)


def log_prior(prior, theta, velocity_ratio):
    """Log prior density in (log Ca, a/l, v_o) at given viscosity and half width, term by term : (n,) array."""
    log_velocity = np.log(theta["capsule_velocity"] / velocity_ratio)
    log_modulus = np.log(theta["viscosity"]) + log_velocity - np.log(theta["capillary_number"])
    return (
        prior.surface_shear_modulus.logpdf(np.exp(log_modulus))
        + log_modulus  # from G_s to log G_s
        + prior.capsule_radius.logpdf(theta["size_ratio"] * theta["half_width"])
        + log_jacobian(half_width=theta["half_width"], capsule_velocity=theta["capsule_velocity"])
    )


def log_jacobian(*, half_width, capsule_velocity):
    """Log of |d(log G_s, a, log U) / d(log Ca, a/l, v_o)|, as the text of `capsbayes.infer.prior` derives it."""
    return np.log(half_width / capsule_velocity)
