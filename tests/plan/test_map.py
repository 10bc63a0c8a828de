import json
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from polynomial_model import PolynomialModel

from capsbayes.errors import InputError
from capsbayes.infer import Prior
from capsbayes.model import CoordinateRange
from capsbayes.plan import identifiability_map
from capsbayes.plan.widths import WidthPredictor, noise_lattice

GRID = (7, 6)
WIDTH = "width_of_surface_shear_modulus"


@pytest.fixture(scope="module")
def found(model, experiment, errors):
    return identifiability_map(model, experiment, errors, grid=GRID, noises=3)


def test_the_map_has_a_width_where_the_model_has_a_shape(found, model):
    ca, size = np.meshgrid(found["capillary_number"], found["size_ratio"])
    inside = model.domain.contains(ca.ravel(), size.ravel()).reshape(ca.shape)
    assert 0 < np.count_nonzero(~inside) < inside.size
    for name in (WIDTH, "width_of_capsule_radius", "noise_free_width", "leaning"):
        np.testing.assert_array_equal(np.isfinite(found[name]), inside, err_msg=name)
    np.testing.assert_allclose(found["highest"], model.domain.limit(found["size_ratio"].to_numpy()), rtol=2e-3)


def test_a_point_of_the_map_is_that_of_the_predictor(found, model, experiment, errors):
    predictor = WidthPredictor(model, experiment, errors, noises=3)
    one = predictor.at(float(found["capillary_number"][4]), float(found["size_ratio"][2]))
    assert float(found[WIDTH][2, 4]) == pytest.approx(one.relative)
    assert float(found["noise_free_width"][2, 4]) == pytest.approx(one.noise_free)


def test_smaller_errors_make_narrower_posteriors(found, model, experiment, errors):
    sharp = replace(errors, axial_extent=0.005, axial_length=0.005)
    better = identifiability_map(model, experiment, sharp, grid=GRID, noises=3)
    ratio = (better[WIDTH] / found[WIDTH]).to_numpy()
    assert np.nanmax(ratio) < 0.9


def test_the_attributes_say_of_which_lab_it_is(found, model, tmp_path):
    assert found.attrs["model_sha256"] == model.sha256
    assert json.loads(found.attrs["errors"])["axial_extent"] == 0.02
    assert json.loads(found.attrs["experiment"])["half_width"]["unit"] == "m"
    assert found[WIDTH].attrs["units"] == "-"
    found.to_netcdf(tmp_path / "map.nc", engine="h5netcdf")


def test_the_lattice_of_noise_integrates_a_polynomial():
    points = noise_lattice(13)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.cov(points.T, bias=True), np.eye(2), atol=1e-12)
    assert np.mean(points[:, 0] ** 2 * points[:, 1] ** 2) == pytest.approx(1.0, abs=0.25)


def test_what_is_no_plane_is_refused(model, experiment, errors):
    with pytest.raises(InputError, match="two points along each axis"):
        identifiability_map(model, experiment, errors, grid=(1, 5))
    with pytest.raises(InputError, match=r"a model of \(Ca, a/l\), got one of pre_inflation too; fix it"):
        identifiability_map(_Inflated(), experiment, errors)
    with pytest.raises(InputError, match="prior: pre_inflaton: expected a coordinate of manufactured polynomial"):
        WidthPredictor(model, experiment, errors, prior=Prior(coordinates={"pre_inflaton": "0 .. 0.1"}))


class _Inflated(PolynomialModel):
    coordinates = MappingProxyType({"pre_inflation": CoordinateRange(0.0, 0.1, 0.0)})
