import numpy as np
import pytest

from capsbayes.prediction import Prediction


def fields(n: int = 2) -> dict[str, np.ndarray]:
    return {
        "axial_extent": np.linspace(2.0, 2.2, n),
        "axial_length": np.linspace(1.7, 1.8, n),
        "velocity_ratio": np.full(n, 1.3),
        "stretch_ratio": np.full(n, 1.1),
        "covariance": np.zeros((n, 3, 3)),
        "inside": np.ones(n, dtype=bool),
    }


def test_values_follow_the_order_of_the_covariance_and_it_is_frozen():
    prediction = Prediction(**fields())
    np.testing.assert_array_equal(prediction.values, [[2.0, 1.7, 1.3], [2.2, 1.8, 1.3]])
    np.testing.assert_allclose(prediction.parachute_depth, [0.3, 0.4])
    assert len(prediction) == 2
    with pytest.raises(AttributeError):
        Prediction(**fields()).inside = None


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("axial_extent", np.zeros((2, 1))),
        ("axial_length", np.zeros(3)),
        ("inside", np.ones(1, dtype=bool)),
        ("covariance", np.zeros((2, 2, 2))),
        ("outline", np.zeros((2, 5, 3))),
    ],
)
def test_a_wrong_shape_is_named(name, wrong):
    with pytest.raises(ValueError, match=f"{name}: expected shape"):
        Prediction(**{**fields(), name: wrong})
