"""The surrogate over the membrane is exact for quadratics, finds left-out states within its error, and is a model."""

import numpy as np
import pytest

from capsbayes.errors import OutsideDatabaseError
from capsbayes.membrane_database import FREE_PARAMETERS, MembraneDatabase
from capsbayes.profile import Profile
from capsbayes.surrogate.membrane import (
    MembraneSurrogate,
    along_coordinates,
    averaged,
    coordinates,
    each,
    local_fits,
    reached,
)
from capsbayes.surrogate.open import Surrogate
from capsbayes.testing import check_model


def fits_of(places, values, along, *, lost=9.0, errors=None):
    """Fit polynomials, by default to values without errors, with one lost place."""
    return local_fits(places, values, along, np.full((1, 6), lost), np.zeros_like(values) if errors is None else errors)


@pytest.fixture(scope="module")
def whole():
    return MembraneDatabase.open("square")


@pytest.fixture(scope="module")
def model(whole):
    return MembraneSurrogate(whole)


@pytest.fixture(scope="module")
def left_out(whole):
    """Every tenth state, and what is predicted of it from the others."""
    out = np.arange(len(whole)) % 10 == 3
    states, others = whole.taken(np.flatnonzero(out)), whole.taken(np.flatnonzero(~out))
    return states, MembraneSurrogate(others)(dict(zip(FREE_PARAMETERS, states["values"].T, strict=True)), outline=True)


def test_quadratics_are_reproduced():
    rng = np.random.default_rng(0)
    places, form, slope = rng.uniform(-2.0, 2.0, (300, 6)), rng.normal(size=(6, 6)), rng.normal(size=6)
    values = np.einsum("ni,ij,nj->n", places, form, places) + places @ slope
    along = places @ (form + form.T) + slope
    both, slopes = np.stack([values, 2.0 * values], axis=1), np.stack([along, 2.0 * along], axis=1)
    fits = fits_of(places, both, slopes)
    points = rng.uniform(-1.0, 1.0, (50, 6))
    means, covariances, slopes = averaged(points, *fits, 2, 2, True)
    wanted = np.einsum("ni,ij,nj->n", points, form, points) + points @ slope
    np.testing.assert_allclose(means, np.stack([wanted, 2.0 * wanted], axis=1), atol=1e-4)
    assert np.abs(covariances).max() < 1e-8
    along = points @ (form + form.T) + slope
    np.testing.assert_allclose(slopes, np.stack([along, 2.0 * along], axis=1), atol=1e-3)


def test_the_covariance_is_that_about_the_mean_of_the_polynomials_and_of_the_errors_of_their_states():
    """Compared with the polynomials one by one, about values far from zero."""
    places = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 6))
    values = 5.0 + np.sin(3.0 * places[:, :2])
    along = 3.0 * np.cos(3.0 * places[:, :2])[..., None] * np.eye(6)[:2]
    fits = fits_of(places, values, along, errors=0.3 * np.random.default_rng(2).normal(size=values.shape))
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (5, 6))
    means, covariances, _ = averaged(points, *fits, 2, 2, False)
    for point, mean, covariance in zip(points, means, covariances, strict=True):
        weights, found, errors = each(point, *fits)
        np.testing.assert_allclose(mean, weights @ found, rtol=1e-10)
        of_mesh = np.einsum("k,ki,kj->ij", weights, errors, errors)
        np.testing.assert_allclose(covariance, np.cov(found.T, aweights=weights, ddof=0) + of_mesh, rtol=1e-8)


def test_a_polynomial_that_does_not_fit_its_neighbours_counts_for_little():
    """A step, as of a shape that snaps: beyond it the values are as if it were not there."""
    places = np.random.default_rng(0).uniform(-2.0, 2.0, (1500, 6))
    values = np.sin(places[:, :1]) + 5.0 * (places[:, :1] > 1.0)
    along = np.cos(places[:, :1])[..., None] * np.eye(6)[0]
    fits = fits_of(places, values, along)
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 6))
    points[:, 0] = 0.5
    rms = {}
    for name, trust in (("fitting", fits.trust), ("alike", np.ones(len(places)))):
        means, _, _ = averaged(points, *fits._replace(trust=trust), 1, 1, False)
        rms[name] = np.sqrt(np.mean((means[:, 0] - np.sin(0.5)) ** 2))
    assert rms["fitting"] < 0.5 * rms["alike"]


