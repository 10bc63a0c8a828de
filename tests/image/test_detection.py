"""What is made of a located outline."""

import numpy as np

from capsbayes.image.detect import _smoothed_by_walls
from capsbayes.image.edges import EdgeOutline
from capsbayes.image.walls import WallLines

ANGLE = 2.0 * np.pi * np.arange(300) / 300
NORMALS = np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1)
WALLS = WallLines(70.0, 80.0, 0.0, half_width=60.0, half_width_error=0.1, line_width=1.5)


def outline(outwards):
    """A circle 1.5 px from the lower wall, its points displaced outwards."""
    points = np.array([80.0, 75.0]) + (53.5 + outwards)[:, None] * NORMALS
    ones = np.ones(300)
    return EdgeOutline(points, NORMALS, ones, ones, np.zeros(300, dtype=np.intp), ones, ones > 0.0, ones < 0.0)


def test_an_outline_is_smoothed_where_it_is_close_to_a_wall_alone():
    zigzag = np.where(np.arange(300) % 4 < 2, 1.0, -1.0)
    found = _smoothed_by_walls(outline(zigzag), WALLS)
    near = WALLS.clearance(outline(zigzag).points) <= 3.0
    assert 10 < near.sum() < 60
    np.testing.assert_array_equal(found.points[~near], outline(zigzag).points[~near])
    np.testing.assert_allclose(np.hypot(*(found.points - [80.0, 75.0]).T)[near], 53.5, atol=0.4)


def test_no_part_of_an_outline_lies_beyond_a_wall():
    beyond = _smoothed_by_walls(outline(np.full(300, 4.0)), WALLS)
    assert abs(WALLS.clearance(beyond.points).min()) < 1e-9
    assert beyond.points[:, 1].max() == 130.0


def test_an_outline_far_from_the_walls_stays():
    free = outline(np.full(300, -5.0))
    assert _smoothed_by_walls(free, WALLS) is free
