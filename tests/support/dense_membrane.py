"""Posterior of the manufactured membrane by a dense tensor quadrature: term by term, without the code of the engine."""

import numpy as np
from membrane_model import RANGES, STIFFER

CENTRES = 160, 220  # of cells of log Ca and of a/l
AREA_CENTRES, HARDENING_CENTRES, INFLATION_CENTRES = 60, 40, 40


class DenseMembrane:
    """Sums of weights over (Ca of the plain model, a/l, K, h); the other two coordinates are independent of these.

    The prior of G_s is log-uniform and that of a uniform, so that the density is flat over log Ca and a/l; the domain
    lies in the Ca that the plain model has after the inflation, whose prior is left as it is.
    """

    def __init__(self, model, capsule, area_shares=(0.0, 1.0)):
        (low, high), (small, large) = model.surrogate.domain.bounds
        log_ca, size = (
            first + (last - first) * (np.arange(count) + 0.5) / count
            for count, (first, last) in zip(CENTRES, (np.log([low, high]), (small, large)), strict=True)
        )
        log_ca, size = (grid.ravel() for grid in np.meshgrid(log_ca, size, indexing="ij"))
        plain = model.surrogate({"capillary_number": np.exp(log_ca), "size_ratio": size})
        inside = plain.inside
        self.log_ca, self.size, self.ratio = log_ca[inside], size[inside], plain.velocity_ratio[inside]
        lengths, errors = plain.values[inside, :2], plain.covariance[inside, :2, :2] + capsule.covariance
        inverse, volume = np.linalg.inv(errors), np.linalg.det(errors)
        ends = np.log(RANGES["area_dilation_modulus"][:2])
        shares = area_shares[0] + np.diff(area_shares) * (np.arange(AREA_CENTRES) + 0.5) / AREA_CENTRES
        self.area = np.exp(ends[0] + np.diff(ends) * shares)
        self.hardening = (np.arange(HARDENING_CENTRES) + 0.5) / HARDENING_CENTRES
        # all weights together would be half a gigabyte: these are their sums
        self.of_node, self.of_membrane = np.zeros(len(self.size)), np.empty((AREA_CENTRES, HARDENING_CENTRES))
        self.mean_of_membrane = np.empty_like(self.of_membrane)  # of ln(Ca v_o/U)
        for place, area in enumerate(self.area):
            shorter = model.shorter * np.log(area / RANGES["area_dilation_modulus"].null_value)
            z = (capsule.axial_extent - lengths[:, 0] + shorter)[:, None]
            a = capsule.axial_length - lengths[:, 1, None] - model.shallower * self.hardening
            square = (
                inverse[:, 0, 0, None] * z**2 + inverse[:, 1, 1, None] * a**2 + 2.0 * inverse[:, 0, 1, None] * z * a
            )
            weights = np.exp(-0.5 * square) / np.sqrt(volume)[:, None]
            self.of_node += weights.sum(axis=1)
            self.of_membrane[place] = weights.sum(axis=0)
            sums = (self.log_ca + np.log(self.ratio)) @ weights
            self.mean_of_membrane[place] = sums / np.maximum(self.of_membrane[place], np.finfo(float).tiny)
        self.of_node /= self.of_node.sum()
        self.of_membrane /= self.of_membrane.sum()

    def of_nodes(self, values):
        """Mean and standard deviation of a function of the nodes."""
        mean = self.of_node @ values
        return mean, np.sqrt(self.of_node @ (values - mean) ** 2)

    def log_modulus_sd(self, relative_errors):
        """Standard deviation of ln G_s: of shape, inflation and the relative errors of the inputs, all independent."""
        inflation = RANGES["pre_inflation"].high * (np.arange(INFLATION_CENTRES) + 0.5) / INFLATION_CENTRES
        parts = [self.of_nodes(self.log_ca + np.log(self.ratio))[1], np.std(np.log(1.0 + STIFFER * inflation))]
        return float(np.sqrt(np.sum(np.square([*parts, *relative_errors]))))

    def ends_68(self, name):
        """The 68 % interval of K or of h."""
        axis, centres = (1, np.log(self.area)) if name == "area_dilation_modulus" else (0, self.hardening)
        masses, step = self.of_membrane.sum(axis=axis), np.diff(centres[:2])[0]
        edges = np.append(centres - 0.5 * step, centres[-1] + 0.5 * step)
        ends = np.interp([0.16, 0.84], np.append(0.0, np.cumsum(masses)), edges)
        return np.exp(ends) if name == "area_dilation_modulus" else ends
