"""The likelihood of an outline: what it is blind to, and that its intervals cover."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from capsbayes.errors import InputError
from capsbayes.footing import normal_distances, posed_on
from capsbayes.infer.outline import OutlineLikelihood, SilhouetteLength, aligned_with, outline_likelihood
from capsbayes.measurement import MeasuredOutline, OutlineNoise, Pose
from capsbayes.profile import vertex_normals
from capsbayes.surrogate import Surrogate

TRUTH = np.array([0.05, 0.9])
NOISE = OutlineNoise(0.004, 0.5, 0.1)


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


def outlines(model, theta):
    theta = np.atleast_2d(theta)
    return model({"capillary_number": theta[:, 0], "size_ratio": theta[:, 1]}, outline=True).outline


def posed(points, shift, tilt):
    turn = np.array([[np.cos(tilt), np.sin(tilt)], [-np.sin(tilt), np.cos(tilt)]])
    return points @ turn + shift


def fitted(model, likelihood):
    """Most likely (Ca, a/l) and the inverse of its covariance, by Gauss and Newton from the truth."""
    theta, steps = TRUTH.copy(), np.diag([1e-4, 1e-4])
    for _ in range(4):
        white = likelihood.whitened(outlines(model, theta + np.vstack([0 * steps[:1], steps, -steps])))
        slope = (white[1:3] - white[3:5]).T / 2e-4
        theta = theta - np.linalg.lstsq(slope, white[0])[0]
    return theta, slope.T @ slope


def covered(model, rng, drawn, assumed, count=150, pose=None, offset=0.0, modes=None):
    """Share of the 95 % regions of (Ca, a/l) that hold the truth."""
    pilot = outlines(model, TRUTH)[0]
    points, normal = pilot[::4], vertex_normals(pilot)[::4]
    hits = 0
    for errors in drawn.drawn(rng, points, count):
        seen = posed(points + (errors + offset)[:, None] * normal, rng.uniform(-0.3, 0.3, 2), rng.normal(0, 0.02))
        likelihood = OutlineLikelihood(seen, assumed, pilot, pose or Pose(), modes)
        found, precision = fitted(model, likelihood)
        hits += (found - TRUTH) @ precision @ (found - TRUTH) < 5.991
    return hits / count


def test_points_behind_a_gap_stand_where_they_belong():
    """A long ellipse without its flanks, as where walls were too near: each point finds its own side."""
    angle = np.linspace(0.0, 2.0 * np.pi, 256, endpoint=False)
    outline = np.stack([1.5 * np.cos(angle), np.sin(angle)], axis=1)
    points = outline[1::3]
    kept = points[np.abs(points[:, 1]) < 0.8]
    assert np.hypot(*np.diff(kept, axis=0).T).max() > 1.5
    assert np.abs(posed_on(kept, outline, fits=0)[1].distance).max() < 1e-12
    shifted, feet = posed_on(kept + np.array([0.03, -0.02]), outline)
    np.testing.assert_allclose(shifted, kept, atol=1e-3)
    assert np.abs(feet.distance).max() < 1e-3


def test_distances_from_a_circle_are_exact():
    angle = np.linspace(0.0, 2.0 * np.pi, 2000, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.array([[1.2, 0.0], [0.0, 0.7], [-1.0, 0.0], [0.0, -1.1]])
    feet = posed_on(points, circle, fits=0)[1]
    np.testing.assert_allclose(feet.distance, [0.2, -0.3, 0.0, 0.1], atol=2e-6)
    np.testing.assert_allclose(feet.normal, [[1, 0], [0, 1], [-1, 0], [0, -1]], atol=1e-3)
    np.testing.assert_allclose((feet.place / 2000 + 0.1) % 1.0, [0.1, 0.35, 0.6, 0.85], atol=1e-3)
    distances = normal_distances(points, np.stack([circle, np.full_like(circle, np.nan), 1.1 * circle]))
    np.testing.assert_allclose(distances[0], feet.distance)
    assert np.isnan(distances[1]).all()
    assert distances[2, 0] == pytest.approx(0.1, abs=1e-5)


def test_points_are_shifted_and_turned_onto_each_outline_if_asked(model):
    here, there = outlines(model, [0.03, 0.85])[0], outlines(model, [0.09, 0.9])[0]
    angle = 0.02
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = there[::4] @ turn + [0.2, -0.1]
    both = np.stack([here, there])
    assert np.abs(normal_distances(points, both)[1]).max() > 0.05
    distances = normal_distances(points, both, posed=True)
    np.testing.assert_allclose(distances[1], 0.0, atol=1e-4)
    np.testing.assert_allclose(distances[0], aligned_with(points, here)[1].distance, atol=5e-3)


def test_a_circle_is_posed_though_nothing_tells_its_tilt():
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    feet = aligned_with(0.9 * circle[::10] + [0.3, -0.2], circle)[1]
    np.testing.assert_allclose(feet.distance, -0.1, atol=1e-4)
    np.testing.assert_allclose(normal_distances(0.9 * circle[::10] + 0.1, circle[None], posed=True), -0.1, atol=1e-4)


def test_an_outline_is_aligned_with_one_that_lies_elsewhere():
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    there = np.stack([1.5 * np.cos(angle) + 6.0, np.sin(angle) - 4.0], axis=1)
    points, feet = aligned_with(there[::10] + np.array([-9.0, 5.0]), there)
    np.testing.assert_allclose(points, there[::10], atol=1e-3)
    np.testing.assert_allclose(feet.distance, 0.0, atol=1e-3)


def test_points_of_the_rear_do_not_jump_across_the_rim(model):
    """The rear rim is thinner than the step between two points."""
    outline = outlines(model, [0.1, 0.95])[0]
    inward = outline[::4] - 0.002 * vertex_normals(outline)[::4]
    np.testing.assert_allclose(posed_on(inward, outline, fits=0)[1].distance, -0.002, atol=4e-4)


def test_it_is_blind_to_place_and_tilt_and_sees_the_size(model):
    pilot = outlines(model, TRUTH)[0]
    here = OutlineLikelihood(pilot[::4], NOISE, pilot)
    there = OutlineLikelihood(posed(pilot[::4], [0.4, -0.2], 0.03), NOISE, pilot)
    others = outlines(model, [[0.05, 0.9], [0.05, 0.93], [0.06, 0.9], [0.05, 2.0]])
    np.testing.assert_allclose(there.log_density(others), here.log_density(others), atol=0.3)
    assert np.isnan(here.log_density(others)[3])
    assert here.log_density(others)[0] > here.log_density(others)[1:3].max() + 5


def test_the_covariance_is_that_of_the_errors_drawn(model):
    pilot = outlines(model, TRUTH)[0][::8]
    errors = NOISE.drawn(np.random.default_rng(0), pilot, 20000)
    np.testing.assert_allclose(np.cov(errors.T), NOISE.covariance(pilot), atol=0.04 * NOISE.scale**2)


@pytest.mark.parametrize(
    ("seen", "pose"),
    [
        (lambda points: points * [1.03, 1.0], Pose(pixel_aspect=0.02)),
        (lambda points: points * (0.97 + 0.03 * np.sum(points**2, axis=1, keepdims=True)), Pose(distortion=0.02)),
        (lambda points: points * (1.0 + 0.05 * points[:, :1]), Pose(taper=0.03)),
    ],
    ids=["oblong pixels", "radial distortion", "taper"],
)
def test_a_fault_of_the_camera_is_within_the_error_that_is_stated_of_it(model, seen, pose):
    pilot = outlines(model, TRUTH)[0]
    centred = pilot[::4] - 0.5 * (pilot.max(axis=0) + pilot.min(axis=0))
    misfits = []
    for known in (Pose(), pose):
        found, precision = fitted(model, OutlineLikelihood(seen(centred), NOISE, pilot, known))
        misfits.append((found - TRUTH) @ precision @ (found - TRUTH))
    assert misfits[0] > 15.0
    assert misfits[1] < 4.0


@pytest.mark.slow
def test_the_95_per_cent_region_covers(model):
    """150 outlines each: 0.95 within three binomial standard errors, 0.05; taken as white the errors deceive."""
    rng = np.random.default_rng(1)
    assert covered(model, rng, NOISE, NOISE) == pytest.approx(0.95, abs=0.054)
    assert covered(model, rng, NOISE, OutlineNoise(NOISE.scale, 0.0)) < 0.7


@pytest.mark.slow
def test_edges_found_too_far_out_are_borne_with_a_prior(model):
    rng = np.random.default_rng(2)
    halo = Pose(offset=0.01)
    assert covered(model, rng, NOISE, NOISE, pose=halo, offset=0.01) > 0.9
    assert covered(model, rng, NOISE, NOISE, offset=0.01, count=40) < 0.5


def test_the_models_own_error_widens_the_posterior(model):
    pilot = outlines(model, TRUTH)[0]
    modes = model.outline_modes(capillary_number=TRUTH[0], size_ratio=TRUTH[1])
    assert modes.shape[1] == len(pilot)
    fine = OutlineNoise(5e-4, 0.5)
    plain, wider = (fitted(model, OutlineLikelihood(pilot[::4], fine, pilot, modes=m))[1] for m in (None, 10 * modes))
    assert np.all(np.linalg.inv(wider)[range(2), range(2)] > 1.5 * np.linalg.inv(plain)[range(2), range(2)])


@pytest.mark.parametrize("wrong", [{"scale": 0.0}, {"correlation_length": -1.0}, {"white": 1.5}])
def test_wrong_errors_are_refused(wrong):
    with pytest.raises(InputError, match=f"OutlineNoise: {next(iter(wrong))}: expected"):
        OutlineNoise(**({"scale": 0.01, "correlation_length": 0.2} | wrong))


COUNT = 24
ANGLE = 2.0 * np.pi * np.arange(COUNT) / COUNT
CIRCLE = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
SMOOTH, POSE = OutlineNoise(0.02, 0.7, 0.25), Pose(along=0.3, across=0.5, tilt=0.05, offset=0.01)
NOSE = 0


def of_circle(noise=SMOOTH, pose=POSE, modes=None, length=None):
    return OutlineLikelihood(0.9 * CIRCLE, noise, 0.9 * CIRCLE, pose, modes, length)


def covariance_of_circle(noise=SMOOTH, pose=POSE):
    """Of normal distances: noise, shifts along and across, and an offset of all; a turn changes nothing."""
    shifts = pose.along**2 * np.outer(*[np.cos(ANGLE)] * 2) + pose.across**2 * np.outer(*[np.sin(ANGLE)] * 2)
    return noise.covariance(0.9 * CIRCLE) + shifts + pose.offset**2


def test_the_density_of_a_circle_is_that_of_its_distances_with_all_that_may_have_moved_them():
    radii = np.array([0.89, 0.9, 0.93])
    found = of_circle().log_density(radii[:, None, None] * CIRCLE)
    expected = [
        multivariate_normal(cov=covariance_of_circle()).logpdf(np.full(COUNT, 0.9 - radius)) for radius in radii
    ]
    # the farther edge of a polygon is nearer than its vertex
    np.testing.assert_allclose(found, expected, rtol=2e-3)


@pytest.mark.parametrize("unit", [1e-7, 1e3])
def test_in_another_unit_the_density_is_divided_by_that_unit_for_each_point(unit):
    noise = OutlineNoise(unit * SMOOTH.scale, unit * SMOOTH.correlation_length, SMOOTH.white)
    pose = Pose(unit * POSE.along, unit * POSE.across, POSE.tilt, unit * POSE.offset)
    found = OutlineLikelihood(0.9 * unit * CIRCLE, noise, 0.9 * unit * CIRCLE, pose)
    here, there = of_circle().log_density(0.93 * CIRCLE[None]), found.log_density(0.93 * unit * CIRCLE[None])
    np.testing.assert_allclose(there, here - COUNT * np.log(unit), rtol=1e-5)


def test_errors_of_the_model_add_to_the_covariance_where_the_points_are():
    modes = np.stack([np.cos(2.0 * ANGLE), np.full(COUNT, 0.5)]) * 0.01
    found = of_circle(modes=modes).log_density(0.92 * CIRCLE[None])
    covariance = covariance_of_circle() + modes.T @ modes
    expected = multivariate_normal(cov=covariance).logpdf(np.full(COUNT, -0.02))
    assert found[0] == pytest.approx(expected, rel=2e-3)


def test_displacements_are_interpolated_between_the_vertices_of_the_pilot():
    """A displacement as the cosine of the angle is a shift along the flow, seen from points off the vertices."""
    fine = 2.0 * np.pi * np.arange(400) / 400
    pilot = 0.9 * np.stack([np.cos(fine), np.sin(fine)], axis=1)
    turned = 2.0 * np.pi * (np.arange(COUNT) + 0.013) / COUNT
    points = 0.9 * np.stack([np.cos(turned), np.sin(turned)], axis=1)
    seen = OutlineLikelihood(points, OutlineNoise(0.01, 0.0), pilot, Pose(1e-9, 1e-9, 1e-9))
    np.testing.assert_allclose(seen.whitened_displacement(np.cos(fine)[None])[0], np.cos(turned) / 0.01, atol=0.05)


@pytest.mark.parametrize("length", [None, SilhouetteLength(1.5, 0.03, 0.01)])
def test_a_displacement_outwards_changes_the_residuals_as_a_smaller_prediction_does(length):
    """L_a ends at the nose, which is displaced too."""
    seen = of_circle(length=length)
    white = seen.whitened(np.stack([0.9 * CIRCLE, 0.89 * CIRCLE]), np.array([1.5, 1.49]))
    np.testing.assert_allclose(white[1] - white[0], seen.whitened_displacement(np.full((1, COUNT), 0.01))[0], atol=0.02)


def test_a_length_whose_error_is_its_own_is_a_further_factor_of_the_density():
    noise, pose = OutlineNoise(0.02, 0.7, 1.0), Pose(offset=0.0)
    outlines = np.stack([0.9 * CIRCLE, 0.92 * CIRCLE])
    without = of_circle(noise, pose).log_density(outlines)
    found = of_circle(noise, pose, length=SilhouetteLength(1.5, 0.03, 0.04)).log_density(outlines, np.array([1.5, 1.6]))
    np.testing.assert_allclose(found - without, norm.logpdf([0.0, 0.1], 0.0, 0.05), rtol=1e-6)


def test_a_length_shares_the_error_of_the_nose():
    """The smooth noise at the nose and the offset of all edges move L_a with the outline."""
    found = of_circle(length=SilhouetteLength(1.5, 0.05, 0.02)).log_density(0.9 * CIRCLE[None], np.array([1.45]))
    smooth = 0.75 * OutlineNoise(0.02, 0.7).covariance(0.9 * CIRCLE)[NOSE] + 0.01**2
    covariance = np.block([[covariance_of_circle(), smooth[:, None]], [smooth, np.array(0.05**2 + 0.02**2)]])
    expected = multivariate_normal(cov=covariance).logpdf([*np.zeros(COUNT), 0.05])
    assert found[0] == pytest.approx(expected, rel=1e-3)


def test_no_more_of_the_error_of_a_length_is_that_of_the_nose_than_nine_tenths():
    """With an error smaller than that of the nose itself, a correlation of 0.9 with the smooth error there is left."""
    error, smooth = 0.005, np.sqrt(0.75 * 0.02**2 + 0.01**2)
    seen = of_circle(length=SilhouetteLength(1.5, error))
    covariance = seen._factor @ seen._factor.T
    assert covariance[-1, -1] == pytest.approx(error**2)
    assert covariance[-1, NOSE] == pytest.approx(0.9 * error * smooth)


class CircleModel:
    """Circles of the radius a/l, whose own error is uniform all around."""

    name, view = "circles", "mid-plane"

    def __call__(self, theta, *, outline):
        size = theta["size_ratio"]
        covariance = np.zeros((len(size), 3, 3))
        covariance[:, 0, 0], covariance[:, 1, 1] = 0.5**2, 0.02**2
        return SimpleNamespace(outline=size[:, None, None] * CIRCLE, axial_length=1.7 * size, covariance=covariance)

    def outline_modes(self, **theta):
        return np.full((1, COUNT), 0.01)


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_the_likelihood_of_a_measurement_has_the_own_error_of_the_model_at_the_pilot(scale):
    model, seen = CircleModel(), MeasuredOutline(0.9 * CIRCLE, SMOOTH, Pose(offset=0.0))
    found = outline_likelihood(model, seen, {"size_ratio": 0.9}, scale, length=(1.53, 0.05))
    own = Pose(offset=0.01 * scale)
    smooth = 0.75 * OutlineNoise(0.02, 0.7).covariance(0.9 * CIRCLE)[NOSE]
    of_outline = covariance_of_circle(pose=Pose()) + own.offset**2
    covariance = np.block([[of_outline, smooth[:, None]], [smooth, np.array(0.05**2 + (0.02 * scale) ** 2)]])
    expected = multivariate_normal(cov=covariance).logpdf(np.zeros(COUNT + 1))
    assert found.at(model, {"size_ratio": np.array([0.9])})[0] == pytest.approx(expected, rel=1e-3)
    alone = outline_likelihood(model, seen, {"size_ratio": 0.9}, scale)
    assert alone.at(model, {"size_ratio": np.array([0.9])})[0] == pytest.approx(
        multivariate_normal(cov=of_outline).logpdf(np.zeros(COUNT)), rel=1e-3
    )


class ErringCircles(CircleModel):
    """The own error grows with the size."""

    def outline_modes(self, **theta):
        return np.full((1, COUNT), 0.01 * theta["size_ratio"] / 0.9)


def test_the_own_error_is_averaged_over_other_places_if_some_are_given():
    """Variances of 0.01^2, (0.02)^2 and (0.03)^2 at three places."""
    model, seen = ErringCircles(), MeasuredOutline(0.9 * CIRCLE, SMOOTH, Pose(offset=0.0))
    others = [{"size_ratio": 1.8}, {"size_ratio": 2.7}]
    found = outline_likelihood(model, seen, {"size_ratio": 0.9}, others=others)
    covariance = covariance_of_circle(pose=Pose()) + (0.01**2 + 0.02**2 + 0.03**2) / 3.0
    expected = multivariate_normal(cov=covariance).logpdf(np.zeros(COUNT))
    assert found.at(model, {"size_ratio": np.array([0.9])})[0] == pytest.approx(expected, rel=1e-3)
