"""The engine whose posterior needs no chains: by the number of further coordinates of the model."""

from __future__ import annotations

import functools
from collections.abc import Callable

from capsbayes.experiment import Experiment
from capsbayes.infer.grid.mixed import MixedQuadrature
from capsbayes.infer.grid.posterior import ExactPosterior
from capsbayes.infer.grid.quadrature import Quadrature
from capsbayes.infer.importance.engine import ImportanceSampling
from capsbayes.infer.importance.posterior import WeightedPosterior
from capsbayes.infer.prior import THICKNESS, Prior
from capsbayes.model import ForwardModel

ExactEngine = Quadrature | MixedQuadrature | ImportanceSampling


def exact_engine(
    model: ForwardModel, experiment: Experiment, prior: Prior | None = None, *, outline: bool = False
) -> ExactEngine:
    """Return a `Quadrature`, for a model with one further coordinate a mixture, with several `ImportanceSampling`.

    The last is also for measurements with an outline and one coordinate: an outline is worth so much that a mixture
    needs a hundred cells, each with a grid of its own. And a thickness of the membrane ties a coordinate to the radius,
    which only the last can do.
    """
    prior = (prior or Prior()).with_thickness(experiment)
    kinds = Quadrature, ImportanceSampling if outline else MixedQuadrature, ImportanceSampling
    return kinds[2 if THICKNESS in prior.coordinates else min(len(model.coordinates), 2)](model, experiment, prior)


def engine_near(engine: ExactEngine, posterior: ExactPosterior) -> Callable[..., ExactPosterior]:
    """Return the engine for a measurement nearly that of a posterior, from whose draws it begins if it draws."""
    if isinstance(engine, ImportanceSampling) and isinstance(posterior, WeightedPosterior):
        return functools.partial(engine, near=posterior)
    return engine
