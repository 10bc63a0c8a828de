"""Evidences compared with closed forms and a dense second route."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal
from sessions import drawn_session

from capsbayes.diagnosis import Scores
from capsbayes.diagnosis.finding import find
from capsbayes.diagnosis.fits import Trend, fitted, log_evidences
from capsbayes.diagnosis.scores import (
    Discrepancy,
    _spectrum,
    displacement_modes,
    region_displacements,
    whitening,
)
from capsbayes.effects import Halo
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
    information, shift = rest.information.sum(axis=0), rest.shift.sum(axis=0)
    (together_with,) = log_evidences(information, shift[:, None], np.full(count, SHARED))
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
    assert of_noise + together_with == pytest.approx(due, rel=1e-6)


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


def test_the_amplitudes_of_something_else_are_those_of_the_displacement(model, compared):
    displaced = displaced_outwards(compared[0], 0.01)
    white = whitening(model, displaced)
    amplitudes, probabilities = Discrepancy.of(displaced, white, fitted(model, displaced, white)).amplitudes
    assert probabilities.sum() == pytest.approx(1.0)
    assert 0.003 < amplitudes @ probabilities < 0.03
    assert Discrepancy().amplitudes == (0.0, 1.0)


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
    np.testing.assert_array_equal(displaced.taken([3, 1]).shift, displaced.shift[[3, 1]])
    assert Discrepancy().evidence == 0.0


@pytest.fixture
def silent():
    """What outlines without information say of capsules at the corners of a box in ln Ca and a/l."""
    places = np.array([[-3.0, 0.8], [-3.0, 1.1], [-1.0, 0.8], [-1.0, 1.1]])
    count = Discrepancy().shift.shape[1]
    nothing = np.zeros((4, count))
    return Discrepancy(places, np.zeros((4, count, count)), nothing, np.zeros(4), np.arange(4.0))


def test_outlines_that_tell_nothing_leave_something_else_as_likely_as_nothing(silent):
    assert silent.evidence == pytest.approx(0.0, abs=1e-12)


def test_half_of_the_variance_of_a_displacement_is_common_to_all_capsules(silent):
    """The rest depends on ln Ca and a/l, by two length scales from corner to corner."""
    same, depending, growing = silent._dependences()
    away = (np.arange(4.0) - 1.5) / np.sqrt(1.25)
    np.testing.assert_allclose(growing @ growing.T, 0.5 + 0.5 * np.outer(away, away))
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


def moduli(count, seed=3):
    """Capsules whose G_s scatters by 10 %, whatever their velocity, a/l and order."""
    rng = np.random.default_rng(seed)
    places = np.stack([rng.uniform(-6.0, -5.0, count), rng.uniform(0.8, 1.0, count)], axis=1)
    level = np.log(0.05) + 0.1 * rng.standard_normal(count)
    return Trend(places, level, np.full(count, 0.05**2), np.zeros((count, 2)), np.linspace(0.0, 1.0, count))


def test_lengths_alone_leave_a_trend_of_the_modulus_to_something_else():
    plain = moduli(30)
    assert plain.evidence < 0.0
    rising = replace(plain, log_modulus=plain.log_modulus + 0.6 * (plain.places[:, 0] + 5.5))
    assert rising.evidence > 3.0
    assert Discrepancy(trend=rising).evidence == rising.evidence


def test_a_drift_with_time_and_two_kinds_of_capsules_are_something_else():
    plain = moduli(40)
    assert plain.kinds.evidence < 0.0
    drifting = replace(plain, log_modulus=plain.log_modulus + 0.6 * plain.order)
    assert drifting.evidence > 3.0
    twofold = replace(plain, log_modulus=plain.log_modulus + np.log(2.0) * (np.arange(40) % 2))
    assert twofold.evidence > 3.0
    assert abs(twofold.kinds.apart - np.log(2.0)) < 3.0 * twofold.kinds.error
    astray = replace(plain, log_modulus=np.where(np.arange(40) == 7, plain.log_modulus + 0.6, plain.log_modulus))
    assert astray.kinds.evidence < 0.0


def test_one_kind_is_seldom_taken_for_two():
    evidences = [moduli(40, seed).kinds.evidence for seed in range(100)]
    assert np.mean(np.exp(evidences)) < 1.0  # Markov's inequality bounds the p-value by the odds
    assert np.mean(np.array(evidences) > 3.0) <= 0.05
