"""Diffuse approximation: the database as a fast forward model, and the paper's inverse beside it."""

from capsbayes.surrogate.diffuse import DiffuseApproximation
from capsbayes.surrogate.domain import DomainOfExistence
from capsbayes.surrogate.inverse import Inverse, InverseResult, inverse
from capsbayes.surrogate.joint.surrogate import EffectSurrogate
from capsbayes.surrogate.surrogate import Surrogate

__all__ = [
    "DiffuseApproximation",
    "DomainOfExistence",
    "EffectSurrogate",
    "Inverse",
    "InverseResult",
    "Surrogate",
    "inverse",
]
