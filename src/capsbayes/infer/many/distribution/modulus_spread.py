"""The spread of G_s in a population with the errors removed: a normal distribution of its logarithm, or a t one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer.many.distribution.tails import ScaleMixture, half_width_of
from capsbayes.infer.many.population import Population


@dataclass(frozen=True, eq=False)
class ModulusSpread:
    """Distribution of ln(G_s / (1 N/m)) over the capsules, and how well it is known.

    Parameters
    ----------
    mean : float or (d,) array
        Mean of ln G_s, or draws of its posterior.
    sd : float or (d,) array
        Standard deviation of ln G_s from capsule to capsule, or draws of it, paired with those of the mean; of heavy
        tails, half the width of the central 68.3 %.
    tails : ScaleMixture, optional
        Variances and weights of the normal distributions that make up heavy tails, one row for each draw.

    Raises
    ------
    InputError
        If they are not as many, not finite, or a standard deviation is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> spread = ModulusSpread(mean=np.log(0.05), sd=0.1)
    >>> middle, low, high = spread.density(np.array([0.05]))
    >>> float(middle[0].round(3)), bool(low == high)
    (3.989, True)
    """

    mean: ArrayLike
    sd: ArrayLike
    tails: ScaleMixture | None = None

    def __post_init__(self) -> None:
        mean, sd = (np.atleast_1d(np.asarray(values, dtype=float)) for values in (self.mean, self.sd))
        if mean.ndim != 1 or mean.shape != sd.shape:
            raise InputError("ModulusSpread", "mean, sd", "arrays of one length", f"{mean.shape} and {sd.shape}")
        if not (np.isfinite(mean).all() and np.isfinite(sd).all() and (sd > 0.0).all()):
            raise InputError("ModulusSpread", "mean, sd", "finite numbers, standard deviations above zero", "others")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "sd", sd)

    @classmethod
    def of_population(cls, population: Population) -> ModulusSpread | None:
        """Return the spread that is stored with a population; None if there is none."""
        names = ("population_surface_shear_modulus", "population_modulus_spread")
        if any(name not in population.dataset for name in names):
            return None
        median, sd = (population[name] for name in names)
        return cls(np.log(median), sd, _tails(population))

    def density(self, modulus: ArrayLike) -> tuple[Floats, Floats, Floats]:
        """Return the density of ln G_s at given G_s: median and 95 % band over the draws.

        Parameters
        ----------
        modulus : (n,) array [N/m]

        Returns
        -------
        middle, low, high : (n,) arrays
        """
        off = np.log(modulus) - np.asarray(self.mean)[:, None]
        variances, weights = self.tails or ScaleMixture.normal(len(off)).scaled(np.asarray(self.sd))
        each = np.zeros_like(off)
        for variance, weight in zip(variances.T[:, :, None], weights.T[:, :, None], strict=True):
            each += weight * np.exp(-0.5 * off**2 / variance) / np.sqrt(2.0 * np.pi * variance)
        middle, low, high = np.quantile(each, [0.5, 0.025, 0.975], axis=0)
        return middle, low, high

    @property
    def median(self) -> Floats:
        """Median G_s of the capsules, 50 %, 2.5 % and 97.5 % of its posterior : (3,) array [N/m]."""
        return np.exp(np.quantile(np.asarray(self.mean), [0.5, 0.025, 0.975]))

    @property
    def relative(self) -> Floats:
        """Spread of G_s over its median, 50 %, 2.5 % and 97.5 % of its posterior : (3,) array."""
        return np.quantile(np.asarray(self.sd), [0.5, 0.025, 0.975])


def _tails(population: Population) -> ScaleMixture | None:
    """Return ln G_s as the sum of what the size explains and of the rest, if t distributions were fitted to both."""
    parts = []
    for freedom, spread in (("modulus", "modulus_spread_at_given_size"), ("radius", "radius_spread")):
        if f"population_{freedom}_freedom" not in population.dataset:
            return None
        unit = ScaleMixture.of_freedom(np.log(population[f"population_{freedom}_freedom"]))
        parts.append(unit.scaled(population[f"population_{spread}"] / half_width_of(*unit)))
    return parts[0].plus(parts[1].scaled(population["population_modulus_slope"]))
