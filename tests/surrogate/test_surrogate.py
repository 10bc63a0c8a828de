import json

import manufactured
import numpy as np
import pytest

from capsbayes.errors import DatabaseError, OutsideDatabaseError
from capsbayes.surrogate import Surrogate

NAMES = ("axial_extent", "axial_length", "velocity_ratio")


def some_points(surrogate, count=3000, seed=7):
    """Random points of the domain : Ca (n,), a/l (n,)."""
    (ca_low, ca_high), (size_low, size_high) = surrogate.domain.bounds
    ca, size = np.random.default_rng(seed).uniform([ca_low, size_low], [ca_high, size_high], (count, 2)).T
    inside = surrogate.domain.contains(ca, size)
    return ca[inside], size[inside]


def theta(ca, size):
    return {"capillary_number": np.asarray(ca), "size_ratio": np.asarray(size)}


def test_it_gives_the_manufactured_lengths(manufactured_surrogate):
    ca, size = some_points(manufactured_surrogate)
    prediction = manufactured_surrogate(theta(ca, size))
    exact = manufactured.lengths(ca, size)
    assert prediction.inside.all()
    np.testing.assert_allclose(prediction.values, exact[:, :3], atol=2e-5)
    np.testing.assert_allclose(prediction.stretch_ratio, exact[:, 3], atol=2e-5)


def test_the_gradient_is_the_derivative_of_the_prediction(manufactured_surrogate):
    ca, size = some_points(manufactured_surrogate)
    inner = manufactured_surrogate.domain.contains(ca * 1.01, size + 1e-3)
    inner &= manufactured_surrogate.domain.contains(ca * 0.99, size - 1e-3)
    ca, size, step = ca[inner], size[inner], 1e-6

    def values(c, s):
        return manufactured_surrogate(theta(c, s)).values

    by_ca = (values(ca + step, size) - values(ca - step, size)) / (2 * step)
    by_size = (values(ca, size + step) - values(ca, size - step)) / (2 * step)
    gradient = manufactured_surrogate.gradient(capillary_number=ca, size_ratio=size)
    np.testing.assert_allclose(gradient, np.stack([by_ca, by_size], axis=-1), rtol=1e-6, atol=1e-6)
    assert np.isnan(manufactured_surrogate.gradient(capillary_number=0.5, size_ratio=0.9)).all()


def test_a_batch_is_its_points_one_by_one(manufactured_surrogate):
    ca, size = some_points(manufactured_surrogate, 20)
    batch = manufactured_surrogate(theta(ca, size), outline=True)
    for i in range(len(ca)):
        one = manufactured_surrogate.at(capillary_number=ca[i], size_ratio=size[i], outline=True)
        np.testing.assert_array_equal(one.values[0], batch.values[i])
        np.testing.assert_array_equal(one.covariance[0], batch.covariance[i])
        np.testing.assert_allclose(one.outline[0], batch.outline[i], rtol=1e-13, atol=1e-14)


def test_outside_a_batch_has_a_mask_and_a_point_has_an_error(manufactured_surrogate):
    prediction = manufactured_surrogate(theta([0.05, 0.5, np.nan, -1.0], [0.9, 0.9, 0.9, 0.9]), outline=True)
    np.testing.assert_array_equal(prediction.inside, [True, False, False, False])
    np.testing.assert_array_equal(np.isnan(prediction.values).all(axis=1), ~prediction.inside)
    np.testing.assert_array_equal(np.isnan(prediction.covariance).all(axis=(1, 2)), ~prediction.inside)
    np.testing.assert_array_equal(np.isnan(prediction.outline).all(axis=(1, 2)), ~prediction.inside)
    with pytest.raises(
        OutsideDatabaseError, match=r"Ca = 0\.12, a/l = 1\.05 .* no steady shape is known above"
    ) as error:
        manufactured_surrogate.at(capillary_number=0.12, size_ratio=1.05)
    assert (error.value.capillary_number, error.value.size_ratio) == (0.12, 1.05)


def test_every_corner_of_the_domain_has_a_value(manufactured_surrogate):
    (region,) = manufactured_surrogate.domain.regions
    for border in (region.lowest, region.highest):
        assert np.isfinite(manufactured_surrogate(theta(border, region.size_ratio)).values).all()


def test_outlines_are_close_to_the_truth_and_have_the_predicted_extent(manufactured_surrogate):
    ca, size = some_points(manufactured_surrogate, 50)
    prediction = manufactured_surrogate(theta(ca, size), outline=True)
    np.testing.assert_allclose(prediction.outline, manufactured.outlines(ca, size), atol=2e-5)
    assert manufactured_surrogate(theta(ca, size)).outline is None


def test_no_branch_speaks_for_the_other():
    surrogate = Surrogate(manufactured.two_branches())
    ca, size = some_points(surrogate)
    prediction = surrogate(theta(ca, size), outline=True)
    gap = surrogate.branches[0].branch.gap.contains(ca, size)
    convex = manufactured.is_convex(ca, size)
    branch = manufactured.convex_lengths(ca, size)
    expected = np.where(
        convex[:, None], np.stack([branch[n] for n in NAMES], axis=1), manufactured.lengths(ca, size)[:, :3]
    )
    assert prediction.inside.all()
    assert np.isfinite(prediction.outline).all()
    clear = ~gap & ((size < 1.0) | (size > 1.025))  # the jump itself lies between these two columns
    np.testing.assert_allclose(prediction.values[clear], expected[clear], atol=5e-5)
    assert np.abs(prediction.parachute_depth[convex & clear]).max() < 1e-12
    sd = np.sqrt(prediction.covariance[:, 0, 0])
    jump = np.abs(branch["axial_extent"] - manufactured.lengths(ca, size)[:, 0])
    assert np.all(sd[gap] > 0.4 * jump[gap] * (jump[gap] > 0.01))
    assert np.median(sd[~gap]) < 1e-4


def test_the_mesh_error_of_the_file_is_in_the_covariance(manufactured_surrogate):
    plain = Surrogate(manufactured.database(failed=(5,)))
    with_mesh, without = (s.at(capillary_number=0.05, size_ratio=0.9) for s in (manufactured_surrogate, plain))
    added = np.diag(with_mesh.covariance[0] - without.covariance[0])
    stated = np.array(list(json.loads(manufactured.MESH_ERROR).values()))
    np.testing.assert_allclose(np.sqrt(added), stated * without.values[0], rtol=1e-2)


def test_a_file_is_opened_by_its_path_and_an_unknown_name_is_refused(tmp_path, manufactured_database):
    manufactured_database.write(tmp_path / "small.nc")
    assert Surrogate.open(tmp_path / "small.nc").sha256 == manufactured_database.sha256
    with pytest.raises(DatabaseError, match="no-such-database"):
        Surrogate.open("no-such-database")
