import numpy as np
import pytest

from capsbayes.surrogate import DomainOfExistence
from capsbayes.surrogate.plane import Region

MAIN = Region(
    np.array([0.8, 0.9, 1.0]),
    np.array([0.01, 0.01, 0.02]),
    np.array([0.15, 0.15, 0.11]),
    np.array([False, False, True]),
)
SECOND = Region(
    np.array([0.95, 1.0, 1.05]), np.array([0.005, 0.006, 0.006]), np.array([0.009, 0.009, 0.009]), np.array([True] * 3)
)
DOMAIN = DomainOfExistence((MAIN,))
BOTH = DomainOfExistence((MAIN, SECOND))


@pytest.mark.parametrize(
    ("ca", "size", "inside"),
    [
        (0.05, 0.85, True),
        (0.01, 0.8, True),
        (0.11, 1.0, True),
        (0.13, 0.95, True),
        (0.1301, 0.95, False),
        (0.0149, 0.95, False),
        (0.0151, 0.95, True),
        (0.05, 0.7999, False),
        (0.05, 1.0001, False),
        (np.nan, 0.9, False),
        (0.05, np.nan, False),
        (-0.05, 0.9, False),
    ],
)
def test_a_point_is_inside_between_the_borders(ca, size, inside):
    assert DOMAIN.contains(ca, size).tolist() == [inside]


def test_a_batch_is_its_points_one_by_one():
    ca, size = np.random.default_rng(4).uniform([0, 0.75], [0.2, 1.05], (300, 2)).T
    alone = [DOMAIN.contains(c, s)[0] for c, s in zip(ca, size, strict=True)]
    np.testing.assert_array_equal(DOMAIN.contains(ca, size), alone)


def test_regions_are_united():
    ca, size = np.random.default_rng(5).uniform([0, 0.75], [0.2, 1.1], (500, 2)).T
    np.testing.assert_array_equal(BOTH.contains(ca, size), MAIN.contains(ca, size) | SECOND.contains(ca, size))
    assert (DOMAIN.bounds, BOTH.bounds) == (((0.01, 0.15), (0.8, 1.0)), ((0.005, 0.15), (0.8, 1.05)))


@pytest.mark.parametrize(
    ("domain", "ca", "size", "reason"),
    [
        (DOMAIN, 0.05, 0.7, "a/l runs from 0.8 to 1"),
        (DOMAIN, 0.001, 0.8, "lowest Ca computed at this a/l is 0.01"),
        (DOMAIN, 0.2, 0.8, "the database ends at Ca = 0.15"),
        (DOMAIN, 0.12, 1.0, "no steady shape is known above Ca = 0.11"),
        (DOMAIN, np.nan, 0.9, "expected finite numbers"),
        (BOTH, 0.012, 1.0, "between two branches"),
        (BOTH, 0.001, 1.0, "lowest Ca computed at this a/l is 0.006"),
        (BOTH, 0.12, 1.0, "no steady shape is known above Ca = 0.11"),
        (BOTH, 0.05, 1.05, "no steady shape is known above Ca = 0.009"),
        (BOTH, 0.05, 1.06, "a/l runs from 0.8 to 1.05"),
    ],
)
def test_the_reason_names_the_side_of_all_regions(domain, ca, size, reason):
    assert reason in domain.reason(ca, size)
