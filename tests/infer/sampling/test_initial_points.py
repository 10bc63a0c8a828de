from dataclasses import replace

import numpy as np
import pytest
from density_of_all_inputs import DensityOfAllInputs

from capsbayes.infer.density import PosteriorDensity
from capsbayes.infer.prior import Inputs, Prior
from capsbayes.infer.quadrature import Quadrature
from capsbayes.infer.sampling import LogDensity, starting_points


@pytest.mark.parametrize("name", ["capsule", "capsule_in_metres", "capsule_from_the_side"])
@pytest.mark.parametrize("kind", [LogDensity, DensityOfAllInputs])
def test_all_walkers_start_at_finite_density_and_none_twice(model, experiment, name, kind, request):
    seen = request.getfixturevalue(name)
    density = kind(model, PosteriorDensity.of(seen, Inputs.of(seen, experiment), Prior()))
    starts = starting_points(density, 4, 32, np.random.default_rng(18))
    assert starts.shape == (4, 32, len(density.names))
    flat = starts.reshape(128, -1)
    assert np.all(np.isfinite(density(flat)))
    assert len(np.unique(flat, axis=0)) == 128


def test_starts_are_found_around_a_narrow_posterior_and_wider_than_it(model, experiment, capsule):
    seen = replace(capsule, axial_extent_error=1e-3, axial_length_error=1e-3)
    density = PosteriorDensity.of(seen, Inputs.of(seen, experiment), Prior())
    starts = starting_points(LogDensity(model, density), 4, 64, np.random.default_rng(19)).reshape(-1, 2)
    exact = Quadrature(model, experiment)(seen)
    for k, name in enumerate(("capillary_number", "size_ratio")):
        values = np.exp(starts[:, k]) if k == 0 else starts[:, k]
        one = exact.marginal(name)
        assert abs(values.mean() - one.mean) < one.sd
        assert 1.0 < values.std() / one.sd < 4.0


def test_a_density_that_vanishes_everywhere_is_said(model, experiment, capsule):
    density = LogDensity(model, PosteriorDensity.of(capsule, Inputs.of(capsule, experiment), Prior()))
    density.__class__ = type("Nowhere", (LogDensity,), {"__call__": lambda self, x: np.full(len(x), -np.inf)})
    with pytest.raises(ValueError, match="no point of the model's domain"):
        starting_points(density, 4, 32, np.random.default_rng(20))
