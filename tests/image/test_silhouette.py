"""The silhouette of a picture with its noise, compared with the drawn one."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from drawn import HALF_WIDTH, circle, drawn

from capsbayes.image.files import Picture
from capsbayes.image.measure import EdgeErrors, detect, silhouette_of
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.infer.outline import aligned_with

SHAPES = [(0.03, 0.8), (0.05, 0.93), (0.08, 1.05), (0.1, 0.75)]


def found(made, **options):
    seen = detect(Picture.from_array(made.picture), background=Picture.from_array(made.background), **options)
    return silhouette_of(seen)


@pytest.mark.parametrize("blur", [0.7, 2.0])
def test_residuals_are_as_stated(blur):
    """Normal distances from the true silhouette, whitened: of variance one."""
    squares = []
    for seed, shape in enumerate(SHAPES):
        made = drawn(*shape, optics=Optics(blur=blur, electrons=5000), seed=seed)
        seen = found(made)
        points, feet = aligned_with(seen.points, np.asarray(made.scene.silhouette))
        covariance = seen.noise.covariance(points) + seen.pose.offset**2
        factor = scipy.linalg.cholesky(covariance, lower=True)
        squares.append(np.mean(scipy.linalg.solve_triangular(factor, feet.distance, lower=True) ** 2))
    assert 0.6 < np.mean(squares) < 1.3
    assert max(squares) < 1.8


def test_edges_next_to_a_wall_are_left_out():
    """A capsule that leaves 3 px to either wall, blurred by 2 px: its flanks would lie 0.3 px too far out."""
    made = drawn(0.005, 1.125, optics=Optics(blur=2.0, electrons=5000))
    detection = detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))
    clearance = detection.walls.clearance(detection.outline.points)
    assert clearance.min() < 4.0
    seen = silhouette_of(detection)
    whole = np.abs(np.asarray(made.scene.silhouette)[:, 1]).max()
    assert np.abs(seen.points[:, 1] - np.median(seen.points[:, 1])).max() < whole - 0.01
    truth = np.asarray(made.scene.silhouette)
    _, kept = aligned_with(seen.points, truth)
    every = (detection.outline.points - detection.axis) @ np.stack([detection.walls.along, detection.walls.across], 1)
    _, found_at_all = aligned_with(every / HALF_WIDTH, truth)
    flank = clearance < 2.0 * detection.walls.line_width
    assert found_at_all.distance[flank].mean() * HALF_WIDTH > 0.2
    assert np.abs(kept.distance).max() < 3.0 * np.hypot(seen.noise.scale, seen.pose.offset)


def test_a_capsule_that_moves_to_the_left_looks_the_same():
    right, left = (found(drawn(0.08, 1.05, flow=flow)) for flow in (1, -1))
    assert right.view == "silhouette"
    # the blunt rear is behind: the centroid is nearer to it
    for seen in (right, left):
        z = seen.points[:, 0]
        assert z.mean() < 0.5 * (z.max() + z.min())
    for axis in (0, 1):
        assert np.ptp(left.points[:, axis]) == pytest.approx(np.ptp(right.points[:, axis]), abs=0.005)


def test_blurred_edges_are_less_sure():
    sharp, blurred = (found(drawn(0.08, 1.05, optics=Optics(blur=blur))) for blur in (0.6, 2.0))
    assert blurred.noise.scale > 1.2 * sharp.noise.scale
    assert blurred.noise.white < sharp.noise.white
    assert blurred.pose.offset > sharp.pose.offset


def test_a_rear_whose_edge_is_a_band_has_an_error_of_its_own():
    made = drawn(0.08, 1.05)
    sharp = detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))
    outline = sharp.outline
    rear = sharp.flow * (outline.normals @ sharp.walls.along) < -0.7
    width = np.where(rear, np.hypot(outline.edge_width, 2.0), outline.edge_width)
    band = replace(sharp, outline=replace(outline, edge_width=width))
    assert EdgeErrors.of(sharp).rear == 0.0
    assert EdgeErrors.of(band).rear == pytest.approx(2.0, rel=0.1)
    assert silhouette_of(band).pose.rear == pytest.approx(2.0 / sharp.walls.half_width, rel=0.1)
    assert EdgeErrors.of(replace(band, flow=0)).rear == 0.0


def test_without_a_direction_there_is_none():
    disc = circle(0.8)
    made = draw(Scene(disc, disc, half_width=HALF_WIDTH), Optics(), seed=2)
    assert found(made) is None
    assert found(made, flow="right") is not None
