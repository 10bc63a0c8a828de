"""Capsules at given membranes: for shapes that are linear in all unknowns every integral is that of a Gaussian."""

from dataclasses import replace

import numpy as np
import pytest
from linear_shapes import ALONG, OF_MEMBRANE, RATIO, Linear, linear_batch
from scipy import stats

from capsbayes.infer.conditional import MODULUS, SCALE, SIZE, Capsules, Spreads, Start, Unknowns
from capsbayes.infer.prior import Coordinate
from capsbayes.infer.shared_membrane import MembraneSampling
from capsbayes.quantity import Quantity


@pytest.fixture
def batch():
    return linear_batch()


def log_density(batch, inflation, spread, size_spread, inflation_spread=0.0):
    """Return the log density of all targets by dense matrices, the two means of the population integrated out."""
    n, q = batch.target.shape
    columns = 3 * n + 1  # a capsule's own three, the scale
    latent, means = np.zeros((n, 3, columns)), np.zeros((n, 3, 2))
    along = np.column_stack([ALONG, inflation * OF_MEMBRANE])
    for k in range(n):
        latent[k, 0, 3 * k] = np.hypot(spread, batch.velocity_error[k])
        latent[k, 1, 3 * k + 1] = size_spread
        latent[k, 2, 3 * k + 2] = inflation_spread
        means[k] = [[-1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
    middle = np.stack([batch.log_velocity - RATIO, np.zeros(n), np.ones(n)], axis=1)
    away = batch.target - np.einsum("nqk,nk->nq", batch.rows, middle @ along.T)
    seen = np.einsum("nqk,ka,nac->nqc", batch.rows, along, latent)
    seen[:, :, -1] = batch.scale * batch.scale_error
    seen, away = seen.reshape(n * q, columns), away.ravel()
    free = np.einsum("nqk,ka,nac->nqc", batch.rows, along, means).reshape(n * q, 2)
    covariance = seen @ seen.T + np.eye(n * q)
    precision = np.linalg.inv(covariance)
    normal = free.T @ precision @ free
    best = np.linalg.solve(normal, free.T @ precision @ away)
    left = away - free @ best
    volume = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(normal)[1]
    return -0.5 * (left @ precision @ left + volume)


@pytest.mark.parametrize("of_inflation", [(), (np.array([0.1, 0.4, 0.4, 0.8]),)])
def test_the_evidence_is_that_of_a_dense_normal_distribution(batch, of_inflation):
    capsules = Capsules(batch, Linear(), log_viscosity=0.0)
    inflation = np.array([0.02, 0.05, 0.09, 0.05])
    spreads = np.array([0.3, 0.3, 0.3, 0.1]), np.full(4, 0.05), *of_inflation
    found = capsules.at({"pre_inflation": inflation}, Spreads(*spreads))
    assert np.all(found.settled == 1.0)
    wanted = np.array([log_density(batch, *row) for row in zip(inflation, *spreads, strict=True)])
    np.testing.assert_allclose(np.diff(found.log_evidence), np.diff(wanted), atol=2e-3)
    assert np.ptp(wanted) > 1.0


def test_a_start_does_not_change_the_answer(batch):
    capsules = Capsules(batch, Linear(), log_viscosity=0.0)
    membranes, spreads = {"pre_inflation": np.array([0.05])}, Spreads(np.array([0.2]), np.array([0.05]))
    first = capsules.at(membranes, spreads)
    again = capsules.at(membranes, spreads, start=Start(first.own + 0.02, first.common + 0.01))
    np.testing.assert_allclose(again.log_evidence, first.log_evidence, atol=1e-3)
    np.testing.assert_allclose(again.own, first.own, atol=1e-3)


def test_draws_scatter_as_the_curvature_says(batch):
    """The mean of the population is known to the spread over the root of the number, and no better."""
    exact = replace(batch, rows=1e3 * batch.rows, target=1e3 * batch.target, scale_error=0.0)
    count = 1500
    membranes, spreads = {"pre_inflation": np.full(count, 0.05)}, Spreads(np.full(count, 0.2), np.full(count, 0.05))
    known = Linear()
    capsules = Capsules(exact, known, log_viscosity=0.0)
    drawn = capsules.at(membranes, spreads, rng=np.random.default_rng(1))
    assert np.isfinite(drawn.own).all()
    assert drawn.common[:, MODULUS].std() == pytest.approx(0.2 / np.sqrt(7), rel=0.25)
    assert drawn.common[:, SIZE].std() == pytest.approx(0.05 / np.sqrt(7), rel=0.25)


def test_shapes_that_differ_by_the_common_scale_alone_do_not_misfit(batch):
    capsules = Capsules(batch, Linear(), log_viscosity=0.0)
    membranes, spreads = {"pre_inflation": np.array([0.05])}, Spreads(np.array([0.2]), np.array([0.05]))
    found = capsules.at(membranes, spreads)
    numbers, stretched = capsules.shapes(membranes, found.own).numbers[0], found.common.copy()
    stretched[:, SCALE] = 0.7
    target = np.einsum("nqk,nk->nq", batch.rows, numbers) + 0.7 * batch.scale_error * batch.scale
    exact = replace(capsules, batch=replace(batch, target=target))
    np.testing.assert_allclose(exact.misfit(membranes, Start(found.own, stretched)), 0.0, atol=1e-12)
    assert exact.misfit(membranes, Start(found.own, 0.0 * stretched)).max() > 0.01


def test_capsules_within_the_length_of_the_error_share_it(batch):
    """Two of them have the same Ca and a/l, the others are ten lengths apart."""

    class Erring(Linear):
        error_lengths = np.array([0.1, 0.02])

    places = np.stack([np.log(0.05) + 1.0 * np.array([0, 0, 1, 2, 3, 4, 5]), np.full(7, 0.9)], axis=1)
    capsules = Capsules(batch, Erring(error=0.02), log_viscosity=0.0)
    found = capsules.with_model_error({"pre_inflation": np.array([0.05])}, places).batch
    sharing = np.array([2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    wanted = batch.with_model_error(np.tile(0.02**2 * np.eye(3), (7, 1, 1)), np.zeros(7), sharing)
    np.testing.assert_allclose(found.rows, wanted.rows, rtol=1e-9)


def test_the_posterior_of_a_membrane_is_that_of_a_grid(batch):
    coordinate = Coordinate("pre_inflation", Quantity.uniform(0.0, 0.3), 0.0, 0.3)
    sampled = MembraneSampling(Capsules(batch, Linear(), 0.0), Unknowns((coordinate,), {}, (0.2, 0.05)))
    sampled = _with_plain_fingerprint(sampled)()
    assert all(gate.passed for gate in sampled.gates)
    grid = np.linspace(0.0, 0.3, 601)
    logs = np.array([log_density(batch, value, 0.2, 0.05) for value in grid])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ grid
    values = coordinate.values(stats.norm.cdf(sampled.draws.points[:, 0]))
    share = np.exp(sampled.log_weights - sampled.log_weights.max())
    share /= share.sum()
    sd = np.sqrt(weights @ (grid - mean) ** 2)
    assert share @ values == pytest.approx(mean, abs=0.05 * sd)
    assert np.sqrt(share @ (values - share @ values) ** 2) == pytest.approx(sd, rel=0.05)


def _with_plain_fingerprint(sampling):
    """Give a sampling the fingerprint that it takes from a shipped surrogate otherwise."""
    vars(sampling)["fingerprint"] = "linear"
    return sampling
