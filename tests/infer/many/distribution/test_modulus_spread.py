import numpy as np
import pytest
import xarray as xr
from scipy.stats import norm, t

from capsbayes.errors import InputError
from capsbayes.infer.hierarchy import ModulusSpread
from capsbayes.infer.population import Population


def test_numbers_are_a_normal_distribution_without_a_band():
    modulus = np.geomspace(0.02, 0.1, 7)
    middle, low, high = ModulusSpread(np.log(0.05), 0.2).density(modulus)
    np.testing.assert_allclose(middle, norm(np.log(0.05), 0.2).pdf(np.log(modulus)))
    np.testing.assert_array_equal(low, high)


def test_draws_have_a_band_that_holds_95_in_100():
    rng = np.random.default_rng(1)
    spread = ModulusSpread(rng.normal(np.log(0.05), 0.1, 4000), np.full(4000, 0.2))
    np.testing.assert_allclose(np.log(spread.median / 0.05), [0.0, -0.196, 0.196], atol=0.01)
    middle, low, high = spread.density(np.array([0.04]))
    assert low[0] < middle[0] < high[0]
    np.testing.assert_allclose(spread.relative, 0.2)


def test_heavy_tails_are_those_of_the_t_distributions_fitted():
    """Of a slope of zero, ln G_s has a t distribution."""
    freedom, scale, ones = 4.0, 0.1, np.ones(1)
    width = scale * t.ppf(norm.cdf(1.0), freedom)
    draws = {"surface_shear_modulus": 0.05, "modulus_spread": width, "modulus_spread_at_given_size": width}
    draws |= {"radius_spread": 0.1, "modulus_slope": 0.0, "modulus_freedom": freedom, "radius_freedom": 4.0}
    stored = xr.Dataset({f"population_{name}": ("draw", value * ones) for name, value in draws.items()})
    spread = ModulusSpread.of_population(Population(stored))
    off = scale * np.array([0.0, 1.0, 3.0, 5.0])
    expected = t(freedom, scale=scale).pdf(off)
    np.testing.assert_allclose(spread.density(0.05 * np.exp(off))[0], expected, rtol=0.1)
    assert np.all(norm(0.0, width).pdf(off[2:]) < 0.8 * expected[2:])


@pytest.mark.parametrize(("mean", "sd"), [([0.0, 1.0], [0.1]), (np.nan, 0.1), (0.0, 0.0), ([[0.0]], [[0.1]])])
def test_what_is_no_distribution_is_refused(mean, sd):
    with pytest.raises(InputError, match="ModulusSpread: mean, sd: expected"):
        ModulusSpread(mean, sd)
