import numpy as np
import pytest
from scipy.stats import norm

from capsbayes.errors import InputError
from capsbayes.infer.many.distribution.modulus_spread import ModulusSpread


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


@pytest.mark.parametrize(("mean", "sd"), [([0.0, 1.0], [0.1]), (np.nan, 0.1), (0.0, 0.0), ([[0.0]], [[0.1]])])
def test_what_is_no_distribution_is_refused(mean, sd):
    with pytest.raises(InputError, match="ModulusSpread: mean, sd: expected"):
        ModulusSpread(mean, sd)
