"""Inference: from a measurement to the posterior of the shear modulus and the radius, by two engines."""

from capsbayes.infer.identify import ENGINES, identify
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.prior import Marginal, Membrane, Prior
from capsbayes.infer.quadrature import Quadrature

__all__ = ["ENGINES", "Marginal", "Membrane", "Posterior", "Prior", "Quadrature", "identify"]
