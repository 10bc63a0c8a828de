import numpy as np

from capsbayes.model import Domain, ForwardModel
from capsbayes.prediction import Prediction


class Box:
    bounds = ((0.01, 0.1), (0.7, 1.1))

    def contains(self, capillary_number, size_ratio):
        (ca_min, ca_max), (size_min, size_max) = self.bounds
        ca, size = np.asarray(capillary_number), np.asarray(size_ratio)
        return (ca >= ca_min) & (ca <= ca_max) & (size >= size_min) & (size <= size_max)


class Sphere:
    """The rigid limit: every length is the diameter."""

    name, sha256, domain = "sphere", "0" * 64, Box()

    def __call__(self, theta, *, outline=False):
        size = np.asarray(theta["size_ratio"])
        inside = self.domain.contains(theta["capillary_number"], size)
        length = np.where(inside, 2 * size, np.nan)
        one = np.where(inside, 1.0, np.nan)
        return Prediction(length, length, one, one, np.zeros((len(size), 3, 3)), inside)


def test_a_class_with_the_promised_members_is_a_forward_model():
    assert isinstance(Sphere(), ForwardModel)
    assert isinstance(Box(), Domain)
    assert not isinstance(Box(), ForwardModel)


def test_a_batch_goes_through_with_its_mask():
    prediction = Sphere()({"capillary_number": np.array([0.05, 0.5]), "size_ratio": np.array([0.9, 0.9])})
    np.testing.assert_array_equal(prediction.inside, [True, False])
    np.testing.assert_allclose(prediction.axial_extent, [1.8, np.nan])