def test_nothing_is_said_nearer_to_a_lost_place_than_to_a_state():
    places = np.random.default_rng(0).uniform(-2.0, 2.0, (300, 6))
    fits = fits_of(places, places[:, :1], np.eye(6)[None, :1].repeat(300, axis=0), lost=0.25)
    towards = np.linspace(0.0, 1.0, 41)[:, None] * (places[0] - 0.25) + 0.25
    near_state = np.linalg.norm(towards[:, None] - places, axis=2).min(axis=1)
    expected = near_state <= np.linalg.norm(towards - 0.25, axis=1)
    assert 0 < expected.sum() < len(expected)
    np.testing.assert_array_equal(reached(towards, *fits[:5]), expected)


def test_the_cells_miss_no_state_that_reaches_a_point():
    """Far outside the states, too."""
    places = np.random.default_rng(0).normal(size=(400, 6))
    values = places[:, :1] ** 3
    fits = fits_of(places, values, 3.0 * places[:, :1, None] ** 2 * np.eye(6)[0], lost=99.0)
    points = 1.5 * np.random.default_rng(1).normal(size=(300, 6))
    square = np.sum((points[:, None] - places) ** 2, axis=2)
    count = np.sum(square < fits.reaches**2, axis=1)
    assert np.any(count >= 4)
    assert np.any(count < 4)
    found = [len(each(point, *fits)[0]) for point in points]
    np.testing.assert_array_equal(found, np.where(count >= 4, count, 0))


def test_derivatives_turn_with_the_coordinates(whole):
    """Those of the coordinates themselves are the unit matrix."""
    values = whole["values"][:20]
    along = np.empty((len(values), 6, 6))
    for axis in range(6):
        step = 1e-6 * values[:, axis] + 1e-9
        change = np.eye(6)[axis] * step[:, None]
        along[..., axis] = (coordinates(values + change) - coordinates(values - change)) / (2.0 * step[:, None])
    np.testing.assert_allclose(
        along_coordinates(values, along), np.broadcast_to(np.eye(6), along.shape), rtol=1e-5, atol=1e-5
    )


def test_states_left_out_are_found_within_the_stated_error(model, left_out):
    states, predicted = left_out
    inside = predicted.inside
    assert inside.mean() > 0.9
    away = (predicted.values - states["numbers"][:, :3])[inside]
    score = away / np.sqrt(np.einsum("nii->ni", predicted.covariance))[inside]
    assert np.all(np.median(np.abs(score), axis=0) < 1.0)
    assert np.all(np.mean(np.abs(score) < 2.0, axis=0) > 0.85)
    assert np.all(np.median(np.abs(away) / states["numbers"][inside, :3], axis=0) < 3e-3)


def test_lengths_are_those_of_the_outline(model, left_out):
    _, predicted = left_out
    some = np.flatnonzero(predicted.inside)
    drawn = [Profile(predicted.outline[row]) for row in some]
    extents, lengths = np.array([(outline.axial_extent, outline.axial_length) for outline in drawn]).T
    for seen, told in ((extents, predicted.axial_extent[some]), (lengths, predicted.axial_length[some])):
        assert np.median(np.abs(seen - told)) < 0.005
        assert np.mean(np.abs(seen - told) < 0.03) > 0.9


