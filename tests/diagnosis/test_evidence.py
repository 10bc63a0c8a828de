"""Evidences compared with closed forms and a dense second route."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal
from sessions import drawn_session

from capsbayes.diagnosis import NOTHING, UNKNOWN, Scores
from capsbayes.diagnosis.finding import find
from capsbayes.diagnosis.fits import Process, Trend, fitted
from capsbayes.diagnosis.scores import (
    Discrepancy,
    _spectrum,
    displacement_modes,
    region_displacements,
    whitening,
)
from capsbayes.diagnosis.search import evidences, probabilities
from capsbayes.effects import Halo, PixelScale
from capsbayes.profile import vertex_normals


def scores_at(effect, sizes, totals):
    return Scores(effect, sizes, totals[:, None], np.zeros(len(sizes)), np.full(len(sizes), 0.05))


def test_evidence_of_a_gaussian_likelihood_with_a_gaussian_prior():
    """The mean of N(x; m, s) over a prior N(0, t) is N(m; 0, (s^2 + t^2)^1/2)."""
    effect, middle, error = Halo(), 0.3e-6, 0.1e-6
    sizes = np.linspace(-2.0, 2.0, 401) * 1e-6
    found = scores_at(effect, sizes, -0.5 * ((sizes - middle) / error) ** 2).evidence
    prior = effect.prior.sd
    wide = np.hypot(prior, error)
    due = np.log(error / wide) - 0.5 * (middle / wide) ** 2 + 0.5 * (middle / error) ** 2
    assert found == pytest.approx(due, abs=0.01)
    tried = np.abs(sizes - middle) < 5.5 * error  # the rest of the prior counts, though no size was tried there
    found = scores_at(effect, sizes[tried], -0.5 * ((sizes[tried] - middle) / error) ** 2).evidence
    assert found == pytest.approx(due, abs=0.01)


@pytest.fixture(scope="module")
def compared(model):
    """Twenty capsules of the model, with a whitening and fits of its own."""
    session, _ = drawn_session(model, 20, seed=4, outline=True)
    white = whitening(model, session)
    return session, white, fitted(model, session, white)


SHARED = 0.003**2  # variance of each amplitude that all capsules have in common


@pytest.mark.parametrize("noise", [0.0, 0.006])
def test_displacements_are_integrated_as_by_their_whole_covariance(compared, noise):
    """A displacement of each capsule for itself next to one that all share: the dense covariance is another route."""
    session, white, fits = compared
    found = Discrepancy.of(session, white, fits)
    rest, of_noise = found._without(noise)
    count = found.information.shape[1]
    information, shift, response = rest.information.sum(axis=0), rest.shift.sum(axis=0), rest.response.mean(axis=0)
    process = Process.of(information, shift, response, np.full(count, SHARED))
    each, rows = [], []
    for slopes, seen in zip(fits.slopes, white.each, strict=True):
        modes = seen.likelihood.whitened_displacement(displacement_modes(seen.likelihood.pilot))
        basis = np.linalg.qr(slopes)[0]
        left = modes - (modes @ basis) @ basis.T
        of_arc = left[: count - 5]  # without the distortions of the camera
        each.append(np.eye(left.shape[1]) + (of_arc.T * noise**2 * _spectrum(0.05)) @ of_arc)
        rows.append(left * np.sqrt(SHARED))
    residuals, together = np.concatenate(fits.residuals), np.hstack(rows)
    covariance = block_diag(*each) + together.T @ together
    due = multivariate_normal(cov=covariance).logpdf(residuals)
    due -= multivariate_normal(cov=np.eye(len(residuals))).logpdf(residuals)
    assert of_noise + process.log_evidence == pytest.approx(due, rel=1e-6)
    amplitudes = np.linalg.inv(information + np.eye(count) / SHARED)
    assert process.change == pytest.approx(response @ amplitudes @ shift, rel=1e-6)
    assert process.variance == pytest.approx(response @ amplitudes @ response, rel=1e-6)


@pytest.mark.parametrize(("drawn", "least", "most"), [(0.01, 0.0, 0.005), (0.02, 0.012, 0.025)])
def test_outlines_noisier_than_stated_are_seen_from_their_scatter(model, drawn, least, most):
    """Noise of 0.02 l where 0.01 l is stated leaves (0.02^2 - 0.01^2)^1/2 = 0.017 l."""
    session, _ = drawn_session(model, 20, seed=4, outline=True, noise=drawn)
    said = [
        replace(each, outline=replace(each.outline, noise=replace(each.outline.noise, scale=0.01)))
        for each in session.measurements
    ]
    white = whitening(model, replace(session, measurements=tuple(said)))
    assert least <= white.further <= most
    assert find(model, session, seed=1, white=white).further_noise == white.further


def test_what_displaces_all_outlines_alike_is_no_noise(model, compared):
    session, _, _ = compared
    assert whitening(model, displaced_outwards(session, 0.01)).further <= 0.004


def test_something_else_takes_back_what_displaced_outlines_do_to_the_modulus(model, compared):
    session, _, fits = compared
    displaced = displaced_outwards(session, 0.01)
    white = whitening(model, displaced)
    wrong = fitted(model, displaced, white)
    moved = float(np.mean(wrong.log_modulus - fits.log_modulus))
    draws = Discrepancy.of(displaced, white, wrong).log_modulus_changes(np.random.default_rng(1), 4000)
    assert abs(moved) > 0.05
    assert np.mean(draws) * moved < 0.0
    low, high = np.quantile(draws, (0.025, 0.975))
    assert low < -moved < high
    assert not Discrepancy().log_modulus_changes(np.random.default_rng(1), 3).any()


def displaced_outwards(session, distance):
    """The session with the edge of each capsule moved outwards by a distance [l]."""
    measurements = []
    for measurement in session.measurements:
        points = measurement.outline.points
        outline = replace(measurement.outline, points=points + distance * vertex_normals(points))
        measurements.append(replace(measurement, outline=outline))
    return replace(session, measurements=tuple(measurements))


def test_something_else_pays_for_its_freedom_and_wins_where_outlines_are_displaced(compared):
    session, white, fits = compared
    assert Discrepancy.of(session, white, fits).evidence < 0.0
    # a bump at the rear rim that grows with Ca, and nothing else
    moved = []
    for row, each in enumerate(white.each):
        height = 0.03 * (1.0 + fits.theta[row, 0] - fits.theta[:, 0].mean())
        bump = region_displacements(each.likelihood.pilot)[2:3]
        moved.append(fits.residuals[row] + height * each.likelihood.whitened_displacement(bump)[0])
    displaced = Discrepancy.of(session, white, replace(fits, residuals=tuple(moved)))
    assert displaced.evidence > 10.0
    halves = [
        Discrepancy.of(session, white, replace(fits, residuals=tuple(moved), settled=half))
        for half in (np.arange(20) < 10, np.arange(20) >= 10)
    ]
    assert (halves[0] + halves[1]).evidence == pytest.approx(displaced.evidence, rel=1e-6)
    assert Discrepancy().evidence == 0.0


@pytest.fixture
def silent():
    """What outlines without information say of capsules at the corners of a box in ln Ca and a/l."""
    places = np.array([[-3.0, 0.8], [-3.0, 1.1], [-1.0, 0.8], [-1.0, 1.1]])
    count = Discrepancy().shift.shape[1]
    nothing = np.zeros((4, count))
    return Discrepancy(places, np.zeros((4, count, count)), nothing, nothing, np.zeros(4))


def test_outlines_that_tell_nothing_leave_something_else_as_likely_as_nothing(silent):
    assert silent.evidence == pytest.approx(0.0, abs=1e-12)


def test_half_of_the_variance_of_a_displacement_is_common_to_all_capsules(silent):
    """The rest depends on ln Ca and a/l, by two length scales from corner to corner."""
    same, depending = silent._dependences()
    np.testing.assert_array_equal(same @ same.T, 1.0)
    away = np.sum(((silent.places[:, None] - silent.places) / np.array([1.0, 0.15])) ** 2, axis=2)
    np.testing.assert_allclose(depending @ depending.T, 0.5 + 0.5 * np.exp(-0.5 * away), atol=1e-6)


def test_the_offset_that_all_edges_share_counts_as_the_models_own_error(model):
    session, _ = drawn_session(model, 4, seed=4, outline=True)
    own = []
    for offset in (0.0, 0.004):
        outlines = [replace(m.outline, pose=replace(m.outline.pose, offset=offset)) for m in session.measurements]
        moved = [replace(m, outline=outline) for m, outline in zip(session.measurements, outlines, strict=True)]
        shared = replace(session, measurements=tuple(moved))
        white = whitening(model, shared)
        own.append(Discrepancy.of(shared, white, fitted(model, shared, white)).own)
    np.testing.assert_allclose(own[1], np.hypot(own[0], 0.004), rtol=0.05)
    assert own[0].max() < 0.002


def test_lengths_alone_leave_a_trend_of_the_modulus_to_something_else():
    rng = np.random.default_rng(3)
    places = np.stack([rng.uniform(-6.0, -5.0, 30), rng.uniform(0.8, 1.0, 30)], axis=1)
    level = np.log(0.05) + 0.1 * rng.standard_normal(30)
    plain = Trend(places, level, np.full(30, 0.05**2), np.zeros((30, 2)))
    assert plain.evidence < 0.0
    rising = replace(plain, log_modulus=level + 0.6 * (places[:, 0] + 5.5))
    assert rising.evidence > 3.0
    assert Discrepancy(trend=rising).evidence == rising.evidence


def test_nothing_is_the_likeliest_where_nothing_is_gained(model):
    session, _ = drawn_session(model, 20, seed=4, outline=True)
    finding = find(model, session, seed=1)
    sizes = np.linspace(-0.05, 0.05, 101)
    flat = scores_at(PixelScale(), sizes, -0.5 * (sizes / 0.002) ** 2)
    found = evidences({"pixel_scale": flat}, finding)
    assert next(iter(found)) == NOTHING
    assert found[NOTHING] == 0.0
    assert found[UNKNOWN] < 0.0
    assert finding.leaves_nothing(0.01, 0.0)
    assert sum(probabilities(found, {}).values()) == pytest.approx(1.0)
