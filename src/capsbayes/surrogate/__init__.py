"""Surrogates: databases of steady shapes as fast forward models, and the inverse procedure of the paper."""

from capsbayes.surrogate.corrected_membrane import CorrectedMembrane
from capsbayes.surrogate.diffuse import DiffuseApproximation
from capsbayes.surrogate.domain import DomainOfExistence
from capsbayes.surrogate.inverse import Inverse, InverseResult, inverse
from capsbayes.surrogate.joint.surrogate import EffectSurrogate
from capsbayes.surrogate.membrane.surrogate import MembraneSurrogate
from capsbayes.surrogate.surrogate import Surrogate, model_named

__all__ = [
    "CorrectedMembrane",
    "DiffuseApproximation",
    "DomainOfExistence",
    "EffectSurrogate",
    "Inverse",
    "InverseResult",
    "MembraneSurrogate",
    "Surrogate",
    "inverse",
    "model_named",
]
