import manufactured
import numpy as np

from capsbayes.database import Database
from capsbayes.model import TWO_SHAPES, WRINKLES
from capsbayes.surrogate.diffuse import PlaneScaling
from capsbayes.surrogate.plane import Caveats


def caveats(dataset):
    cases = Database(dataset)
    return Caveats.of(cases, PlaneScaling.of(cases["capillary_number"], cases["size_ratio"]))


def test_a_database_without_borders_or_wrinkles_has_no_caveats():
    assert caveats(manufactured.database().dataset)(np.array([0.05]), np.array([0.9])) == {}


def test_below_the_snap_through_two_shapes_are_stable():
    dataset = manufactured.database().dataset.copy(deep=True)
    dataset["border_kind"].values[[4, 6]] = "snap-through"
    dataset["border_kind"].values[5] = "lost from rest"
    dataset["border_capillary_number"].values[4:7] = 0.012, 0.008, 0.016
    found, size = caveats(dataset), dataset["border_size_ratio"].values[4:7]
    np.testing.assert_array_equal(found.two_shapes.size_ratio, size)
    np.testing.assert_allclose(found.two_shapes.highest, 0.016)  # that of the neighbours, and of all where it was lost
    concerned = found(np.array([0.014, 0.017, 0.012]), np.array([*size[:2], size[0] - 0.01]))[TWO_SHAPES]
    np.testing.assert_array_equal(concerned, [True, False, False])


def test_a_point_is_wrinkled_where_its_nearest_case_is():
    dataset = manufactured.database().dataset.copy(deep=True)
    ca, size = dataset["capillary_number"].values, dataset["size_ratio"].values
    dataset["wrinkling_rate"].values[:] = np.where(size > 0.9, 3.0, np.where(size > 0.8, -1.0, np.nan))
    chosen = np.flatnonzero((size > 0.79) & (size < 1.01))[::7]
    concerned = caveats(dataset)(ca[chosen] * 1.001, size[chosen] + 1e-3)[WRINKLES]
    np.testing.assert_array_equal(concerned, size[chosen] > 0.9)
    assert not caveats(dataset)(np.array([np.nan]), np.array([1.0]))[WRINKLES][0]
