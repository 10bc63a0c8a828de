import manufactured
import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.profile import Profile
from capsbayes.surrogate import Inverse, inverse
from capsbayes.surrogate.inverse import rotated

RNG = np.random.default_rng(6)
PARAMETERS = RNG.uniform([0.01, 0.7], [0.15, 1.1], (100, 2))
# as in nature the cloud is narrow, and long along the sum of both lengths
SLOPES = np.array([[1.0, 4.0], [-1.5, 3.8]])
CONTOURS = manufactured.outlines(*PARAMETERS.T)


def linear(neighbours=14):
    """The procedure over a manufactured linear map, for which it is exact."""
    lengths = np.array([-1.6, -1.5]) + PARAMETERS @ SLOPES.T
    return Inverse(PARAMETERS, lengths, 2.0 + PARAMETERS @ [0.5, -1.0], CONTOURS, neighbours)


def test_the_rotation_is_by_minus_45_degrees():
    turn = np.exp(-1j * np.pi / 4) * (2.14 + 1.81j)
    np.testing.assert_allclose(rotated(np.array([2.14, 1.81])), [turn.real, turn.imag])


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
