import manufactured
import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.profile import Profile
from capsbayes.surrogate import Inverse, inverse
from capsbayes.surrogate.inverse import VelocityTriangulation, rotated, solve

RNG = np.random.default_rng(6)
PARAMETERS = RNG.uniform([0.01, 0.7], [0.15, 1.1], (100, 2))
# as in nature the cloud is narrow, and long along the sum of both lengths
SLOPES = np.array([[1.0, 4.0], [-1.5, 3.8]])
CONTOURS = manufactured.outlines(*PARAMETERS.T)


def linear(neighbours=14):
    """The procedure over a manufactured linear map, for which it is exact."""
    lengths = np.array([-1.6, -1.5]) + PARAMETERS @ SLOPES.T
    return Inverse(PARAMETERS, lengths, 2.0 + PARAMETERS @ [0.5, -1.0], CONTOURS, neighbours)


@pytest.mark.parametrize("truth", [(0.05, 0.9), (0.08, 0.96), (0.1, 0.8)])
def test_a_linear_map_is_inverted_exactly(truth):
    extent, length = np.array([-1.6, -1.5]) + SLOPES @ truth
    found = linear()(axial_extent=extent, axial_length=length)
    assert found.capillary_number == pytest.approx(truth[0], abs=1e-10)
    assert found.size_ratio == pytest.approx(truth[1], abs=1e-10)
    assert found.velocity_ratio == pytest.approx(2.0 + 0.5 * truth[0] - truth[1], abs=1e-9)


def test_the_neighbourhood_holds_n_cases_and_is_long_along_the_cloud():
    whole = linear()
    found = whole(axial_extent=2.05, axial_length=1.85)
    offsets = rotated(whole.lengths[found.neighbours]) - rotated(np.array([2.05, 1.85]))
    assert len(set(found.neighbours)) == 14
    assert np.abs(offsets[:, 0]).max() > 2 * np.abs(offsets[:, 1]).max()
    distance = 0.05 * offsets[:, 0] ** 2 + offsets[:, 1] ** 2
    assert np.all(np.diff(distance) >= 0)


def test_the_contour_is_the_weighted_mean_of_the_neighbours():
    whole = linear()
    found = whole(axial_extent=2.05, axial_length=1.85)
    offsets = rotated(whole.lengths[found.neighbours]) - rotated(np.array([2.05, 1.85]))
    share = np.sqrt(0.05 * offsets[:, 0] ** 2 + offsets[:, 1] ** 2)
    share /= share.max()
    weight = 2 * share**3 - 3 * share**2 + 1
    assert weight[-1] == 0
    expected = np.average(CONTOURS[found.neighbours], axis=0, weights=weight)
    np.testing.assert_allclose(found.contour, expected, atol=1e-13)


def test_the_hausdorff_distance_is_over_a_and_does_not_see_a_shift():
    found = linear()(axial_extent=2.05, axial_length=1.85)
    assert found.hausdorff(found.profile.translated(3.0)) == pytest.approx(0.0, abs=1e-12)
    longer = Profile(found.contour * [1.1, 1.0])
    assert found.hausdorff(longer) == pytest.approx(0.05 * found.profile.axial_extent / found.size_ratio, rel=1e-6)


def test_a_database_gives_its_converged_cases():
    database = manufactured.database(failed=(3, 4))
    whole = inverse(database)
    assert len(whole.parameters) == len(database) - 2
    truth = np.array([[0.06, 0.9]])
    extent, length, velocity, _ = manufactured.lengths(*truth.T)[0]
    found = whole(axial_extent=extent, axial_length=length)
    assert found.capillary_number == pytest.approx(0.06, rel=0.03)
    assert found.size_ratio == pytest.approx(0.9, rel=2e-3)
    assert found.velocity_ratio == pytest.approx(velocity, rel=2e-3)