def test_changes_of_states_left_out_are_nearer_than_differences_of_predictions(whole, left_out):
    """Their own derivatives say so: differences of predictions let in those between the polynomials averaged."""
    states, _ = left_out
    others = MembraneSurrogate(whole.taken(np.flatnonzero(np.arange(len(whole)) % 10 != 3)))
    theta = dict(zip(FREE_PARAMETERS, states["values"].T, strict=True))
    steps = {"size_ratio": 1e-3, "strain_hardening": 1e-3}
    moved = [{**theta, name: theta[name] + step} for name, step in steps.items()]
    here, _, changes = others.with_changes(theta, moved, outline=False)
    for number, (name, step) in enumerate(steps.items()):
        exact = step * states["numbers_along"][:, :3, FREE_PARAMETERS.index(name)]
        apart = np.abs(changes[number, :, :3] - exact), np.abs(others(moved[number]).values - here.values - exact)
        both = np.all(np.isfinite(apart), axis=(0, 2))
        diffuse, differences = (np.median(values[both]) for values in apart)
        assert diffuse < 0.9 * differences
        assert diffuse < 0.5 * np.median(np.abs(exact[both]))
    _, coefficients, with_outlines = others.with_changes(theta, moved, outline=True)
    assert with_outlines.shape == (2, len(exact), 4 + coefficients.shape[1])
    np.testing.assert_allclose(with_outlines[..., :4], changes, rtol=1e-9, atol=1e-12)


def test_a_neo_hookean_membrane_is_that_of_the_plain_database(model):
    """But for the mesh and the kind of bending energy."""
    plain = Surrogate.open("square-neo-hookean")
    ca, size = (axis.ravel() for axis in np.meshgrid([0.03, 0.05, 0.08], [0.8, 0.9, 1.0]))
    theta = {"capillary_number": ca, "size_ratio": size}
    np.testing.assert_allclose(model(theta).values, plain(theta).values, rtol=0.02)


def test_the_error_of_the_outline_is_of_the_size_of_that_of_the_lengths(model):
    theta = {"capillary_number": 0.06, "size_ratio": 0.9, "pre_inflation": 0.03, "strain_hardening": 0.5}
    modes = model.outline_modes(**theta)
    assert modes.shape[1] == 256
    of_length = np.sqrt(model.at(**theta).covariance[0, 0, 0])
    assert 0.05 * of_length < np.sqrt(np.sum(modes**2, axis=0)).max() < 20.0 * of_length


def test_the_domain_at_some_known_parameters_is_that_of_the_whole_there(model):
    held = {"area_dilation_modulus": 1.6, "pre_inflation": 0.04}
    rng = np.random.default_rng(5)
    ca, size = rng.uniform(0.01, 0.2, 400), rng.uniform(0.75, 1.1, 400)
    hardening, bending = rng.uniform(0.0, 1.0, 400), 10.0 ** rng.uniform(-5.0, -3.0, 400)
    whole = model.domain.contains(ca, size, np.full(400, 0.04), np.full(400, 1.6), hardening, bending)
    assert 0 < whole.sum() < 400
    some = model.fixed(**held)
    assert list(some.coordinates) == ["strain_hardening", "bending"]
    np.testing.assert_array_equal(some.domain.contains(ca, size, hardening, bending), whole)
    more = some.fixed(strain_hardening=0.5)
    expected = model.domain.contains(ca, size, np.full(400, 0.04), np.full(400, 1.6), np.full(400, 0.5), bending)
    np.testing.assert_array_equal(more.domain.contains(ca, size, bending), expected)
    assert "bending = 0.1 lies outside" in some.domain.reason(0.05, 0.9, bending=0.1)


def test_beyond_the_domain_it_has_no_answer_and_says_why(model):
    with pytest.raises(OutsideDatabaseError, match=r"pre_inflation = 0\.3 lies outside 0 to 0\.1"):
        model.at(capillary_number=0.05, size_ratio=0.9, pre_inflation=0.3)
    assert not model({"capillary_number": np.array([0.011, np.nan]), "size_ratio": np.array([0.9, 0.9])}).inside.any()


def test_it_keeps_the_promises_of_a_model(model):
    check_model(model)
