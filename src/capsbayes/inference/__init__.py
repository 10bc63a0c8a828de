"""Inference: from a measurement to the posterior of the shear modulus and the radius, by two engines."""

from capsbayes.inference.identify import ENGINES, identify
from capsbayes.inference.marginal import Marginal
from capsbayes.inference.posterior import Posterior
from capsbayes.inference.prior import Prior, Range
from capsbayes.inference.quadrature import Quadrature

__all__ = ["ENGINES", "Marginal", "Posterior", "Prior", "Quadrature", "Range", "identify"]