@pytest.mark.parametrize(("extent", "length"), [(1.8, 2.1), (2.0, -1.0), (np.nan, 1.0), (np.inf, 1.0)])
def test_lengths_of_no_capsule_are_refused(extent, length):
    with pytest.raises(InputError, match="0 < L_a <= L_z"):
        linear()(axial_extent=extent, axial_length=length)


@pytest.mark.parametrize("neighbours", [4, 101])
def test_a_neighbourhood_that_cannot_be_is_refused(neighbours):
    with pytest.raises(InputError, match="from 5 to the number of cases, 100"):
        linear(neighbours)


POINTS = np.concatenate(
    [[[0.0, 0.7], [0.15, 0.7], [0.0, 1.1], [0.15, 1.1]], RNG.uniform([0, 0.7], [0.15, 1.1], (40, 2))]
)


def test_a_plane_is_reproduced():
    plane = VelocityTriangulation(POINTS, 2.0 + POINTS @ [3.0, -1.0])
    for ca, size in RNG.uniform([0.001, 0.701], [0.149, 1.099], (30, 2)):
        assert plane(ca, size) == pytest.approx(2.0 + 3.0 * ca - size, abs=1e-12)


def test_outside_the_value_is_that_of_the_nearest_border_point():
    plane = VelocityTriangulation(POINTS, 2.0 + POINTS @ [3.0, -1.0])
    assert plane(0.2, 0.9) == pytest.approx(2.0 + 0.45 - 0.9, abs=1e-12)
    assert plane(-0.1, 2.0) == pytest.approx(2.0 - 1.1, abs=1e-12)


def fold(points):
    """Manufactured fold: the first value has its largest value 1 at x = 0."""
    x, y = points.T
    gradient = np.stack([np.stack([-2 * x, 0 * x], axis=1), np.full((len(x), 2), [0.2, 1.0])], axis=1)
    return np.stack([1 - x**2, y + 0.2 * x], axis=1), gradient


def solved(forward, wanted, *starts):
    """The point found from several starting points, and its misfit."""
    point = solve(forward, np.array(wanted), np.array(starts))
    return point, np.abs(fold(point[None])[0][0] - wanted).max()


@pytest.mark.parametrize(("start", "side"), [(1.5, 0.5), (2.0, 0.5), (-2.0, -0.5)])
def test_each_side_of_a_fold_is_found_to_roundoff_from_its_side(start, side):
    point, misfit = solved(fold, [0.75, 2.0], [start, 0.0])
    np.testing.assert_allclose(point, [side, 2.0 - 0.2 * side], atol=1e-9)
    assert misfit < 1e-10


def test_beyond_a_fold_the_nearest_point_is_the_answer():
    point, misfit = solved(fold, [1.2, 2.0], [0.7, 1.0], [-0.4, 3.0])
    assert misfit == pytest.approx(0.2, abs=1e-6)
    assert point[0] == pytest.approx(0.0, abs=1e-2)


def test_a_start_where_the_map_is_not_defined_is_passed_over():
    def somewhere(points):
        value, gradient = fold(points)
        value[points[:, 0] <= 0.0] = np.nan
        return value, gradient

    assert solved(somewhere, [0.75, 2.0], [-1.0, 0.0], [1.0, 0.0])[1] < 1e-10
    assert np.isnan(solved(somewhere, [0.75, 2.0], [-1.0, 0.0])[0]).all()


def test_the_starts_after_an_exact_answer_are_not_tried():
    asked = []

    def noted(points):
        asked.append(points)
        return fold(points)

    assert solved(noted, [0.75, 2.0], [1.5, 0.0], [-9.0, 0.0])[1] < 1e-10
    assert np.min(asked) > -9.0


def test_an_answer_is_exact_where_the_map_takes_the_values():
    rng = np.random.default_rng(2)
    wanted = np.stack([rng.uniform(-1.0, 1.2, 40), rng.uniform(-2.0, 2.0, 40)], axis=1)
    for values, starts in zip(wanted, rng.uniform(-2.0, 2.0, (40, 3, 2)), strict=True):
        assert (solved(fold, values, *starts)[1] < 1e-10) == (values[0] < 1.0)
