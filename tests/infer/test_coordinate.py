from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.infer.coordinate import Coordinate
from capsbayes.infer.prior import Prior, coordinate_prior
from capsbayes.model import CoordinateRange

MODEL = SimpleNamespace(name="square with pre_inflation", coordinates={"pre_inflation": CoordinateRange(0.0, 0.1, 0.0)})


def of(distribution):
    return Coordinate.of(MODEL, Prior(coordinates={"pre_inflation": distribution}))


def test_a_model_without_a_coordinate_has_none_and_takes_no_prior_of_one(model):
    assert Coordinate.of(model, Prior()) is None
    with pytest.raises(InputError, match="bending: expected a coordinate of manufactured polynomial, got a model"):
        Coordinate.of(model, Prior(coordinates={"bending": stats.uniform(0.0, 1.0)}))
    with pytest.raises(InputError, match=r"prior: bending: .* got a model of \(Ca, a/l, pre_inflation\)"):
        Coordinate.of(MODEL, Prior(coordinates={"bending": stats.uniform(0.0, 1.0)}))


def test_the_default_is_uniform_over_the_range_of_the_model():
    one = Coordinate.of(MODEL, Prior())
    np.testing.assert_allclose(one.values([0.0, 0.3, 1.0]), [0.0, 0.03, 0.1])
    np.testing.assert_allclose(np.exp(one.log_density([0.0, 0.05, 0.1])), 10.0)


@pytest.mark.parametrize("distribution", [stats.norm(0.02, 0.015), stats.uniform(0.0, 0.06), stats.expon(scale=0.02)])
def test_a_distribution_is_cut_to_the_range_and_normalised(distribution):
    one = of(distribution)
    grid = np.linspace(0.0, 0.1, 20_001)
    density = np.exp(one.log_density(grid))
    assert np.trapezoid(density, grid) == pytest.approx(1.0, rel=1e-3)
    assert np.all(np.isneginf(one.log_density([-1e-9, 0.1001, np.nan])))
    for share in (0.1, 0.5, 0.9):
        value = float(one.values(share))
        assert np.trapezoid(density[grid <= value], grid[grid <= value]) == pytest.approx(share, abs=2e-3)


def test_a_prior_far_beyond_the_model_is_refused():
    with pytest.raises(InputError, match=r"expected a distribution within .* 0 to 0\.1, got one with 50%"):
        of(stats.uniform(0.0, 0.2))
    with pytest.raises(InputError, match="0% of its mass"):
        of(stats.norm(0.5, 0.01))


@pytest.mark.parametrize(
    ("text", "median", "spread"),
    [
        ("0 .. 0.1", 0.05, 0.1 / np.sqrt(12.0)),
        ("0..0.1", 0.05, 0.1 / np.sqrt(12.0)),
        ("1e-5..3e-3", 1.505e-3, 2.99e-3 / np.sqrt(12.0)),
        ("0.03 +/- 0.01", 0.03, 0.01),
        ("1.00±.02", 1.0, 0.02),
    ],
)
def test_a_prior_in_text_form(text, median, spread):
    one = coordinate_prior(text, where="prior", key="bending")
    assert (one.ppf(0.5), one.sd) == pytest.approx((median, spread))


@pytest.mark.parametrize("text", ["", "0.03", "0.1..0", "0.03 +/- 0", "0 to 0.1", "0 .. much", 0.03])
def test_a_text_that_is_none_is_refused(text):
    with pytest.raises(InputError, match=r'capsule\.toml: prior: bending: expected a range as "0 \.\. 0\.1" or'):
        Prior().with_coordinates({"bending": text}, where="capsule.toml: prior")


def test_priors_of_coordinates_are_read_from_the_file_of_the_capsule(tmp_path):
    path = tmp_path / "capsule.toml"
    path.write_text('[prior]\npre_inflation = "0.02 +/- 0.01"\n')
    prior = Prior.read(path)
    assert prior.coordinates["pre_inflation"].mean == pytest.approx(0.02)
    assert prior.with_coordinates({"pre_inflation": "0..0.05"}).coordinates["pre_inflation"].mean == 0.025
    path.write_text('[prior]\npre_inflaton = "0.02 +/- 0.01"\n')
    with pytest.raises(InputError, match=r"prior\.pre_inflaton: expected one of .*pre_inflation.* an unknown key"):
        Prior.read(path)
