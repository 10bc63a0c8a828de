"""What is left of a measurement is as good as the whole of it."""

from dataclasses import replace

import numpy as np
import pytest

from capsbayes.experiment import Experiment
from capsbayes.infer.conditional import batch_of
from capsbayes.infer.outline import OutlineLikelihood
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import MembraneSurrogate

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
