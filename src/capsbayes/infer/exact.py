"""The engine whose posterior needs no chains: by the number of further coordinates of the model."""

from __future__ import annotations

from capsbayes.experiment import Experiment
from capsbayes.infer.grid.mixed import MixedQuadrature
from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.importance.engine import ImportanceSampling
from capsbayes.infer.prior import THICKNESS, Prior
from capsbayes.model import ForwardModel

ExactEngine = Quadrature | MixedQuadrature | ImportanceSampling


def exact_engine(model: ForwardModel, experiment: Experiment, prior: Prior | None = None) -> ExactEngine:
    """Return a `Quadrature`, for a model with one further coordinate a mixture, with several `ImportanceSampling`.

    A thickness of the membrane ties a coordinate to the radius, which only the last can do.
    """
    prior = (prior or Prior()).with_thickness(experiment)
    kinds = Quadrature, MixedQuadrature, ImportanceSampling
    return kinds[2 if THICKNESS in prior.coordinates else min(len(model.coordinates), 2)](model, experiment, prior)
