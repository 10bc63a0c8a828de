"""Inference: from a measurement to the posterior of the shear modulus and the radius, by two engines."""

from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.identify import ENGINES, identify
from capsbayes.infer.marginal import Marginal
from capsbayes.infer.membrane import Membrane
from capsbayes.infer.posterior import Posterior
from capsbayes.infer.prior import Prior

__all__ = ["ENGINES", "Marginal", "Membrane", "Posterior", "Prior", "Quadrature", "identify"]
