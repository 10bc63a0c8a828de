"""Surrogates: databases of steady shapes as fast forward models, and the inverse procedure of the paper."""

from capsbayes.surrogate.corrected_membrane import CorrectedMembrane
from capsbayes.surrogate.diffuse import DiffuseApproximation
from capsbayes.surrogate.effect import EffectSurrogate
from capsbayes.surrogate.inverse import Inverse, InverseResult, inverse
from capsbayes.surrogate.membrane import MembraneSurrogate
from capsbayes.surrogate.open import Surrogate, model_named
from capsbayes.surrogate.plane import DomainOfExistence

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
