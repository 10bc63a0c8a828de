"""Capsules at given membranes: for shapes that are linear in all unknowns every integral is that of a Gaussian."""

from dataclasses import replace

import numpy as np
import pytest
from linear_shapes import ALONG, OF_MEMBRANE, RATIO, Linear, linear_batch
from scipy import stats

from capsbayes.experiment import Experiment
from capsbayes.infer.conditional import MODULUS, SCALE, SIZE, Capsules, Spreads, Start, Unknowns, batch_of
from capsbayes.infer.outline import OutlineLikelihood
from capsbayes.infer.prior import Coordinate
from capsbayes.infer.shared_membrane import MembraneSampling
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.profile import vertex_normals
from capsbayes.quantity import Quantity
from capsbayes.surrogate import MembraneSurrogate


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


EXPERIMENT = Experiment(cross_section="square", half_width="25 +/- 0.1 um", viscosity="0.85 +/- 0.02 Pa s")
PLACE = {"capillary_number": 0.06, "size_ratio": 0.9, "pre_inflation": 0.03, "strain_hardening": 0.5}


@pytest.fixture(scope="module")
def model():
    return MembraneSurrogate.open("square")


def measured(lengths=(2.0, 1.8), velocity=5e-3, **more):
    return Measurement(
        axial_extent=lengths[0],
        axial_extent_error=0.01,
        axial_length=lengths[1],
        axial_length_error=0.02,
        capsule_velocity=velocity,
        capsule_velocity_error=0.01 * velocity,
        **more,
    )


def with_outline(model, rng):
    seen = model.at(outline=True, **PLACE)
    points, noise = seen.outline[0][::2], OutlineNoise(0.005, 0.3)
    points = points + noise.drawn(rng, points, 1)[0][:, None] * vertex_normals(points)
    return measured((seen.axial_extent[0], seen.axial_length[0]), outline=MeasuredOutline(points, noise))


def nearest(model, batch):
    """Return the outline of the states that looks most like the first capsule."""
    away = batch.target[0] - model.stored_coefficients @ batch.rows[0][:, :-1].T
    return model.outlines_of(model.stored_coefficients[[np.argmin(np.sum(away**2, axis=1))]])[0]


def test_differences_of_outlines_are_those_of_the_whole_likelihood(model):
    """Near the capsule, up to what is curved: 0.02 of a chi squared that changes by tens."""
    rng = np.random.default_rng(0)
    seen = with_outline(model, rng)
    batch = batch_of([seen], EXPERIMENT, model)
    theta = {name: value * (1.0 + 0.02 * rng.normal(size=30)) for name, value in PLACE.items()}
    prediction, coefficients, _ = model.with_coefficients(theta, errors=False)
    numbers = np.column_stack([coefficients, prediction.axial_length])
    reduced = np.sum((batch.target[0] - numbers @ batch.rows[0].T) ** 2, axis=1) + batch.left[0]
    pilot = nearest(model, batch)
    whole = OutlineLikelihood(seen.outline.points, seen.outline.noise, pilot, seen.outline.pose)
    wanted = np.sum(whole.whitened(model.outlines_of(coefficients)) ** 2, axis=1)
    assert np.ptp(wanted) > 20.0
    np.testing.assert_allclose(reduced - reduced.min(), wanted - wanted.min(), atol=0.05 * np.ptp(wanted))


def test_a_larger_capsule_changes_an_outline_as_the_scale_says(model):
    batch = batch_of([with_outline(model, np.random.default_rng(1))], EXPERIMENT, model)
    shape = nearest(model, batch)
    modes = model.mode_shapes.reshape(len(model.mode_shapes), -1)
    change = batch.rows[0, :, :-1] @ (modes @ shape.ravel())
    # the modes hold nearly all of the growth
    assert np.linalg.norm(change - batch.scale[0]) < 0.2 * np.linalg.norm(batch.scale[0])


def test_lengths_keep_their_covariance(model):
    batch = batch_of([measured()], EXPERIMENT, model)
    information = batch.rows[0].T @ batch.rows[0]
    np.testing.assert_allclose(information, np.diag([1e4, 2500.0]), rtol=1e-9)
    np.testing.assert_allclose(np.linalg.solve(batch.rows[0], batch.target[0]), [2.0, 1.8])


def test_a_missing_length_tells_nothing(model):
    lengths = {"axial_extent": 2.0, "axial_extent_error": 0.01, "capsule_velocity": "5.00 +/- 0.05 mm/s"}
    batch = batch_of([Measurement(**lengths)], EXPERIMENT, model)
    assert batch.known[0] == 1
    assert np.linalg.norm(batch.rows[0][:, 1]) < 0.01


def test_capsules_of_one_speed_are_of_one_flow(model):
    speeds = [5e-3, 1.5e-3, 5.2e-3, 1.6e-3, 9e-3]
    batch = batch_of([measured(velocity=speed) for speed in speeds], EXPERIMENT, model)
    assert batch.group.tolist() == [1, 0, 1, 0, 2]


def test_the_error_of_the_model_counts_as_often_as_capsules_share_it(model):
    batch = batch_of([measured(), measured((1.9, 1.85))], EXPERIMENT, model)
    own, sharing = np.array([[4e-4, 1e-4], [1e-4, 9e-4]]), np.array([1.0, 2.5])
    erring = batch.with_model_error(np.stack([own, own]), np.array([0.002, 0.004]), sharing)
    wanted = np.sqrt(batch.velocity_error**2 + [0.002**2, 2.5 * 0.004**2])
    np.testing.assert_allclose(erring.velocity_error, wanted)
    for number, share in enumerate(sharing):
        whole = np.linalg.inv(batch.rows[number].T @ batch.rows[number]) + share * own
        np.testing.assert_allclose(erring.rows[number].T @ erring.rows[number], np.linalg.inv(whole), rtol=1e-9)
        best = np.linalg.solve(batch.rows[number], batch.target[number])
        np.testing.assert_allclose(np.linalg.solve(erring.rows[number], erring.target[number]), best)


def test_outlines_of_few_points_are_reduced_beside_those_of_many(model):
    many = with_outline(model, np.random.default_rng(1))
    few = replace(many, outline=replace(many.outline, points=many.outline.points[::4]))
    batch = batch_of([few, many], EXPERIMENT, model)
    assert len(few.outline.points) < batch.rows.shape[-1]
    assert np.count_nonzero(np.any(batch.rows[0] != 0.0, axis=1)) == len(few.outline.points)
    sizes = np.ptp([nearest(model, batch), nearest(model, batch.taken(np.array([1])))], axis=1)
    np.testing.assert_allclose(sizes[0], sizes[1], rtol=0.02)  # of few points, it looks as of many


def test_spreads_do_not_vanish():
    unknowns = Unknowns.of((), {}, (None, None))
    spreads = unknowns.spreads_at(np.log([[0.15, 0.06], [1e-9, 1e-12]]))
    np.testing.assert_allclose(spreads.modulus, [0.15, 1e-4])
    np.testing.assert_allclose(spreads.size, [0.06, 1e-4])
