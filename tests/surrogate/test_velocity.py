import numpy as np
import pytest

from capsbayes.surrogate.inverse import VelocityTriangulation

RNG = np.random.default_rng(3)
POINTS = np.concatenate(
    [[[0.0, 0.7], [0.15, 0.7], [0.0, 1.1], [0.15, 1.1]], RNG.uniform([0, 0.7], [0.15, 1.1], (40, 2))]
)


def test_a_plane_is_reproduced():
    plane = VelocityTriangulation(POINTS, 2.0 + POINTS @ [3.0, -1.0])
    for ca, size in RNG.uniform([0.001, 0.701], [0.149, 1.099], (30, 2)):
        assert plane(ca, size) == pytest.approx(2.0 + 3.0 * ca - size, abs=1e-12)


def test_the_value_at_a_case_is_its_own():
    values = RNG.uniform(1.0, 2.0, len(POINTS))
    assert VelocityTriangulation(POINTS, values)(*POINTS[7]) == pytest.approx(values[7], abs=1e-9)


def test_outside_the_value_is_that_of_the_nearest_border_point():
    plane = VelocityTriangulation(POINTS, 2.0 + POINTS @ [3.0, -1.0])
    assert plane(0.2, 0.9) == pytest.approx(2.0 + 0.45 - 0.9, abs=1e-12)
    assert plane(-0.1, 2.0) == pytest.approx(2.0 - 1.1, abs=1e-12)
